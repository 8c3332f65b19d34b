//! Does KVM have what Takt needs, and does it run guests on the processor itself?

use std::io;

use takt_host::kvm::{Found, Machines, Speed};

use crate::checks;
use crate::demand::Demand;
use crate::examination::ExaminationError;
use crate::finding::Finding;
use crate::host::Host;

const CHECK: &str = "kvm";
const NO_START: &str = "takt run does not start";

/// Of KVM: what it offers, whether the machines of a PLC and of a Linux can be made, how fast their
/// kernel-mode code runs.
pub fn findings(
    host: &Host,
    demand: &Demand,
    examined: &Result<Found, ExaminationError>,
) -> Vec<Finding> {
    match examined {
        Err(error) => vec![Finding::unseen(
            CHECK,
            error.to_string(),
            "nothing is known of KVM, without which takt run does not start",
            "install takt and takt-doctor of one version in one folder",
        )],
        Ok(Found::Closed { errno }) => vec![closed(host, demand, *errno)],
        Ok(Found::Lacking { missing }) => vec![Finding::cannot(
            CHECK,
            format!("KVM lacks {}", missing.join(", ")),
            NO_START,
            "start a newer kernel on the host",
        )],
        Ok(Found::Complete(machines)) => of_machines(host, demand.linux, machines),
    }
}

fn of_machines(host: &Host, linux: bool, machines: &Machines) -> Vec<Finding> {
    let of_linux = machines.linux_error.as_ref().filter(|_| linux);
    if let Some(error) = machines.plc_error.as_ref().or(of_linux) {
        return vec![Finding::cannot(
            CHECK,
            error.clone(),
            NO_START,
            "start a newer kernel on the host; under a hypervisor, look for its KVM",
        )];
    }
    let mut findings = vec![
        Finding::good(CHECK, "has what takt needs"),
        speed(&machines.speed),
        bus_locks(host, machines.tells_bus_locks),
    ];
    if linux {
        findings.push(deadlines(host, machines.hands_deadlines_over));
    }
    findings
}

/// Why `/dev/kvm` cannot be opened.
fn closed(host: &Host, demand: &Demand, errno: i32) -> Finding {
    let error = io::Error::from_raw_os_error(errno);
    let found = format!("/dev/kvm: {error}");
    if error.kind() == io::ErrorKind::PermissionDenied {
        return Finding::unseen(CHECK, found, NO_START, format!("sudo {}", demand.command()));
    }
    let module = [("vmx", "kvm-intel"), ("svm", "kvm-amd")];
    let remedy = match module.iter().find(|(feature, _)| host.has_feature(feature)) {
        Some((_, name)) => format!("modprobe {name}"),
        None => "switch hardware virtualisation (VT-x, AMD-V) on in the firmware; in a virtual machine, nesting in its hypervisor".into(),
    };
    Finding::cannot(CHECK, found, NO_START, remedy)
}

/// Whether a Linux's timers can be kept out of windows. `None`: it could not be found out.
fn deadlines(host: &Host, handed_over: Option<bool>) -> Finding {
    const CHECK: &str = "deadlines";
    const TIMER: &str = "sys/module/kvm_intel/parameters/preemption_timer";
    if handed_over == Some(true) {
        let found = format!(
            "KVM leaves it to takt where a Linux's timers go; the one-shot timer of a kernel that means harm is left, and moves a release by one interrupt, {}",
            interrupt(host)
        );
        return Finding::good(CHECK, found);
    }
    let remedy = match host.text(TIMER).as_deref() {
        Some("Y" | "1") => checks::with_option("kvm_intel", "kvm_intel", "preemption_timer=0"),
        _ => "start a kernel before 6.18, or give the Linux a CPU without windows".into(),
    };
    Finding::warning(
        CHECK,
        match handed_over {
            Some(_) => "KVM sets a Linux's deadlines itself, past its filter for registers",
            None => "it could not be found out whether KVM hands a Linux's deadlines over",
        },
        interrupt_cost(host),
        remedy,
    )
}

/// Whether a guest that keeps the other processors from memory is noticed.
fn bus_locks(host: &Host, told: bool) -> Finding {
    const CHECK: &str = "bus-locks";
    if told {
        return Finding::good(CHECK, "KVM tells of each, and `bus_locks` limits them");
    }
    if host.online().len() == 1 {
        return Finding::good(
            CHECK,
            "KVM does not tell, and there is no other CPU to be kept waiting",
        );
    }
    Finding::warning(
        CHECK,
        "KVM does not tell of a guest's bus locks (KVM_CAP_X86_BUS_LOCK_EXIT)",
        "a program in a Linux on another CPU can keep a PLC from memory for about a microsecond, again and again, and nothing shows it",
        "a processor that tells, such as Intel's since Sapphire Rapids, and Linux 5.12 or newer; or partitions of one CPU",
    )
}

/// What a Linux's timers cost that go off in windows on its CPU.
fn interrupt_cost(host: &Host) -> String {
    format!(
        "each of a Linux's timers that goes off in a window of its CPU moves a release or lengthens a scan by one interrupt, {}",
        interrupt(host)
    )
}

