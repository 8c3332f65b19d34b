//! Safe values when the process is about to end without order: at a panic, and after a system call
//! that a thread may not make.
//!
//! The process would end at once, but for the message, which takes long enough for many a scan. So
//! before that the thread at fault takes all guests off their processors, as at an orderly end, and
//! each partition's own thread writes its values when its guest has left. No other thread can: ports
//! need a privilege that no other thread has, and none can take any more. The thread at fault waits
//! for them, but not for ever: one that has used up its reservation answers when the next period
//! begins, one that hangs in the kernel never does. Registers need no privilege and are written from
//! here first, in case of the latter; the rest is then the [guardian](super::guardian)'s, which
//! comes when the process is gone.
//!
//! All of it is safe in a signal handler: it allocates nothing, takes no lock, and calls only what is
//! in every thread's list.

use std::panic;
use std::ptr;
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, Ordering};

use super::safe_values::SafeValues;
use crate::outlet::takes_last_words;
use crate::terminal;
use crate::vcpu::Control;

/// How often, and how long each time, a thread is waited for: a second in all.
const LOOKS: usize = 10_000;
const PAUSE_NS: libc::c_long = 100_000;

/// What there is to do, if there is anything.
static CURRENT: AtomicPtr<Work> = AtomicPtr::new(ptr::null_mut());

/// All partitions.
struct Work {
    values: Vec<SafeValues>,
    /// Their threads, in the same order.
    threads: Vec<Arc<Control>>,
}

/// For as long as it lives, a panic and [`do_it`] write safe values.
pub struct Armed(());

impl Armed {
    /// Those of these partitions, and the threads that run them.
    #[must_use]
    pub fn new(all: impl Iterator<Item = (SafeValues, Arc<Control>)>) -> Self {
        let (values, threads): (Vec<SafeValues>, _) = all.unzip();
        if values.iter().any(|values| !values.is_empty()) {
            // Never freed: a handler may look at it at any time.
            let work = Box::leak(Box::new(Work { values, threads }));
            CURRENT.store(work, Ordering::SeqCst);
        }
        let next = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            do_it();
            terminal::restore();
            if takes_last_words() {
                next(panic);
            }
        }));
        Self(())
    }
}

impl Drop for Armed {
    fn drop(&mut self) {
        // The devices go back to the host, and are no business of ours then.
        CURRENT.store(ptr::null_mut(), Ordering::SeqCst);
    }
}

/// Ends all guests and has the values of all partitions written; false if a thread has not answered, `None`
/// if there are no values, or no guest that drives outputs. The process must end then.
pub fn do_it() -> Option<bool> {
    // SAFETY: null, or a value that was leaked and so lives for ever, and that is never changed.
    let work = unsafe { CURRENT.load(Ordering::SeqCst).as_ref() };
    work.map(|work| work.finish(LOOKS))
}

impl Work {
    fn finish(&self, looks: usize) -> bool {
        // SAFETY: no preconditions and no effect.
        let own = unsafe { libc::syscall(libc::SYS_gettid) as libc::pid_t };
        Control::stop_all(&self.threads);
        for (values, thread) in self.values.iter().zip(&self.threads) {
            if thread.thread() == own {
                values.write();
                // It comes back here no more, and others may be waiting for it.
                thread.leave_guest();
            } else {
                values.write_registers();
            }
        }
        for _ in 0..looks {
            if self.all_have_answered() {
                return true;
            }
            pause();
        }
        self.all_have_answered()
    }

    fn all_have_answered(&self) -> bool {
        let mut all = self.values.iter().zip(&self.threads);
        all.all(|(values, thread)| values.is_empty() || !thread.has_guest())
    }
}

fn pause() {
    let time = libc::timespec { tv_sec: 0, tv_nsec: PAUSE_NS };
    // SAFETY: reads a live timespec.
    unsafe { libc::clock_nanosleep(libc::CLOCK_MONOTONIC, 0, &raw const time, ptr::null_mut()) };
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::Read;

    use super::super::mapping::Mapping;
    use super::super::safe_values::{Target, Write};
    use super::*;
    use crate::vcpu::port_access::Width;

    /// A file in the place of a device, and a partition that has set its first register to be 7, whose
    /// thread has a guest.
    fn partition(name: &str) -> (File, Work) {
        let path = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
        let mut options = File::options();
        let file = options.read(true).write(true).create(true).truncate(true).open(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        file.set_len(4096).unwrap();
        let memory = Arc::new(Mapping::new(&file, 0, 4096).unwrap());
        let target = Target::Register(memory, 0);
        let values = SafeValues::new(vec![Write { target, width: Width::Four, value: 7 }]);
        let thread = Arc::<Control>::default();
        thread.enter_guest();
        (file, Work { values: vec![values], threads: vec![thread] })
    }

    fn register(mut file: &File) -> u32 {
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes).unwrap();
        u32::from_le_bytes(bytes)
    }

    #[test]
    fn a_thread_that_does_not_answer_is_not_waited_for_for_ever() {
        let (file, work) = partition("silent");
        assert!(!work.finish(3));
        assert!(work.threads[0].ending());
        assert_eq!(register(&file), 7, "a register needs no other thread");
    }

    #[test]
    fn the_end_waits_until_a_guest_has_left() {
        let (_file, work) = partition("leaving");
        let thread = work.threads[0].clone();
        let leaving = std::thread::spawn(move || {
            while !thread.ending() {
                std::thread::yield_now();
            }
            thread.leave_guest();
        });
        assert!(work.finish(usize::MAX));
        leaving.join().unwrap();
    }

    #[test]
    fn a_partition_without_values_is_not_waited_for() {
        let (_file, mut work) = partition("without");
        work.values = vec![SafeValues::default()];
        assert!(work.finish(0));
        assert!(work.threads[0].ending(), "but it is stopped");
    }
}
