//! What is looked up: each check is a function of the host and of what is asked of it.

mod clock;
mod console;
mod cpus;
mod interrupts;
mod kernel;
mod kvm;
mod memory;
mod pages;
mod platform;
mod power;
mod service;
mod shares;
mod watchdogs;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Capability, Host};

pub use clock::since;
pub use kernel::domain;
pub use kvm::with_option;

/// All checks, in the order of the report: from the machine up to what runs on it.
#[must_use]
pub fn all(host: &Host, demand: &Demand) -> Vec<Finding> {
    vec![
        privileges(host, demand),
        platform::bare_metal(host),
        platform::iommu(host, demand),
        clock::tsc(host),
        clock::watchdog(host),
        clock::steering(host),
        power::idle_states(host, demand),
        power::governor(host, demand),
        cpus::siblings(host, demand),
        cpus::online(host, demand),
        cpus::tick(host, demand),
        cpus::timers(host, demand),
        kernel::preemption(host),
        kernel::budget(host, demand),
        console::messages(host),
        kvm::clock_updates(host),
        kvm::recovery(host),
        kvm::nested(host),
        kvm::split_locks(host),
        interrupts::affinity(host, demand),
        interrupts::in_windows(demand),
        watchdogs::watchdogs(host, demand),
        memory::available(host, demand),
        memory::locking(host, demand),
        pages::moved(host),
        pages::huge(host),
        pages::set_aside(host, demand),
        shares::shares(host, demand),
        service::guardian(host),
    ]
}

/// Whether this process sees, and may try, all that there is.
fn privileges(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "privileges";
    let needed = [
        (Capability::Schedule, "CAP_SYS_NICE"),
        (Capability::LockMemory, "CAP_IPC_LOCK"),
        (Capability::Administer, "CAP_SYS_ADMIN"),
    ];
    let missing: Vec<_> = needed.iter().filter(|(c, _)| !host.may(*c)).map(|(_, n)| *n).collect();
    if missing.is_empty() {
        return Finding::good(CHECK, "all that takt needs");
    }
    Finding::unseen(
        CHECK,
        format!("this process has no {}", missing.join(", ")),
        "takt run needs them, and some of the checks below see less without them",
        format!("sudo {}", demand.command()),
    )
}

#[cfg(test)]
mod remedy_tests;
#[cfg(test)]
mod tests;
