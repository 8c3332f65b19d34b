//! The time-stamp counter: the one clock of the host and of all guests.

use crate::finding::Finding;
use crate::host::Host;
use crate::steering::NTP_PPM;

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

/// Whether the kernel may give the counter up while Takt runs, because another clock seems to differ.
///
/// The clock source watchdog (`kernel/time/clocksource.c`) compares the counter with the HPET or the
/// power management timer twice a second. It is off for a counter that is declared reliable, by the
/// command line (`tsc=reliable`, `tsc=nowatchdog`) or by the hypervisor, and since 5.17 on processors
/// with IA32_TSC_ADJUST and few nodes (`check_system_tsc_reliable` in `arch/x86/kernel/tsc.c`).
pub fn watchdog(host: &Host) -> Finding {
    const CHECK: &str = "tsc-watchdog";
    // The kernel compares each whole value, and none takes another back (`tsc_setup`).
    let told = host.parameters("tsc");
    if let Some(told) = told.iter().find(|told| ["reliable", "nowatchdog"].contains(&told.as_str()))
    {
        return Finding::good(
            CHECK,
            format!("the kernel is told not to doubt the counter (tsc={told})"),
        );
    }
    if host.has_feature("tsc_reliable") {
        return Finding::good(CHECK, "the counter is reliable by the hypervisor's word");
    }
    let sure = ["constant_tsc", "nonstop_tsc", "tsc_adjust"].iter().all(|f| host.has_feature(f));
    let nodes = host.cpus("sys/devices/system/node/online").map_or(1, |nodes| nodes.len());
    if sure && nodes <= NODES && since(&host.kernel(), [5, 17]) {
        return Finding::good(CHECK, "the kernel does not doubt the counter of this processor");
    }
    Finding::warning(
        CHECK,
        "the kernel compares the counter with another clock, and drops it where they seem to differ",
        "a false alarm of a busy machine is enough: KVM then moves the guests' counters, and PLCs lose every release (clock-fault)",
        "if tsc-rate and tsc-equal are good: tsc=nowatchdog on the kernel's command line, or tsc=reliable",
    )
}

/// Nodes up to which the kernel trusts the counters to be one; later kernels trust twice as many.
const NODES: usize = 2;

/// Whether a kernel's release is at least this one.
pub fn since(release: &str, least: [u32; 2]) -> bool {
    let mut numbers = release.split(['.', '-']).map_while(|number| number.parse().ok());
    [numbers.next().unwrap_or(0), numbers.next().unwrap_or(0)] >= least
}

/// How far NTP has taken the kernel's clock from the counter's rate.
pub fn steering(host: &Host) -> Finding {
    const CHECK: &str = "clock-steering";
    let Some(steering) = host.steering() else {
        return Finding::unseen(
            CHECK,
            "the kernel does not tell how its clock is steered",
            "a clock that is steered by more than 500 ppm makes wake-ups costlier",
            "adjtimex",
        );
    };
    let kept =
        if steering.synchronised() { "kept by NTP" } else { "not kept by any daemon (STA_UNSYNC)" };
    // A millionth of a second is a microsecond.
    let creep = steering.ppm().abs();
    let tick = match creep >= 0.05 {
        true => format!(
            "; the host's tick creeps by {creep:.1} us in each second, and so comes into windows"
        ),
        false => String::new(),
    };
    let found = format!(
        "{:+.1} ppm, {:+.0} ppm of it by the length of a tick ({} us); {kept}{tick}",
        steering.ppm(),
        steering.tick_ppm(),
        steering.tick
    );
    if steering.ppm().abs() <= NTP_PPM {
        return Finding::good(CHECK, found);
    }
    Finding::warning(
        CHECK,
        found,
        "the kernel sleeps by this clock: takt divides each sleep, at the cost of some microseconds of Linux's time, and a step of the rate by a tenth can end one window late",
        "in the configuration of chrony: maxslewrate 500; then wait until it has corrected its error (chronyc tracking); without NTP: adjtimex --tick 10000 --frequency 0",
    )
}
