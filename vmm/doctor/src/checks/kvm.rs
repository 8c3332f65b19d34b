//! How the host's KVM is set up, as far as it does something by itself.

use crate::finding::Finding;
use crate::host::Host;

const PARAMETERS: &str = "sys/module/kvm/parameters";

/// Whether KVM interrupts every guest each five minutes (`KVMCLOCK_SYNC_PERIOD` in
/// `arch/x86/kvm/x86.c`).
pub fn clock_updates(host: &Host) -> Finding {
    const CHECK: &str = "kvmclock";
    if !is_on(host, &format!("{PARAMETERS}/kvmclock_periodic_sync")) {
        return Finding::good(CHECK, "KVM leaves guests alone");
    }
    Finding::warning(
        CHECK,
        "KVM takes every guest off its processor each 300 s, to update a clock that no PLC has",
        "one exit of some microseconds, in a window where it happens to be in one",
        with_option(
            if host.has_feature("svm") { "kvm_amd" } else { "kvm_intel" },
            "kvm",
            "kvmclock_periodic_sync=0",
        ),
    )
}

/// Whether KVM splits large pages of guests and joins them again.
///
/// It splits executable ones on processors with the erratum "iTLB multihit", and a thread of its own
/// takes some of the pieces away again each hour or so, from under a guest that runs
/// (`kvm_recover_nx_huge_pages` in `arch/x86/kvm/mmu/mmu.c`).
pub fn recovery(host: &Host) -> Finding {
    const CHECK: &str = "nx-huge-pages";
    const RATIO: &str = "nx_huge_pages_recovery_ratio";
    let ratio = host.number(&format!("{PARAMETERS}/{RATIO}")).unwrap_or(0);
    if !is_on(host, &format!("{PARAMETERS}/nx_huge_pages")) || ratio == 0 {
        return Finding::good(CHECK, "KVM takes no page away from guests");
    }
    Finding::warning(
        CHECK,
        format!(
            "KVM takes one in {ratio} of the pages that it has split away from guests, in turns"
        ),
        "an access in a scan is an exit of some microseconds, once for each such page",
        format!("echo 0 > /{PARAMETERS}/{RATIO}"),
    )
}

/// Whether guests of this host can be hypervisors. Takt's cannot, whatever is set here.
pub fn nested(host: &Host) -> Finding {
    const CHECK: &str = "nested";
    let on = |module: &&str| is_on(host, &format!("sys/module/{module}/parameters/nested"));
    let Some(module) = ["kvm_intel", "kvm_amd"].into_iter().find(on) else {
        return Finding::good(CHECK, "guests cannot be hypervisors");
    };
    Finding::warning(
        CHECK,
        format!("{module} lets guests be hypervisors; those of takt it does not tell so"),
        "guests of other programs reach a large part of KVM that no PLC needs, and with a fault of it the PLC",
        with_option(module, module, "nested=0"),
    )
}

/// Whether a guest's locked access across two cache lines ends takt, or holds its thread up (`handle_guest_split_lock`
/// in `arch/x86/kernel/cpu/bus_lock.c`).
///
/// In the mode `fatal` the thread gets SIGBUS. In the mode `warn` it sleeps 10 ms in the kernel first, unless
/// `kernel.split_lock_mitigate` is 0 (Linux 6.2; those since 5.19 have the sleep and no switch). In `off` and
/// `ratelimit` the processor raises nothing.
pub fn split_locks(host: &Host) -> Finding {
    const CHECK: &str = "split-locks";
    const PARAMETER: &str = "split_lock_detect";
    if !host.has_feature(PARAMETER) {
        return Finding::good(CHECK, "the processor lets them pass");
    }
    let mode = host.parameter(PARAMETER).unwrap_or_default();
    let off = format!("start the host with the kernel parameter {PARAMETER}=off");
    if mode == "fatal" {
        return Finding::cannot(
            CHECK,
            format!("the kernel ends a program whose guest makes one ({PARAMETER}=fatal)"),
            "one instruction of any guest ends takt with all partitions",
            format!("{off}, or with warn and kernel.split_lock_mitigate = 0"),
        );
    }
    let switch = host.number("proc/sys/kernel/split_lock_mitigate");
    if mode == "off" || mode.starts_with("ratelimit") || switch == Some(0) {
        return Finding::good(CHECK, "the kernel holds no guest up for them");
    }
    Finding::warning(
        CHECK,
        "the kernel lets a thread sleep 10 ms whose guest makes one",
        "a guest with shorter windows does not get past such an instruction",
        if switch.is_some() { "sysctl kernel.split_lock_mitigate=0".to_owned() } else { off },
    )
}

/// The commands that load the processor's module of KVM anew, with an option for it or for `kvm`, which goes and
/// comes with it. The file may be there already, with what else its owner has set.
pub fn with_option(processors: &str, module: &str, option: &str) -> String {
    format!(
        "echo options {module} {option} >> /etc/modprobe.d/takt.conf && modprobe -r {processors} && modprobe {processors}"
    )
}

/// Whether a switch of a module is on; both forms are in use.
fn is_on(host: &Host, path: &str) -> bool {
    matches!(host.text(path).as_deref(), Some("Y" | "1"))
}
