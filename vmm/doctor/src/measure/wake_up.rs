//! Being a PLC for a while: how late are wake-ups, and how long is the CPU away in a window?
//!
//! A thread does on each CPU with windows what a PLC's thread does there: it sleeps until the guard
//! before a release, and then looks at the counter without a break until its window ends. When it
//! wakes is the wake-up latency; where two readings lie far apart, something has taken the CPU: an
//! interrupt, the firmware, a hypervisor. The kernel's `hwlat` tracer looks for the same with
//! interrupts off, but it needs root and changes the tracer of the host.
//!
//! The thread is of the class that a run's would be, if the kernel admits it, else of SCHED_FIFO,
//! which wakes up as early, else an ordinary one, and then it says so: the time of other programs
//! counts in. It never takes more of the CPU than the partition file does.

use std::io;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use takt_scheduler::enforce::{become_deadline, pin_to};
use takt_scheduler::reservation::{KICK_MARGIN, Reservation};
use takt_scheduler::sleep::{Sleeper, WakeUps};
use takt_scheduler::table::GUARD_MAX;
use takt_scheduler::time::{Nanos, Tsc, TscFrequency};

use crate::demand::{Demand, WindowedCpu};
use crate::finding::Finding;
use crate::host::Host;

/// A break between two readings from which on it counts, in ns: above what a reading takes.
const GAP: u64 = 1_000;
/// Windows before those that count: the first ones meet cold caches and pages.
const WARM_UP: u64 = 10;
/// Windows behind them without which nothing is good: a few that were on time may be chance.
const LEAST: u64 = 20;
/// Histograms hold times up to this, in ns.
const LONGEST: u64 = 10_000_000_000;

/// What kind of thread has measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// As in a run.
    Deadline,
    /// Where a deadline thread needs a scheduling domain of its own first.
    Fifo,
    /// Without privileges.
    Ordinary,
}

/// What was measured on one CPU.
#[derive(Debug)]
pub struct Measured {
    /// By which kind of thread.
    pub class: Class,
    /// Time from when the thread should have woken until it did, in ns, for each window.
    pub wake_ups: Histogram<u64>,
    /// Windows that had passed when the thread woke.
    pub lost: u64,
    /// Breaks in windows, in ns.
    pub gaps: Histogram<u64>,
}

impl Measured {
    /// True if there were too few windows to call anything good.
    fn is_short(&self) -> bool {
        self.wake_ups.len() < LEAST
    }
}

/// What a measurement of this CPU takes at least.
pub fn least_time(cpu: &WindowedCpu) -> Duration {
    // The first window begins a period after the start.
    Duration::from_nanos(cpu.period.0.saturating_mul(WARM_UP + LEAST + 1))
}

/// Measures until `end`, on a thread of its own, which is this one.
///
/// # Errors
/// If the thread cannot be pinned, or there is no memory for the histograms.
pub fn measure(cpu: &WindowedCpu, frequency: TscFrequency, end: Instant) -> io::Result<Measured> {
    let histogram = || Histogram::new_with_bounds(1, LONGEST, 3).map_err(io::Error::other);
    pin_to(cpu.cpu)?;
    let (wake_ups, gaps) = (histogram()?, histogram()?);
    let class = take_class(cpu);
    let mut measured = Measured { class, wake_ups, lost: 0, gaps };
    let period = frequency.ticks(cpu.period);
    let length = frequency.ticks(cpu.guard_or_usual().plus(cpu.window));
    let (mut sleeper, passed_over) = (Sleeper::new(frequency), WakeUps::default());
    let mut due = Tsc::now().after(period);
    let mut windows = 0u64;
    while Instant::now() < end {
        sleeper.until(due, &passed_over);
        let woken = Tsc::now();
        let counts = windows >= WARM_UP;
        if counts {
            let late = frequency.nanos(woken.since(due)).0;
            measured.wake_ups.saturating_record(late.max(1));
        }
        let last = watch(woken, due.after(length), |gap| {
            let ns = frequency.nanos(gap).0;
            if counts && ns >= GAP {
                measured.gaps.saturating_record(ns);
            }
        });
        windows += 1;
        due = due.after(period);
        // A window that is over before the thread has come to it is lost, as a PLC's would be.
        while due.after(length) <= last {
            due = due.after(period);
            measured.lost += u64::from(counts);
        }
    }
    Ok(measured)
}