/// How long an interrupt keeps a guest from going on.
fn interrupt(host: &Host) -> &'static str {
    let flushes = host.text("sys/devices/system/cpu/vulnerabilities/l1tf");
    let flushes = flushes.is_some_and(|text| text.contains("cache flushes"));
    // CPUID leaf 7, EDX bit 28: one instruction does it.
    match flushes && !host.has_feature("flush_l1d") {
        true => "6 us on this processor, where KVM flushes a cache in software after each (L1TF)",
        false => "2 us in the lab",
    }
}

fn speed(measured: &Speed) -> Finding {
    const CHECK: &str = "virtualisation";
    const REMEDY: &str = "run takt on a machine with VT-x or AMD-V; in a virtual machine, switch nesting on in its hypervisor; to try takt without it: scripts/lab";
    match measured {
        Speed::Hardware { text } => Finding::good(CHECK, text.clone()),
        Speed::Emulated { text } => Finding::cannot(
            CHECK,
            text.clone(),
            "a scan takes a multiple of its time, and no window is long enough",
            REMEDY,
        ),
        Speed::Failed { error } => {
            Finding::cannot(CHECK, format!("no guest could run: {error}"), "takt run fails", REMEDY)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Severity;
    use crate::recorded::Recorded;

    fn machines() -> Machines {
        Machines {
            plc_error: None,
            linux_error: None,
            speed: Speed::Hardware { text: "fast".into() },
            hands_deadlines_over: Some(true),
            tells_bus_locks: true,
            tsc_khz: Some(1_000_000),
        }
    }

    #[test]
    fn each_answer_of_takt_is_judged() {
        let host = Recorded::named("workstation").unpack();
        let demand = |linux| Demand { linux, ..Demand::usual(&host.host) };
        let worst = |linux, found: Found| {
            let findings = findings(&host.host, &demand(linux), &Ok(found));
            findings.into_iter().map(|finding| finding.severity).max().unwrap()
        };
        let of = |linux, machines| worst(linux, Found::Complete(machines));
        assert_eq!(of(true, machines()), Severity::Good);
        let no_linux = || Machines { linux_error: Some("no".into()), ..machines() };
        assert_eq!(of(true, no_linux()), Severity::Cannot);
        assert_eq!(of(false, no_linux()), Severity::Good);
        let no_plc = Machines { plc_error: Some("no".into()), ..machines() };
        assert_eq!(of(false, no_plc), Severity::Cannot);
        let slow = Machines { speed: Speed::Emulated { text: "slow".into() }, ..machines() };
        assert_eq!(of(false, slow), Severity::Cannot);
        let none = Machines { speed: Speed::Failed { error: "no".into() }, ..machines() };
        assert_eq!(of(false, none), Severity::Cannot);
        assert_eq!(worst(false, Found::Lacking { missing: vec!["x".into()] }), Severity::Cannot);
        assert_eq!(worst(false, Found::Closed { errno: libc::ENOENT }), Severity::Cannot);
        assert_eq!(worst(false, Found::Closed { errno: libc::EACCES }), Severity::Unseen);
        let path = std::path::PathBuf::from("/no/takt");
        let unknown = Err(ExaminationError::Answer { path });
        assert_eq!(findings(&host.host, &demand(false), &unknown)[0].severity, Severity::Unseen);
    }

    #[test]
    fn bus_locks_that_are_not_reported_are_told_where_there_is_another_cpu() {
        let of = |host: &str, told| bus_locks(&Recorded::named(host).unpack().host, told).severity;
        assert_eq!(of("workstation", true), Severity::Good);
        assert_eq!(of("workstation", false), Severity::Warning);
        assert_eq!(of("appliance-rt", false), Severity::Good);
    }

    #[test]
    fn timers_that_takt_cannot_place_are_told_with_cost_and_remedy() {
        let host = Recorded::named("workstation");
        let of = |host: &Recorded, it| deadlines(&host.unpack().host, it);
        let good = of(&host, Some(true));
        assert_eq!(good.severity, Severity::Good);
        assert!(
            good.found.contains("is left, and moves a release by one interrupt, 2 us in the lab")
        );
        let newer = of(&host, Some(false));
        assert_eq!(newer.severity, Severity::Warning);
        assert!(newer.remedy.unwrap().contains("before 6.18"));
        assert!(of(&host, None).found.contains("could not be found out"));
        let intel = host
            .with("sys/module/kvm_intel/parameters/preemption_timer", "Y")
            .with(
                "sys/devices/system/cpu/vulnerabilities/l1tf",
                "Mitigation: PTE Inversion; VMX: conditional cache flushes, SMT disabled",
            )
            .with("proc/cpuinfo", "flags : vmx");
        let intel = of(&intel, Some(false));
        let remedy = "echo options kvm_intel preemption_timer=0 >> /etc/modprobe.d/takt.conf && modprobe -r kvm_intel && modprobe kvm_intel";
        assert_eq!(intel.remedy.unwrap(), remedy);
        assert!(intel.cost.unwrap().contains("6 us on this processor"));
    }
}
