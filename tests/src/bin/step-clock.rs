//! Changes the rate of the kernel's clock, at one place of a period of that clock.
//!
//!     step-clock TICK PERIOD PLACE AFTER
//!
//! TICK is the new length of the kernel's tick, as adjtimex(2) has it. The others are us of CLOCK_MONOTONIC: the change comes at
//! the first instant, AFTER or more from now, that is PLACE into a PERIOD.
//!
//! Exit status 0: it is done; 1: a call has failed; 64: bad usage.

use std::io;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Option<Vec<i64>> =
        std::env::args().skip(1).map(|word| word.parse().ok()).collect();
    let Some(&[tick, period, place, after]) = arguments.as_deref() else {
        eprintln!("usage: step-clock TICK PERIOD PLACE AFTER");
        return ExitCode::from(64);
    };
    match wait(period, place, after).and_then(|()| step(tick)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("step-clock: {error}");
            ExitCode::FAILURE
        }
    }
}

fn wait(period: i64, place: i64, after: i64) -> io::Result<()> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: touches no memory. A sleep ends when it should, and not up to 50 us later.
    checked(unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1, 0, 0, 0) })?;
    // SAFETY: `time` is a live timespec that the call fills in.
    checked(unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) })?;
    let earliest = time.tv_sec * 1_000_000 + time.tv_nsec / 1_000 + after;
    let instant = earliest + (place - earliest).rem_euclid(period.max(1));
    time.tv_sec = instant / 1_000_000;
    time.tv_nsec = instant % 1_000_000 * 1_000;
    // SAFETY: `time` is a live, normalised timespec; no remainder is asked for.
    let slept = unsafe {
        let none = std::ptr::null_mut();
        libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &raw const time, none)
    };
    if slept == 0 { Ok(()) } else { Err(io::Error::from_raw_os_error(slept)) }
}

fn step(tick: i64) -> io::Result<()> {
    // SAFETY: all of it are integers, for which zeros are values.
    let mut change: libc::timex = unsafe { std::mem::zeroed() };
    change.modes = libc::ADJ_TICK;
    change.tick = tick;
    // SAFETY: `change` is live; the kernel reads and writes it.
    checked(unsafe { libc::adjtimex(&raw mut change) })
}

fn checked(result: libc::c_int) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