/// Reads the counter until `end`, tells each break, and returns the last reading.
fn watch(start: Tsc, end: Tsc, mut tell: impl FnMut(takt_scheduler::time::Ticks)) -> Tsc {
    let mut last = start;
    while last < end {
        let now = Tsc::now();
        tell(now.since(last));
        last = now;
    }
    last
}

/// Becomes what a run's thread would be, or as near to it as the kernel allows.
fn take_class(cpu: &WindowedCpu) -> Class {
    let runtime = cpu.guard_or_usual().plus(cpu.window).plus(KICK_MARGIN).min(cpu.period);
    if become_deadline(Reservation { runtime, period: cpu.period }).is_ok() {
        return Class::Deadline;
    }
    // SAFETY: the pointer is to a live structure, which the kernel reads; 0 is this thread.
    let result = unsafe {
        let highest =
            libc::sched_param { sched_priority: libc::sched_get_priority_max(libc::SCHED_FIFO) };
        libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const highest)
    };
    if result == 0 { Class::Fifo } else { Class::Ordinary }
}

/// Says what it means: the wake-ups, and the gaps.
pub fn findings(
    host: &Host,
    demand: &Demand,
    cpu: &WindowedCpu,
    measured: Option<io::Result<Measured>>,
    interrupts: &str,
) -> Vec<Finding> {
    match measured {
        Some(Ok(measured)) => {
            vec![wake_ups(demand, cpu, &measured), gaps(host, demand, cpu, &measured, interrupts)]
        }
        Some(Err(error)) => vec![unmeasured(cpu, &error.to_string())],
        None => vec![unmeasured(cpu, "there was no thread for it, or it died")],
    }
}

/// What mends a measurement that was too short.
fn longer(demand: &Demand, cpu: &WindowedCpu) -> String {
    format!("{} --for {}ms # or longer", demand.command(), least_time(cpu).as_millis() + 1)
}

/// What mends a measurement by an ordinary thread.
fn as_root(demand: &Demand) -> String {
    format!("sudo {}", demand.command())
}

fn unmeasured(cpu: &WindowedCpu, why: &str) -> Finding {
    Finding::unseen(
        "wake-up",
        format!("CPU {}: not measured: {why}", cpu.cpu.0),
        "how late a PLC would be woken is not known",
        "ask again with that CPU online and in this process's cpuset",
    )
}

/// One late wake-up in a thousand makes a release late every second; a single one may be chance.
fn wake_ups(demand: &Demand, cpu: &WindowedCpu, measured: &Measured) -> Finding {
    const CHECK: &str = "wake-up";
    let (times, guard) = (&measured.wake_ups, cpu.guard_or_usual());
    let found = format!(
        "CPU {}, {} windows: {} at p50, {} at p99.9, {} at most; the guard is {guard}{}",
        cpu.cpu.0,
        times.len(),
        us(times.value_at_quantile(0.5)),
        us(times.value_at_quantile(0.999)),
        us(times.max()),
        beside(measured.class)
    );
    let found = match measured.lost {
        0 => found,
        n => format!("{found}; {n} windows more were slept through"),
    };
    let cost = "a release whose wake-up comes later than the guard is late; one that is slept through is lost";
    let remedy = match guard_for(cpu, times.max()) {
        Some(longer) if longer > guard => {
            format!(
                "mend what stands above, or in the partition file: release_guard = \"{longer}\""
            )
        }
        None if times.max() > guard.0 => {
            "mend what stands above: no guard is long enough for this".into()
        }
        // A break in a window takes those that follow, however early the next wake-up is.
        _ => "mend what stands above: no wake-up was later than the guard".into(),
    };
    if measured.class == Class::Ordinary {
        Finding::unseen(CHECK, found, cost, as_root(demand))
    } else if measured.lost > 0 || times.value_at_quantile(0.999) > guard.0 {
        Finding::cannot(CHECK, found, cost, remedy)
    } else if times.max() > guard.0 {
        Finding::warning(CHECK, found, cost, remedy)
    } else if measured.is_short() {
        let cost = "how late a PLC would be woken is not known";
        Finding::unseen(CHECK, format!("{found}; too few windows"), cost, longer(demand, cpu))
    } else {
        Finding::good(CHECK, found)
    }
}

