//! What the processor does to save power.

use takt_scheduler::table::Cpu;

use crate::demand::{Demand, WindowedCpu};
use crate::finding::Finding;
use crate::host::Host;

/// Whether each CPU with windows wakes up within the guard from every idle state it may enter.
///
/// The kernel states the longest time that leaving a state takes
/// (`Documentation/admin-guide/pm/cpuidle.rst`, "latency").
pub fn idle_states(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "c-states";
    let mut deepest = None;
    let mut deep = Vec::new();
    for WindowedCpu { cpu: Cpu(cpu), guard, .. } in &demand.windowed {
        let Some(guard) = guard else { continue };
        let folder = format!("sys/devices/system/cpu/cpu{cpu}/cpuidle");
        for state in host.names(&folder) {
            let of = |file: &str| format!("{folder}/{state}/{file}");
            let Some(latency_us) = host.number(&of("latency")) else { continue };
            if host.number(&of("disable")).unwrap_or(0) != 0 {
                continue;
            }
            deepest = deepest.max(Some(latency_us));
            if latency_us.saturating_mul(1000) > guard.0 {
                let name = host.text(&of("name")).unwrap_or_else(|| state.clone());
                deep.push((format!("CPU {cpu}: {name} takes {latency_us} us"), of("disable")));
            }
        }
    }
    if deep.is_empty() {
        let found = match deepest {
            Some(us) => format!("leaving the deepest takes {us} us, within the guard"),
            None => "the kernel uses none".into(),
        };
        return Finding::good(CHECK, found);
    }
    let (found, files): (Vec<_>, Vec<_>) = deep.into_iter().unzip();
    Finding::cannot(
        CHECK,
        found.join(", "),
        "after an idle time the PLC is woken later than its guard: a late release",
        format!(
            "echo 1 | tee {}",
            files.iter().map(|f| format!("/{f}")).collect::<Vec<_>>().join(" ")
        ),
    )
}

/// Whether CPUs with windows always run at the same frequency.
pub fn governor(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "governor";
    let mut slow = Vec::new();
    let mut any = false;
    for Cpu(cpu) in demand.cpus() {
        let file = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
        let Some(governor) = host.text(&file) else { continue };
        any = true;
        if governor != "performance" {
            slow.push((format!("CPU {cpu}: {governor}"), format!("/{file}")));
        }
    }
    if slow.is_empty() {
        let found = if any { "performance" } else { "the kernel does not change the frequency" };
        return Finding::good(CHECK, found);
    }
    let (found, files): (Vec<_>, Vec<_>) = slow.into_iter().unzip();
    Finding::warning(
        CHECK,
        found.join(", "),
        "scans that follow an idle time run slowly, and their length varies with the load",
        format!("echo performance | tee {}", files.join(" ")),
    )
}
