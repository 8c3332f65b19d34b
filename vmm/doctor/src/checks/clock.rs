//! The time-stamp counter: the one clock of the host and of all guests.

use crate::finding::Finding;
use crate::host::Host;

/// Whether the counter keeps its rate, by the word of the processor and by that of the kernel.
///
/// The processor's word is CPUID leaf 0x8000_0007, EDX bit 8 (`nonstop_tsc` in Linux). The kernel
/// watches the counter against another clock and drops it as clock source where it fails
/// (`kernel/time/clocksource.c`); until it has calibrated it, the name is `tsc-early`.
pub fn tsc(host: &Host) -> Finding {
    const CHECK: &str = "tsc";
    let source = host.text("sys/devices/system/clocksource/clocksource0/current_clocksource");
    let source = source.unwrap_or_else(|| "unknown".into());
    let invariant = host.has_feature("constant_tsc") && host.has_feature("nonstop_tsc");
    let word = if invariant { "invariant" } else { "not invariant by the processor's word" };
    let found = format!("{word}, clock source {source}");
    match (source.as_str(), invariant) {
        ("tsc" | "tsc-early", true) => Finding::good(CHECK, found),
        ("tsc" | "tsc-early", false) => Finding::warning(
            CHECK,
            found,
            "in some idle state or at some frequency the counter may stop or change its rate, and releases with it",
            "none for this processor but what is measured below (tsc-rate)",
        ),
        // Under a hypervisor these are the counter with a scale.
        ("kvm-clock" | "hyperv_clocksource_tsc_page", true) => Finding::warning(
            CHECK,
            found,
            "the kernel's clock and the counter can differ in rate",
            "echo tsc > /sys/devices/system/clocksource/clocksource0/current_clocksource",
        ),
        _ => {
            let why = match host.logged("Marking TSC unstable due to ") {
                Some(why) => format!(", since the kernel found it unstable: {why}"),
                None => String::new(),
            };
            Finding::cannot(
                CHECK,
                format!("{found}{why}"),
                "releases lie on the counter, and the kernel does not trust it",
                "look for the reason: dmesg | grep -i -e tsc -e clocksource; then the firmware's update",
            )
        }
    }
}
