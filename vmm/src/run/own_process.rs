//! What Takt asks of the kernel and the C library for its own process, before it takes anything.

use std::fs;
use std::io;

use crate::run_error::RunError;
use crate::terminal::tell;

/// The last but one that the kernel would kill for want of memory: only the guardian is behind Takt,
/// and writes the outputs if Takt has to go. With the largest locked memory of the host it would
/// otherwise be the first (`oom_badness` in the kernel's `mm/oom_kill.c`).
const OOM_SCORE_ADJ: &str = "-999";
const OOM_FILE: &str = "/proc/self/oom_score_adj";
/// What the heap keeps at its end however much is freed: all of it.
const TRIM_THRESHOLD: libc::c_int = libc::c_int::MAX;
/// From how many bytes on memory comes by a mapping of its own. Only images and the report are so
/// large, before and after the run.
const MAP_THRESHOLD: libc::c_int = 1 << 20;

/// Makes the kernel spare the process. An ordinary user may not ask for it, and is told so.
pub fn stay_alive() {
    if let Err(error) = fs::write(OOM_FILE, OOM_SCORE_ADJ) {
        tell(format_args!(
            "takt: the kernel may kill takt first for want of memory: {OOM_FILE} cannot be set \
             to {OOM_SCORE_ADJ} ({error}); run as root (CAP_SYS_RESOURCE)"
        ));
    }
}

/// What is written beyond a limit on the size of files (`ulimit -f`) is an error as any other, and not the end of the process:
/// a guest decides where on its disk it writes.
pub fn outlive_a_full_file() {
    // SAFETY: the signal has no handler that could be lost.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

/// Locks all memory, now and later: no page of a guest or of Takt is ever missing.
///
/// # Errors
/// [`RunError::Lock`].
pub fn lock_memory() -> Result<(), RunError> {
    keep_the_heap();
    // SAFETY: changes how the process's memory is kept, not what is in it.
    let result = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
    if result == 0 { Ok(()) } else { Err(RunError::Lock(io::Error::last_os_error())) }
}

/// The C library would keep a heap of 132 KiB for each thread that allocates, locked like the rest,
/// though all but the supervisor thread allocate at their start and end only. And it would give memory back
/// while guests run: that interrupts each CPU on which a thread of Takt is, in a window or not, since
/// none may still know the pages (`flush_tlb_mm_range` in the kernel's `arch/x86/mm/tlb.c`).
fn keep_the_heap() {
    let settings = [
        (libc::M_ARENA_MAX, 1),
        (libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD),
        (libc::M_MMAP_THRESHOLD, MAP_THRESHOLD),
    ];
    for (setting, value) in settings {
        // SAFETY: says how later allocations are kept; no other thread has allocated anything.
        unsafe { libc::mallopt(setting, value) };
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// Pages that the process has.
    fn resident() -> usize {
        let pages = fs::read_to_string("/proc/self/statm").unwrap();
        pages.split(' ').nth(1).unwrap().parse().unwrap()
    }

    /// Other tests have memory too, so this is done by a process of its own.
    #[test]
    fn what_is_freed_stays_with_the_process() {
        const OWN_PROCESS: &str = "TAKT_TEST_HEAP";
        const NAME: &str = "run::own_process::tests::what_is_freed_stays_with_the_process";
        const PAGES: usize = (16 << 20) / 4096;
        if std::env::var_os(OWN_PROCESS).is_none() {
            let mut own = Command::new(std::env::current_exe().unwrap());
            own.args(["--exact", NAME]).env(OWN_PROCESS, "1");
            let output = own.output().unwrap();
            assert!(output.status.success(), "{output:?}");
            return;
        }
        keep_the_heap();
        let before = resident();
        let blocks: Vec<Vec<u8>> = (0..64).map(|_| vec![1; 256 << 10]).collect();
        assert!(resident() >= before + PAGES - 64);
        drop(blocks);
        assert!(resident() >= before + PAGES - 64, "what was freed has gone");
    }
}
