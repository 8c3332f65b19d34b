//! The CPUs that partitions run on, and what they share.

use takt_host::cpu_list;
use takt_scheduler::table::Cpu;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Host, written};

/// Whether all CPUs that the file names are there.
pub fn online(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "cpus";
    let online = host.online();
    let missing: Vec<Cpu> =
        demand.named().into_iter().filter(|cpu| !online.contains(cpu)).collect();
    if missing.is_empty() {
        return Finding::good(CHECK, format!("{} online", written(&online)));
    }
    let remedy = |Cpu(cpu): &Cpu| {
        let file = format!("sys/devices/system/cpu/cpu{cpu}/online");
        match host.text(&file) {
            Some(_) => format!("echo 1 > /{file}"),
            None => {
                format!("this host has no CPU {cpu}: name another one in the partition file")
            }
        }
    };
    let remedies: Vec<String> = missing.iter().map(remedy).collect();
    Finding::cannot(
        CHECK,
        format!("{} online; {} is not", written(&online), written(&missing)),
        "partitions that belong there cannot start",
        remedies.join("; "),
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

/// Whether the kernel keeps the timers of a CPU of `nohz_full` on that CPU (`get_nohz_timer_target` in
/// `kernel/sched/core.c`).
pub fn timers(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "timers";
    let moving = host.nohz_full();
    let own: Vec<Cpu> = demand.cpus().into_iter().filter(|cpu| moving.contains(cpu)).collect();
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

/// What comes with the host's tick on CPUs that a PLC has for itself.
///
/// The tick itself stays: the kernel keeps it for each deadline thread, also with `nohz_full`
/// (`sched_can_stop_tick` in `kernel/sched/core.c`). Behind it the kernel cleans up (RCU), unless threads do
/// that elsewhere: with `rcu_nocbs`, or with `nohz_full`, which implies it.
pub fn tick(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "tick";
    let online = host.online();
    if online.len() == 1 {
        return Finding::good(CHECK, "the host has one CPU, which keeps the time");
    }
    let (shared, own): (Vec<_>, Vec<_>) = demand.windowed.iter().partition(|w| w.shared);
    let own: Vec<Cpu> = own.into_iter().map(|w| w.cpu).collect();
    if own.is_empty() {
        let shared: Vec<Cpu> = shared.into_iter().map(|w| w.cpu).collect();
        let found = format!("CPU {} is shared with a Linux, whose time needs it", written(&shared));
        return Finding::good(CHECK, found);
    }
    let found = format!("CPU {} has the host's tick, which deadline threads keep", written(&own));
    // Where the ticks of the CPUs do not lie together, takt run does not know where to place its epoch.
    if host.parameter("skew_tick").is_some_and(|value| value != "0") {
        return Finding::warning(
            CHECK,
            format!("{found}, and skew_tick moves it from CPU to CPU"),
            "takt run cannot keep its windows away from the tick, which takes some microseconds of some of them",
            "take skew_tick off the kernel's command line",
        );
    }
    let found = format!("{found}; takt run places its epoch to it if its windows leave room");
    let relieved = relieved(host, &online);
    let cleaning: Vec<Cpu> = own.into_iter().filter(|cpu| !relieved.contains(cpu)).collect();
    if cleaning.is_empty() {
        return Finding::good(CHECK, found);
    }
    let list = written(&cleaning);
    let rest: Vec<Cpu> = online.into_iter().filter(|cpu| !demand.has_windows_on(*cpu)).collect();
    let rest =
        if rest.is_empty() { String::new() } else { format!(" irqaffinity={}", written(&rest)) };
    Finding::warning(
        CHECK,
        format!("{found}; the kernel cleans up behind it (RCU) on CPU {list}"),
        "cleaning up, and interrupts of devices that are new, take some microseconds of some of the windows",
        format!("start the host with the kernel parameters rcu_nocbs={list}{rest}"),
    )
}

/// CPUs whose cleaning up is done elsewhere.
fn relieved(host: &Host, online: &[Cpu]) -> Vec<Cpu> {
    let mut cpus = host.nohz_full();
    let asked = host.parameter("rcu_nocbs").unwrap_or_default();
    // The kernel knows two words in lists of CPUs (`cpulist_parse`): all of them, and the last one.
    let last = online.last().map_or(0, |cpu| cpu.0).to_string();
    let asked = asked.replace("all", "0-N").replace('N', &last);
    cpus.extend(cpu_list::parse(&asked).unwrap_or_default());
    cpus
}
