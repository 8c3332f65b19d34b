//! From a reservation to a kernel call: pinning a thread to its CPU, and giving it its class.

use std::io;
use std::mem;

use crate::reservation::Reservation;
use crate::table::Cpu;

/// Pins the calling thread to one CPU. Must come before [`become_deadline`]: the kernel refuses
/// to change the affinity of a deadline thread (`EBUSY`).
///
/// # Errors
/// `EINVAL` if the CPU does not exist, is offline or is outside the process's cpuset.
pub fn pin_to(cpu: Cpu) -> io::Result<()> {
    pin_thread(0, cpu)
}

/// Pins another thread, also one of the kernel's.
///
/// # Errors
/// As [`pin_to`]; `ESRCH` if there is none, `EPERM` if it is not the caller's to place.
pub fn pin_thread(thread: i32, cpu: Cpu) -> io::Result<()> {
    // SAFETY: an all-zero cpu_set_t is the valid empty set.
    let mut set: libc::cpu_set_t = unsafe { mem::zeroed() };
    if cpu.0 >= libc::CPU_SETSIZE as usize {
        return Err(io::Error::from_raw_os_error(libc::EINVAL));
    }
    // SAFETY: CPU_SET writes within the set, whose size was checked above; the pointer handed to
    // the kernel is to a live set of the length given.
    let result = unsafe {
        libc::CPU_SET(cpu.0, &mut set);
        libc::sched_setaffinity(thread, size_of_val(&set), &raw const set)
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// `struct sched_attr` of `include/uapi/linux/sched/types.h`, first version.
#[repr(C)]
struct SchedAttr {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime: u64,
    deadline: u64,
    period: u64,
}

/// Makes the calling thread a SCHED_DEADLINE thread; see [`make_deadline`].
///
/// # Errors
/// See there.
pub fn become_deadline(reservation: Reservation) -> io::Result<()> {
    make_deadline(0, reservation)
}

/// Makes a thread a SCHED_DEADLINE thread, by the kernel's id of it; 0 is the calling one.
///
/// Children do not inherit the class (`SCHED_FLAG_RESET_ON_FORK`): without that flag the kernel
/// refuses every fork of the thread, also the ones that KVM makes on its behalf.
///
/// # Errors
/// `EPERM` without the privilege, or where the thread is pinned to fewer CPUs than its root
/// domain has; `EBUSY` if the CPU's admitted bandwidth is used up; `EINVAL` if the parameters
/// are outside the kernel's bounds (`sched_deadline_period_{min,max}_us`); `ESRCH` without the thread.
pub fn make_deadline(thread: i32, reservation: Reservation) -> io::Result<()> {
    const SCHED_DEADLINE: u32 = 6;
    const SCHED_FLAG_RESET_ON_FORK: u64 = 1;
    let attr = SchedAttr {
        size: size_of::<SchedAttr>() as u32,
        policy: SCHED_DEADLINE,
        flags: SCHED_FLAG_RESET_ON_FORK,
        nice: 0,
        priority: 0,
        runtime: reservation.runtime.0,
        deadline: reservation.period.0,
        period: reservation.period.0,
    };
    // SAFETY: the kernel reads `size` bytes of the live structure.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, thread, &raw const attr, 0) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cpu_that_cannot_exist_is_refused() {
        assert!(pin_to(Cpu(usize::MAX)).is_err());
        assert!(pin_to(Cpu(1023)).is_err());
    }

    #[test]
    fn a_reservation_larger_than_its_period_is_refused() {
        use crate::time::Nanos;
        let r = Reservation { runtime: Nanos::from_millis(2), period: Nanos::from_millis(1) };
        assert_eq!(become_deadline(r).unwrap_err().raw_os_error(), Some(libc::EINVAL));
    }
}
