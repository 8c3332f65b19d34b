//! The CPUs that partitions run on, and what they share.

use takt_scheduler::table::Cpu;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Host, written};

/// Whether all CPUs that the file names are there.
pub fn online(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "cpus";
    let online = host.online();
    let mut named = demand.cpus();
    named.extend(&demand.others);
    let missing: Vec<Cpu> = named.into_iter().filter(|cpu| !online.contains(cpu)).collect();
    if missing.is_empty() {
        return Finding::good(CHECK, format!("{} online", written(&online)));
    }
    let commands: Vec<String> = missing
        .iter()
        .map(|Cpu(cpu)| format!("echo 1 > /sys/devices/system/cpu/cpu{cpu}/online"))
        .collect();
    Finding::cannot(
        CHECK,
        format!("{} online; {} is not", written(&online), written(&missing)),
        "partitions that belong there cannot start",
        commands.join("; "),
    )
}

/// Whether a CPU with windows shares its core with another.
pub fn siblings(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "smt";
    let mut shared = Vec::new();
    let mut remedies = Vec::new();
    for cpu in demand.cpus() {
        let file = format!("sys/devices/system/cpu/cpu{}/topology/thread_siblings_list", cpu.0);
        let mut others = host.cpus(&file).unwrap_or_default();
        others.retain(|other| *other != cpu);
        if others.is_empty() {
            continue;
        }
        shared.push(format!("CPU {} shares its core with CPU {}", cpu.0, written(&others)));
        let named = |cpu: &Cpu| demand.has_windows_on(*cpu) || demand.others.contains(cpu);
        let (mut named, free): (Vec<Cpu>, Vec<Cpu>) = others.into_iter().partition(named);
        for Cpu(sibling) in free {
            // On many machines CPU 0 has none: it cannot be switched off.
            let file = format!("sys/devices/system/cpu/cpu{sibling}/online");
            remedies.push(match host.text(&file) {
                Some(_) => format!("echo 0 > /{file}"),
                None => format!(
                    "CPU {sibling} cannot be switched off: in the partition file, give the partitions of CPU {} another one",
                    cpu.0
                ),
            });
        }
        if !named.is_empty() {
            named.push(cpu);
            named.sort();
            let remedy = format!(
                "in the partition file, give the partitions of CPU {} CPUs of different cores",
                written(&named)
            );
            // Once for those of one core.
            if !remedies.contains(&remedy) {
                remedies.push(remedy);
            }
        }
    }
    if shared.is_empty() {
        return Finding::good(CHECK, "no core is shared");
    }
    Finding::warning(
        CHECK,
        shared.join(", "),
        "what runs on the sibling takes execution units and cache from the PLC at any moment, in its windows too",
        remedies.join("; "),
    )
}

/// Whether the kernel keeps the timers of a CPU without a tick on that CPU (`get_nohz_timer_target` in
/// `kernel/sched/core.c`).
pub fn timers(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "timers";
    let without = host.cpus("sys/devices/system/cpu/nohz_full").unwrap_or_default();
    let own: Vec<Cpu> = demand.cpus().into_iter().filter(|cpu| without.contains(cpu)).collect();
    if own.is_empty() || host.number("proc/sys/kernel/timer_migration") != Some(1) {
        return Finding::good(CHECK, "each CPU with windows keeps its own");
    }
    Finding::warning(
        CHECK,
        format!("the wake-ups of CPU {} may be another CPU's to make", written(&own)),
        "a wake-up waits until that CPU takes its interrupt, and has sent one",
        "sysctl kernel.timer_migration=0",
    )
}

/// Whether the host's tick stays away from CPUs that a PLC has for itself.
pub fn tick(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "tick";
    let online = host.online();
    if online.len() == 1 {
        return Finding::good(CHECK, "the host has one CPU, which keeps the time");
    }
    let without = host.cpus("sys/devices/system/cpu/nohz_full").unwrap_or_default();
    let (shared, own): (Vec<_>, Vec<_>) = demand.windowed.iter().partition(|w| w.shared);
    let own: Vec<Cpu> = own.into_iter().map(|w| w.cpu).collect();
    if own.is_empty() {
        let shared: Vec<Cpu> = shared.into_iter().map(|w| w.cpu).collect();
        let found = format!("CPU {} is shared with a Linux, whose time needs it", written(&shared));
        return Finding::good(CHECK, found);
    }
    let ticking: Vec<Cpu> = own.into_iter().filter(|cpu| !without.contains(cpu)).collect();
    if ticking.is_empty() {
        return Finding::good(
            CHECK,
            format!("none on CPU {} while one thread runs", written(&without)),
        );
    }
    let list = written(&ticking);
    let rest: Vec<Cpu> = online.into_iter().filter(|cpu| !demand.has_windows_on(*cpu)).collect();
    let rest =
        if rest.is_empty() { String::new() } else { format!(" irqaffinity={}", written(&rest)) };
    Finding::warning(
        CHECK,
        format!("CPU {list} has the host's tick"),
        "an interrupt of some microseconds in some of the windows, as often as CONFIG_HZ says",
        format!(
            "start the host with the kernel parameters nohz_full={list} rcu_nocbs={list}{rest}"
        ),
    )
}
