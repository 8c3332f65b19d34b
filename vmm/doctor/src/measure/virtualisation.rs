//! Does KVM have what Takt needs, and does it run guests on the processor itself?

use std::io;

use kvm_ioctls::Kvm;
use takt::machine::{self, TimerOwner, MachineError};
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
        Ok(()) => vec![Finding::good(CHECK, "has what takt needs"), speed()],
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
