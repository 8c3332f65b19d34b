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

use crate::finding::Finding;

/// Time for each pair.
const TIME: Duration = Duration::from_millis(20);
/// Most CPUs that are compared with the first.
const CPUS_MAX: usize = 64;

/// Compares the first CPU with each of the others.
pub fn finding(online: &[Cpu]) -> Finding {
    let Some((&first, others)) = online.split_first().filter(|(_, others)| !others.is_empty())
    else {
        return Finding::good("tsc-equal", "one CPU");
    };
    let pairs: Vec<_> =
        others.iter().take(CPUS_MAX).map(|&other| (other, between(first, other))).collect();
    judge(first, &pairs)
}

fn judge(first: Cpu, pairs: &[(Cpu, Pair)]) -> Finding {
    const CHECK: &str = "tsc-equal";
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
            "an instant that one partition has stamped could lie in the future of another",
            "ask again with all CPUs in this process's cpuset",
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

    #[test]
    fn a_reading_that_goes_back_is_found() {
        let pair = |turns, back| Pair { turns, back };
        let judged = |pairs: &[(Cpu, Pair)]| judge(Cpu(0), pairs).severity;
        assert_eq!(judged(&[(Cpu(1), pair(9, 0)), (Cpu(2), pair(5, 0))]), Severity::Good);
        assert_eq!(judged(&[(Cpu(1), pair(9, 7)), (Cpu(2), pair(5, 0))]), Severity::Cannot);
        assert_eq!(judged(&[(Cpu(1), pair(0, 0))]), Severity::Unseen);
    }
}
