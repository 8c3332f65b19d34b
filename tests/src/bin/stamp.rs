//! Prints what a clock says beside the TSC, which guests and host of Takt share: two such lines, wherever they were
//! printed, say how far two clocks are from each other.
//!
//!     stamp NAME            prints "stamp NAME TSC NANOSECONDS" of the time of day, from the closest of some tries
//!     stamp NAME DEVICE     the same of a PTP clock, such as /dev/ptp0
//!     stamp set DEVICE      sets the time of day by a PTP clock

use std::arch::x86_64::_rdtsc;
use std::env;
use std::fs::File;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd, RawFd};

/// So that no interrupt lies between the two looks of the best.
const TRIES: usize = 100;
/// In nanoseconds.
const SECOND: i128 = 1_000_000_000;

fn main() -> io::Result<()> {
    let mut arguments = env::args().skip(1);
    let name = arguments.next().unwrap_or_default();
    let (clock, _device) = match arguments.next().as_deref() {
        None => (libc::CLOCK_REALTIME, None),
        Some(device) => {
            let device = File::open(device)?;
            (clock_of(device.as_raw_fd()), Some(device))
        }
    };
    if name == "set" {
        return set_by(clock);
    }
    let (tsc, now) = closest(|| Ok(i128::from(tsc())), clock)?;
    println!("stamp {name} {tsc} {now}");
    Ok(())
}

/// What `other` and `clock` say at the same instant, the latter in nanoseconds.
fn closest(
    other: impl Fn() -> io::Result<i128>,
    clock: libc::clockid_t,
) -> io::Result<(i128, i128)> {
    let mut best: Option<(i128, i128, i128)> = None;
    for _ in 0..TRIES {
        let before = other()?;
        let now = now(clock)?;
        let took = other()? - before;
        if best.is_none_or(|(shortest, ..)| took < shortest) {
            best = Some((took, before + took / 2, now));
        }
    }
    best.map(|(_, other, now)| (other, now)).ok_or_else(|| io::Error::other("no try"))
}

fn tsc() -> u64 {
    // SAFETY: every processor that Takt runs on has the instruction, and it changes no memory.
    unsafe { _rdtsc() }
}

/// The number of the clock behind a descriptor (`clock_getres(2)`, dynamic clocks).
fn clock_of(device: RawFd) -> libc::clockid_t {
    (!device << 3) | 3
}

fn now(clock: libc::clockid_t) -> io::Result<i128> {
    let mut time = MaybeUninit::uninit();
    // SAFETY: the kernel writes to the structure, which lives.
    if unsafe { libc::clock_gettime(clock, time.as_mut_ptr()) } != 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the call has succeeded, so the kernel has written it.
    let libc::timespec { tv_sec, tv_nsec } = unsafe { time.assume_init() };
    Ok(i128::from(tv_sec) * SECOND + i128::from(tv_nsec))
}

/// Moves the time of day by as much as it is beside `clock`.
fn set_by(clock: libc::clockid_t) -> io::Result<()> {
    let (day, clock) = closest(|| now(libc::CLOCK_REALTIME), clock)?;
    let beside = clock - day;
    // SAFETY: the structure has only numbers, for which zero is one.
    let mut change: libc::timex = unsafe { MaybeUninit::zeroed().assume_init() };
    change.modes = libc::ADJ_SETOFFSET | libc::ADJ_NANO;
    let too_far = |_| io::Error::other("the clocks are too far from each other");
    change.time.tv_sec = beside.div_euclid(SECOND).try_into().map_err(too_far)?;
    change.time.tv_usec = beside.rem_euclid(SECOND).try_into().map_err(too_far)?;
    // SAFETY: the kernel reads and writes the structure, which lives.
    let result = unsafe { libc::clock_adjtime(libc::CLOCK_REALTIME, &raw mut change) };
    if result >= 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
