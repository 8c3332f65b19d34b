//! The kernel's own watchdogs, which look at every CPU from time to time.

use takt_scheduler::table::Cpu;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Host, written};

/// Whether they look at CPUs with windows.
///
/// The soft one runs a thread of the stopper class, which comes before SCHED_DEADLINE, every four
/// seconds; the hard one is a non-maskable interrupt (`kernel/watchdog.c`).
pub fn watchdogs(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "watchdogs";
    let watched = host.cpus("proc/sys/kernel/watchdog_cpumask").unwrap_or_default();
    let on = |name: &str| host.number(&format!("proc/sys/kernel/{name}")) == Some(1);
    let kinds: Vec<&str> = [("soft_watchdog", "soft"), ("nmi_watchdog", "hard")]
        .into_iter()
        .filter(|(name, _)| on(name))
        .map(|(_, kind)| kind)
        .collect();
    if kinds.is_empty() || !watched.iter().any(|cpu| demand.has_windows_on(*cpu)) {
        return Finding::good(CHECK, "none on a CPU with windows");
    }
    let rest: Vec<Cpu> =
        host.online().into_iter().filter(|cpu| !demand.has_windows_on(*cpu)).collect();
    let remedy = match rest.is_empty() {
        true => "sysctl kernel.watchdog=0".to_owned(),
        false => format!("sysctl kernel.watchdog_cpumask={}", written(&rest)),
    };
    Finding::warning(
        CHECK,
        format!("{} lockup detection on CPU {}", kinds.join(" and "), written(&demand.cpus())),
        "every few seconds some microseconds of a window, which nothing that takt does can move",
        remedy,
    )
}
