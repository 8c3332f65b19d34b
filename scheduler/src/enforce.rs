//! From an instant to a kernel call.
//!
//! Everything here is one system call or two, on the calling thread, without allocation: the
//! PLC's path runs through [`sleep_until`] in every cycle.

use std::io;
use std::mem;

use crate::reservation::Reservation;
use crate::table::Cpu;
use crate::time::{Ticks, Tsc, TscFrequency};

/// Pins the calling thread to one CPU. Must come before [`become_deadline`]: the kernel refuses
/// to change the affinity of a deadline thread (`EBUSY`).
///
/// # Errors
/// `EINVAL` if the CPU does not exist, is offline or is outside the process's cpuset.
pub fn pin_to(cpu: Cpu) -> io::Result<()> {
    // SAFETY: an all-zero cpu_set_t is the valid empty set.
    let mut set: libc::cpu_set_t = unsafe { mem::zeroed() };
    if cpu.0 >= libc::CPU_SETSIZE as usize {
        return Err(io::Error::from_raw_os_error(libc::EINVAL));
    }
    // SAFETY: CPU_SET writes within the set, whose size was checked above; the pointer handed to
    // the kernel is to a live set of the length given.
    let result = unsafe {
        libc::CPU_SET(cpu.0, &mut set);
        libc::sched_setaffinity(0, size_of_val(&set), &raw const set)
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

/// How a sleep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Woken {
    /// The instant has come, or had already passed.
    OnTime,
    /// A signal arrived first.
    BySignal,
}

/// Sleeps until the TSC reaches `instant`, at the earliest.
///
/// The kernel sleeps on CLOCK_MONOTONIC, which is steered, while the schedule lies on the TSC,
/// which is not. The two are therefore compared afresh for each sleep: steering (at most 500 ppm)
/// can move this wake-up by half a microsecond per millisecond of sleep, and never adds up.
pub fn sleep_until(instant: Tsc, frequency: TscFrequency) -> Woken {
    let mut at = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `at` is a live timespec that the call fills in. It cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut at) };
    let Ticks(remaining) = instant.since(Tsc::now());
    if remaining == 0 {
        return Woken::OnTime;
    }
    let ns = frequency.nanos(Ticks(remaining)).0.saturating_add(at.tv_nsec as u64);
    at.tv_sec += (ns / 1_000_000_000) as libc::time_t;
    at.tv_nsec = (ns % 1_000_000_000) as libc::c_long;
    // SAFETY: `at` is a live, normalised timespec; no remainder is asked for.
    let result = unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &raw const at,
            std::ptr::null_mut(),
        )
    };
    if result == libc::EINTR { Woken::BySignal } else { Woken::OnTime }
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
    fn an_instant_that_has_passed_does_not_sleep() {
        let frequency = TscFrequency::from_khz(1).unwrap();
        assert_eq!(sleep_until(Tsc(0), frequency), Woken::OnTime);
    }

    #[test]
    fn a_sleep_does_not_end_early() {
        // The frequency is a lower bound here: a faster counter only makes the sleep longer.
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let until = Tsc::now().after(Ticks(1_000_000));
        sleep_until(until, frequency);
        assert!(Tsc::now() >= until);
    }

    #[test]
    fn a_reservation_larger_than_its_period_is_refused() {
        use crate::time::Nanos;
        let r = Reservation { runtime: Nanos::from_millis(2), period: Nanos::from_millis(1) };
        assert_eq!(become_deadline(r).unwrap_err().raw_os_error(), Some(libc::EINVAL));
    }
}
