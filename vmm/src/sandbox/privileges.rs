//! What the kernel lets a privileged process do, taken back.
//!
//! Hardly anything that a run does after its start needs a capability: a thread has its reservation
//! and its I/O ports, and what is open is open. What is left is the supervisor thread's, which gives things
//! back at the end, and the guardian's. But once `CAP_IPC_LOCK` is gone, the memory that is locked
//! counts against a limit, and a new vCPU or a heap that grows would be refused a page. So the limit
//! is lifted first. Where it cannot be, as in a container without `CAP_SYS_RESOURCE`, that one
//! capability is kept.

use std::io;

/// `struct __user_cap_header_struct` of `include/uapi/linux/capability.h`.
#[repr(C)]
struct Header {
    version: u32,
    thread: i32,
}

/// `struct __user_cap_data_struct`; two of them hold 64 bits.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Sets {
    effective: u32,
    permitted: u32,
    inheritable: u32,
}

/// `CAP_DAC_OVERRIDE`, as a bit: without it even root cannot write to the folder of the root cgroup, and
/// cgroups are removed from it at the end.
pub const DAC_OVERRIDE: u32 = 1 << 1;

/// `CAP_SYS_RAWIO`, as a bit: the guardian takes the privilege for ports when no other process has it
/// any more.
pub const SYS_RAWIO: u32 = 1 << 17;

/// `CAP_SYS_ADMIN`, as a bit: the kernel's `enable_store` (`drivers/pci/pci-sysfs.c`) demands it to
/// disable a function. A function that stays enabled is not set up again by the
/// host's driver, which then would wait for interrupts that Takt has switched off.
pub const SYS_ADMIN: u32 = 1 << 21;

/// `CAP_SYS_BOOT`, as a bit: process 1 of the appliance switches the machine off.
pub const SYS_BOOT: u32 = 1 << 22;

/// Keeps the memory of the process, and thereby its guests', out of core dumps and from other
/// programs of the same user (prctl(2), PR_SET_DUMPABLE).
///
/// # Errors
/// What the kernel says.
pub fn keep_memory_private() -> io::Result<()> {
    let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    let any = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };
    // SAFETY: the kernel reads live structures; prctl takes integers.
    unsafe {
        check(libc::setrlimit(libc::RLIMIT_CORE, &raw const none))?;
        check(libc::prctl(libc::PR_SET_DUMPABLE, 0, 0, 0, 0))?;
        // Refused to a process without the privilege. Its limit holds already.
        libc::setrlimit(libc::RLIMIT_MEMLOCK, &raw const any);
    }
    Ok(())
}

/// Neither the calling thread nor what it starts can gain privileges by executing a program.
///
/// # Errors
/// What the kernel says.
pub fn no_new_privileges() -> io::Result<()> {
    // SAFETY: takes integers only.
    check(unsafe { libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) })
}

/// Takes all capabilities from the calling thread, for good; but for `CAP_IPC_LOCK` where the limit of
/// locked memory could not be lifted, and for those of `also_kept`.
///
/// # Errors
/// What the kernel says.
pub fn drop_all(also_kept: u32) -> io::Result<()> {
    no_new_privileges()?;
    let kept = kept()? | also_kept;
    match set(kept) {
        // A process that has never had the privileges does without.
        Err(_) if kept != 0 => set(0),
        result => result,
    }
}

/// The capabilities that are needed to the end.
fn kept() -> io::Result<u32> {
    const IPC_LOCK: u32 = 1 << 14;

    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: fills in the live structure.
    check(unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit) })?;
    Ok(if limit.rlim_cur == libc::RLIM_INFINITY { 0 } else { IPC_LOCK })
}

fn set(capabilities: u32) -> io::Result<()> {
    /// `_LINUX_CAPABILITY_VERSION_3`.
    const VERSION: u32 = 0x2008_0522;

    let header = Header { version: VERSION, thread: 0 };
    let low = Sets { effective: capabilities, permitted: capabilities, inheritable: 0 };
    let sets = [low, Sets::default()];
    // SAFETY: the kernel reads the live header and, in this version, two structures.
    let result = unsafe {
        libc::syscall(libc::SYS_capset, &raw const header, (&raw const sets).cast::<Sets>())
    };
    check(if result == 0 { 0 } else { -1 })
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_without_capabilities_has_none_and_gets_none() {
        let status = std::thread::spawn(|| {
            drop_all(0).unwrap();
            assert_eq!(set(u32::MAX).unwrap_err().raw_os_error(), Some(libc::EPERM));
            std::fs::read_to_string("/proc/thread-self/status").unwrap()
        });
        let status = status.join().unwrap();
        let kept = kept().unwrap();
        for (set, has) in [("CapInh", 0), ("CapPrm", kept), ("CapEff", kept), ("CapAmb", 0)] {
            let line = format!("{set}:\t{has:016x}\n");
            assert!(status.contains(&line), "{set} in {status}");
        }
        assert!(status.contains("NoNewPrivs:\t1\n"), "{status}");
    }
}