/// What was seen and half as much, in whole steps of 10 us; `None` if the window leaves no time for
/// that.
fn guard_for(cpu: &WindowedCpu, latest: u64) -> Option<Nanos> {
    let guard = Nanos::from_micros(latest.saturating_mul(3).div_ceil(20_000).saturating_mul(10));
    let all = guard.plus(cpu.window).plus(KICK_MARGIN);
    (guard <= GUARD_MAX && all < cpu.period).then_some(guard)
}

/// A break no longer than the guard can make a release late by as much; one that is as long as a
/// window takes the window.
fn gaps(
    host: &Host,
    demand: &Demand,
    cpu: &WindowedCpu,
    measured: &Measured,
    interrupts: &str,
) -> Finding {
    const CHECK: &str = "latency";
    let (gaps, guard) = (&measured.gaps, cpu.guard_or_usual());
    let mut meanwhile = if interrupts.is_empty() {
        String::new()
    } else {
        format!("; interrupts there meanwhile: {interrupts}")
    };
    // Other than a deadline thread, one of SCHED_FIFO lets the kernel stop the tick (`sched_can_stop_tick`).
    if measured.class == Class::Fifo && host.nohz_full().contains(&cpu.cpu) {
        meanwhile += "; the ticks of a run are missing here: nohz_full stops them for SCHED_FIFO, but not for the threads of a run";
    }
    let found = match gaps.len() {
        0 => format!("CPU {}: never away for {} in a window{meanwhile}", cpu.cpu.0, us(GAP)),
        n => format!(
            "CPU {}: {n} times away for {} or more in a window, {} at most{meanwhile}",
            cpu.cpu.0,
            us(GAP),
            us(gaps.max())
        ),
    };
    let cost = "the scan that it falls into is longer by as much, and the release that it falls onto later";
    let remedy = "what is counted here and not above (interrupts, watchdogs) is the firmware's or a hypervisor's: its settings, or another machine";
    if measured.class == Class::Ordinary {
        return Finding::unseen(CHECK, found, cost, as_root(demand));
    }
    match gaps.max() {
        max if max >= cpu.window.0 => Finding::cannot(CHECK, found, cost, remedy),
        max if max > guard.0 => Finding::warning(CHECK, found, cost, remedy),
        _ if measured.is_short() => {
            let found = format!("{found}; {} windows are too few", measured.wake_ups.len());
            Finding::unseen(
                CHECK,
                found,
                "what is away in a window is not known",
                longer(demand, cpu),
            )
        }
        _ => Finding::good(CHECK, found),
    }
}

fn beside(class: Class) -> &'static str {
    match class {
        Class::Deadline => "",
        Class::Fifo => " (measured with SCHED_FIFO)",
        Class::Ordinary => " (an ordinary thread: other programs' time counts in)",
    }
}

/// A time in us, with the digits that matter.
fn us(ns: u64) -> String {
    let ns = Nanos(ns).0;
    format!("{}.{} us", ns / 1000, ns % 1000 / 100)
}

#[cfg(test)]
#[path = "wake_up_tests.rs"]
mod tests;
