//! Do the CPUs' time-stamp counters show the same time?
//!
//! The test of `arch/x86/kernel/tsc_sync.c`: two CPUs take turns under one lock, and each reading
//! must be later than the last one of the other. Takt's guests compare instants across CPUs.

use std::arch::x86_64::_mm_lfence;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use takt_scheduler::enforce::pin_to;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::Tsc;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Host, written};

/// Time for each pair.
const TIME: Duration = Duration::from_millis(20);
/// Most CPUs that are compared, beside those that have to be.
const CPUS_MAX: usize = 64;

/// Compares a CPU that matters with each of the others.
pub fn finding(host: &Host, demand: &Demand) -> Finding {
    let (online, named) = (host.online(), demand.named());
    let package = |cpu: Cpu| {
        host.number(&format!("sys/devices/system/cpu/cpu{}/topology/physical_package_id", cpu.0))
    };
    let all = choose(&online, &named, package);
    let first = all.iter().find(|cpu| online.contains(cpu)).or(all.first()).copied();
    let Some(first) = first.filter(|_| all.len() > 1) else {
        return Finding::good("tsc-equal", "one CPU");
    };
    let others = all.into_iter().filter(|other| *other != first);
    let pairs: Vec<_> = others.map(|other| (other, between(first, other))).collect();
    judge(first, &pairs, &named)
}

/// Which CPUs are compared: those that are named; one of each package, since the CPUs of one mostly count alike;
/// and of the rest as many as there is time for.
fn choose(online: &[Cpu], named: &[Cpu], package: impl Fn(Cpu) -> Option<u64>) -> Vec<Cpu> {
    let mut chosen: Vec<Cpu> = Vec::new();
    for &cpu in named {
        if !chosen.contains(&cpu) {
            chosen.push(cpu);
        }
    }
    let mut packages: Vec<Option<u64>> = chosen.iter().map(|cpu| package(*cpu)).collect();
    let mut rest = Vec::new();
    for &cpu in online.iter().filter(|cpu| !named.contains(cpu)) {
        let own = package(cpu);
        if packages.contains(&own) {
            rest.push(cpu);
        } else {
            packages.push(own);
            chosen.push(cpu);
        }
    }
    chosen.extend(rest.into_iter().take(CPUS_MAX));
    chosen
}

/// `named` are the CPUs without which nothing is good.
fn judge(first: Cpu, pairs: &[(Cpu, Pair)], named: &[Cpu]) -> Finding {
    const CHECK: &str = "tsc-equal";
    const UNKNOWN: &str =
        "an instant that one partition has stamped could lie in the future of another";
    let missed = pairs.iter().filter(|(cpu, pair)| pair.turns <= 1 && named.contains(cpu));
    let missed: Vec<Cpu> = missed.map(|(cpu, _)| *cpu).collect();
    let compared = pairs.iter().filter(|(_, pair)| pair.turns > 1).count();
    let worst = pairs.iter().max_by_key(|(_, pair)| pair.back);
    match worst {
        Some((other, pair)) if pair.back > 0 => Finding::cannot(
            CHECK,
            format!("CPU {} and CPU {} differ by {} ticks", first.0, other.0, pair.back),
            "an instant that one partition has stamped lies in the future of another",
            "the firmware's update; in a virtual machine: run takt on the machine itself",
        ),
        _ if compared == 0 => Finding::unseen(
            CHECK,
            "no two CPUs would run this process by turns",
            UNKNOWN,
            "ask again with all CPUs in this process's cpuset",
        ),
        _ if !missed.is_empty() => Finding::unseen(
            CHECK,
            format!("CPU {} could not be compared with CPU {}", written(&missed), first.0),
            UNKNOWN,
            "ask again with these CPUs online and in this process's cpuset",
        ),
        _ => Finding::good(CHECK, format!("no reading went back between {} CPUs", compared + 1)),
    }
}

/// What two CPUs have seen.
#[derive(Clone, Copy, Debug, Default)]
struct Pair {
    /// How often the other CPU had read last.
    turns: u64,
    /// By how many ticks a reading was before it, at most.
    back: u64,
}

/// The last reading, whose it is, and what was seen so far.
#[derive(Default)]
struct Shared {
    last: u64,
    by: usize,
    pair: Pair,
}

fn between(first: Cpu, second: Cpu) -> Pair {
    let shared = Arc::new(Mutex::new(Shared { by: first.0, ..Shared::default() }));
    let threads = [first, second].map(|cpu| {
        let shared = Arc::clone(&shared);
        thread::Builder::new().spawn(move || {
            if pin_to(cpu).is_err() {
                return;
            }
            let end = Instant::now() + TIME;
            while Instant::now() < end {
                let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
                // The counter is not read before the lock is held.
                // SAFETY: every x86-64 processor has SSE2; a fence touches no memory.
                unsafe { _mm_lfence() };
                let now = Tsc::now().0;
                let Shared { last, by, pair } = &mut *shared;
                if *by != cpu.0 {
                    pair.turns += 1;
                    pair.back = pair.back.max(last.saturating_sub(now));
                }
                (*last, *by) = (now, cpu.0);
            }
        })
    });
    for thread in threads.into_iter().flatten() {
        // It cannot panic; if it has, or never was, it has seen nothing.
        let _ = thread.join();
    }
    shared.lock().unwrap_or_else(PoisonError::into_inner).pair
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Severity;
    use crate::recorded::Recorded;

    #[test]
    fn a_reading_that_goes_back_is_found() {
        let pair = |turns, back| Pair { turns, back };
        let judged = |pairs: &[(Cpu, Pair)]| judge(Cpu(0), pairs, &[Cpu(0), Cpu(2)]).severity;
        assert_eq!(judged(&[(Cpu(1), pair(9, 0)), (Cpu(2), pair(5, 0))]), Severity::Good);
        assert_eq!(judged(&[(Cpu(1), pair(9, 7)), (Cpu(2), pair(5, 0))]), Severity::Cannot);
        assert_eq!(judged(&[(Cpu(1), pair(0, 0))]), Severity::Unseen);
        // Only a CPU that is named has to be compared.
        assert_eq!(judged(&[(Cpu(1), pair(0, 0)), (Cpu(2), pair(5, 0))]), Severity::Good);
        assert_eq!(judged(&[(Cpu(1), pair(9, 0)), (Cpu(2), pair(1, 0))]), Severity::Unseen);
    }

    #[test]
    fn the_plcs_cpu_and_each_package_are_compared_however_many_cpus_there_are() {
        let online: Vec<Cpu> = (0..192).map(Cpu).collect();
        let chosen = choose(&online, &[Cpu(191), Cpu(3)], |cpu| Some(cpu.0 as u64 / 48));
        assert_eq!(chosen[..5], [191, 3, 48, 96, 0].map(Cpu));
        assert_eq!(chosen.len(), 4 + CPUS_MAX);
        // One that is not there is asked for all the same, and nothing is asked for twice.
        assert_eq!(
            choose(&[Cpu(0), Cpu(1)], &[Cpu(8), Cpu(1), Cpu(8)], |_| None),
            [8, 1, 0].map(Cpu)
        );
    }

    #[test]
    fn a_cpu_that_cannot_be_compared_is_told() {
        let host = Recorded::named("appliance-rt").unpack();
        let mut demand = Demand::usual(&host.host);
        assert_eq!(finding(&host.host, &demand).found, "one CPU");
        demand.others.push(Cpu(60_000));
        let unseen = finding(&host.host, &demand);
        assert_eq!(unseen.severity, Severity::Unseen);
    }
}
