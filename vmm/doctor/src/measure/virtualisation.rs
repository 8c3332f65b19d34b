//! Does KVM have what Takt needs, and does it run guests on the processor itself?

use std::io;

use kvm_ioctls::Kvm;
use takt::machine::{self, MachineError, TimerOwner};
use takt::memory::GuestMemory;
use takt::probe;

use crate::finding::Finding;
use crate::host::Host;

/// Memory of the machines that are only made and dropped again, in bytes.
const MEMORY: u64 = 2 << 20;

/// Of KVM: what it offers, whether the machines of a PLC and of a Linux can be made, how fast their
/// kernel-mode code runs.
pub fn findings(host: &Host, linux: bool) -> Vec<Finding> {
    const CHECK: &str = "kvm";
    let kvm = match Kvm::new() {
        Ok(kvm) => kvm,
        Err(error) => return vec![closed(host, error.errno())],
    };
    let missing = machine::missing(&kvm);
    if !missing.is_empty() {
        return vec![Finding::cannot(
            CHECK,
            format!("KVM lacks {}", missing.join(", ")),
            "takt run does not start",
            "start a newer kernel on the host",
        )];
    }
    match made(&kvm, linux) {
        Err(error) => vec![Finding::cannot(
            CHECK,
            error.to_string(),
            "takt run does not start",
            "start a newer kernel on the host; under a hypervisor, look for its KVM",
        )],
        Ok(()) => {
            let mut findings = vec![Finding::good(CHECK, "has what takt needs"), speed()];
            if linux {
                findings.push(deadlines(host, probe::hands_deadlines_over(&kvm).ok()));
            }
            findings
        }
    }
}

/// Why `/dev/kvm` cannot be opened.
fn closed(host: &Host, errno: i32) -> Finding {
    const CHECK: &str = "kvm";
    const COST: &str = "takt run does not start";
    let error = io::Error::from_raw_os_error(errno);
    let found = format!("/dev/kvm: {error}");
    if error.kind() == io::ErrorKind::PermissionDenied {
        return Finding::unseen(CHECK, found, COST, "sudo takt doctor");
    }
    let module = [("vmx", "kvm-intel"), ("svm", "kvm-amd")];
    let remedy = match module.iter().find(|(feature, _)| host.has_feature(feature)) {
        Some((_, name)) => format!("modprobe {name}"),
        None => "switch hardware virtualisation (VT-x, AMD-V) on in the firmware; in a virtual machine, nesting in its hypervisor".into(),
    };
    Finding::cannot(CHECK, found, COST, remedy)
}

fn made(kvm: &Kvm, linux: bool) -> Result<(), MachineError> {
    machine::for_plc(kvm, &GuestMemory::for_plc(MEMORY, &[])?, false)?;
    if linux {
        machine::for_linux(kvm, &GuestMemory::for_linux(MEMORY, &[])?, TimerOwner::Takt)?;
    }
    Ok(())
}

/// Whether a Linux's timers can be kept out of windows. `None`: it could not be found out.
fn deadlines(host: &Host, handed_over: Option<bool>) -> Finding {
    const CHECK: &str = "deadlines";
    const TIMER: &str = "sys/module/kvm_intel/parameters/preemption_timer";
    if handed_over == Some(true) {
        return Finding::good(CHECK, "KVM leaves it to takt where a Linux's timers go");
    }
    let remedy = match host.text(TIMER).as_deref() {
        Some("Y" | "1") => {
            "options kvm_intel preemption_timer=0, in a file in /etc/modprobe.d, and load the module anew"
        }
        _ => "start a kernel before 6.18, or give the Linux a CPU without windows",
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

/// What a Linux's timers cost that go off in windows on its CPU.
fn interrupt_cost(host: &Host) -> String {
    let flushes = host.text("sys/devices/system/cpu/vulnerabilities/l1tf");
    let flushes = flushes.is_some_and(|text| text.contains("cache flushes"));
    // CPUID leaf 7, EDX bit 28: one instruction does it.
    let longer = match flushes && !host.has_feature("flush_l1d") {
        true => "6 us on this processor, where KVM flushes a cache in software after each (L1TF)",
        false => "2 us in the lab",
    };
    format!(
        "each of a Linux's timers that goes off in a window of its CPU moves a release or lengthens a scan by one interrupt, {longer}"
    )
}

fn speed() -> Finding {
    const CHECK: &str = "virtualisation";
    const REMEDY: &str = "run takt on a machine with VT-x or AMD-V; in a virtual machine, switch nesting on in its hypervisor; to try takt without it: scripts/lab";
    match probe::probe() {
        Ok(speed) if speed.is_hardware() => Finding::good(CHECK, speed.to_string()),
        Ok(speed) => Finding::cannot(
            CHECK,
            speed.to_string(),
            "a scan takes a multiple of its time, and no window is long enough",
            REMEDY,
        ),
        Err(error) => {
            Finding::cannot(CHECK, format!("no guest could run: {error}"), "takt run fails", REMEDY)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Severity;
    use crate::recorded::Recorded;

    #[test]
    fn timers_that_takt_cannot_place_are_told_with_cost_and_remedy() {
        let host = Recorded::named("workstation");
        let of = |host: &Recorded, it| deadlines(&host.unpack().host, it);
        assert_eq!(of(&host, Some(true)).severity, Severity::Good);
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
        assert!(intel.remedy.unwrap().contains("preemption_timer=0"));
        assert!(intel.cost.unwrap().contains("6 us on this processor"));
    }
}
