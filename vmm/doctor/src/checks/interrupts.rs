//! Where the host's devices interrupt.

use takt_plan::Allowance;
use takt_scheduler::table::Cpu;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Host, written};

/// Most interrupts that are named one by one.
const NAMED: usize = 6;

/// Whether devices interrupt CPUs with windows.
pub fn affinity(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "interrupts";
    const COST: &str = "each interrupt that falls into a window makes a scan longer, or a release later, by some microseconds";
    let rest: Vec<Cpu> =
        host.online().into_iter().filter(|cpu| !demand.has_windows_on(*cpu)).collect();
    let mut there: Vec<(String, String)> = Vec::new();
    let text = match host.read("proc/interrupts") {
        Ok(text) => text,
        Err(error) => {
            let remedy = "see that none is for a CPU with windows: grep . /proc/irq/*/effective_affinity_list";
            return Finding::unseen(CHECK, format!("/proc/interrupts: {error}"), COST, remedy);
        }
    };
    for (number, name) in devices(&text) {
        let of = |file: &str| host.cpus(&format!("proc/irq/{number}/{file}"));
        // What is allowed is not always what the controller does.
        let cpus = of("effective_affinity_list").filter(|cpus| !cpus.is_empty());
        let cpus = cpus.or_else(|| of("smp_affinity_list")).unwrap_or_default();
        if cpus.into_iter().any(|cpu| demand.has_windows_on(cpu)) {
            there.push((number, name));
        }
    }
    if there.is_empty() {
        return Finding::good(CHECK, "no device interrupts a CPU with windows");
    }
    let named: Vec<String> =
        there.iter().take(NAMED).map(|(number, name)| format!("{number} {name}")).collect();
    let more = there
        .len()
        .checked_sub(NAMED + 1)
        .map_or(String::new(), |n| format!(" and {} more", n + 1));
    let found = format!("CPU {} takes {}{more}", written(&demand.cpus()), named.join(", "));
    if rest.is_empty() {
        return Finding::good(CHECK, format!("{found}: no CPU without windows could"));
    }
    let numbers: Vec<&str> = there.iter().map(|(number, _)| number.as_str()).collect();
    Finding::warning(
        CHECK,
        found,
        COST,
        // The kernel places what refuses by itself (`irq_do_set_affinity` in kernel/irq/manage.c), and the word
        // managed_irq alone leaves scheduling domains as they are.
        format!(
            "for i in {}; do echo {} > /proc/irq/$i/smp_affinity_list; done # and end irqbalance; for what refuses: the kernel parameter isolcpus=managed_irq,{}, or fewer queues of that driver",
            numbers.join(" "),
            written(&rest),
            written(&demand.cpus())
        ),
    )
}

/// What the host may interrupt each window with although all is well. `takt check` allows for it in response times.
pub fn in_windows(demand: &Demand) -> Finding {
    const CHECK: &str = "window-interrupts";
    if demand.interrupts.is_empty() {
        return Finding::good(
            CHECK,
            match demand.file {
                Some(_) => "there is no PLC",
                None => "a partition file says how many may come in a window",
            },
        );
    }
    let of = |(name, allowance): &(String, Allowance)| {
        let terms = allowance.terms().into_iter().filter(|(count, _)| *count > 0);
        let terms: Vec<String> = terms.map(|(count, what)| format!("{count} for {what}")).collect();
        format!("{name}: up to {} in a window: {}", allowance.time(), terms.join(", "))
    };
    let found: Vec<String> = demand.interrupts.iter().map(of).collect();
    Finding::good(CHECK, found.join("; "))
}

/// Numbers and names of devices' interrupts, from `/proc/interrupts`: a number, a count for each
/// CPU, the controller, the line, the names. The old timer is none of them: it cannot be moved, and is silent
/// once the machine has started.
pub fn devices(text: &str) -> Vec<(String, String)> {
    let cpus = text.lines().next().map_or(0, |header| header.split_whitespace().count());
    let devices = text.lines().skip(1).filter_map(|line| {
        let (number, rest) = line.trim().split_once(':')?;
        number.parse::<u32>().ok()?;
        let names: Vec<&str> = rest.split_whitespace().skip(cpus + 2).collect();
        Some((number.to_owned(), names.join(" ")))
    });
    devices.filter(|(_, name)| !name.is_empty() && name != "timer").collect()
}
