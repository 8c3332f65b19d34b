//! A PLC as an ordinary program, to compare Takt with: the control program of the demo guest, in a
//! thread of the host's that sleeps from release to release.
//!
//!     soft-plc fifo|deadline CYCLES GUARD_US
//!
//! Cycles of 1 ms. With a guard, the thread wakes that much early and waits for the instant, as a
//! guest of Takt does. Prints one line of JSON: times in ns from the release to the scan's start.

// The same source as in the guest, so that both compute the same.
#[path = "../../../plc-guest/src/control/mod.rs"]
mod control;

use std::io;
use std::process::ExitCode;
use std::time::Duration;

use control::blinker::Blinker;
use control::pid::{Gains, Pid};
use control::tank::Tank;

const PERIOD_NS: u64 = 1_000_000;
/// From the start to the first release.
const DELAY_NS: u64 = 10_000_000;
/// What SCHED_DEADLINE grants in each period: far more than a scan and a guard take.
const RUNTIME_NS: u64 = 300_000;
/// Later than this a release is late; the guard that Takt is measured with.
const LATE_NS: u64 = 20_000;
const FIFO_PRIORITY: i32 = 80;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [policy, cycles, guard] = arguments.as_slice() else { return usage() };
    let (Ok(cycles), Ok(guard_us)) = (cycles.parse::<u64>(), guard.parse::<u64>()) else {
        return usage();
    };
    let set = match policy.as_str() {
        "fifo" => set_fifo(),
        "deadline" => set_deadline(),
        _ => return usage(),
    };
    match set.and_then(|()| run(cycles, guard_us * 1000)) {
        Ok(latencies) => {
            println!("{}", summary(policy, guard_us, cycles, latencies));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("soft-plc: {error}");
            ExitCode::FAILURE
        }
    }
}

fn usage() -> ExitCode {
    eprintln!("usage: soft-plc fifo|deadline CYCLES GUARD_US");
    ExitCode::from(64)
}

/// Runs the cycles; the latency of each release that was not lost.
fn run(cycles: u64, guard_ns: u64) -> io::Result<Vec<u64>> {
    let mut tank = Tank::default();
    let mut controller = Pid::new(Gains { proportional: 4.0, integral: 0.5, derivative: 0.2 });
    let mut blinker = Blinker::new(Duration::from_millis(500));
    let (mut valve, mut lamp) = (0.0, false);
    let mut latencies = Vec::with_capacity(usize::try_from(cycles).unwrap_or(0));
    lock_memory()?;
    let first = now()? + DELAY_NS;
    let mut last = first;
    let mut cycle = 0;
    while cycle < cycles {
        let release = first + cycle * PERIOD_NS;
        sleep_until(release - guard_ns)?;
        let mut start = now()?;
        while start < release {
            start = now()?;
        }
        let elapsed = Duration::from_nanos(start - last);
        last = start;
        tank.update(valve, elapsed);
        valve = controller.update(1.2, tank.level(), elapsed);
        lamp ^= blinker.update(elapsed);
        latencies.push(start - release);
        // A release that has passed meanwhile is lost, as a PLC's cycle would be.
        cycle = cycle.max((now()? - first) / PERIOD_NS) + 1;
    }
    std::hint::black_box((valve, lamp));
    Ok(latencies)
}

fn summary(policy: &str, guard_us: u64, cycles: u64, mut latencies: Vec<u64>) -> serde_json::Value {
    latencies.sort_unstable();
    let releases = latencies.len() as u64;
    let at = |per_mille: usize| {
        let place = (latencies.len() * per_mille / 1000).min(latencies.len().saturating_sub(1));
        latencies.get(place).copied().unwrap_or(0)
    };
    serde_json::json!({
        "policy": policy, "guard_us": guard_us, "releases": releases, "lost": cycles - releases,
        "late_releases": latencies.iter().filter(|&&ns| ns > LATE_NS).count(),
        "release_latency_ns": {
            "min": at(0), "p50": at(500), "p99": at(990), "p999": at(999), "max": at(1000),
        },
    })
}

fn now() -> io::Result<u64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the C library writes to `time`, which lives through the call.
    check(unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) })?;
    Ok((time.tv_sec * 1_000_000_000 + time.tv_nsec).cast_unsigned())
}

fn sleep_until(ns: u64) -> io::Result<()> {
    let ns = ns.cast_signed();
    let time = libc::timespec { tv_sec: ns / 1_000_000_000, tv_nsec: ns % 1_000_000_000 };
    // SAFETY: the kernel reads `time`; nothing is written back for an absolute instant.
    let error = unsafe {
        let absolute = libc::TIMER_ABSTIME;
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            absolute,
            &raw const time,
            std::ptr::null_mut(),
        )
    };
    if error == 0 { Ok(()) } else { Err(io::Error::from_raw_os_error(error)) }
}

fn lock_memory() -> io::Result<()> {
    // SAFETY: changes how the process's memory is kept, not what is in it.
    check(unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) })
}

fn set_fifo() -> io::Result<()> {
    let priority = libc::sched_param { sched_priority: FIFO_PRIORITY };
    // SAFETY: the kernel reads `priority`.
    check(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) })
}

fn set_deadline() -> io::Result<()> {
    let attributes = libc::sched_attr {
        size: size_of::<libc::sched_attr>() as u32,
        sched_policy: libc::SCHED_DEADLINE as u32,
        sched_flags: 0,
        sched_nice: 0,
        sched_priority: 0,
        sched_runtime: RUNTIME_NS,
        sched_deadline: PERIOD_NS,
        sched_period: PERIOD_NS,
    };
    // SAFETY: the kernel reads `attributes`, whose length they hold.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
