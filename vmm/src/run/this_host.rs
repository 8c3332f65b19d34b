//! The machine that this process runs on, for the report.

use std::fs;

use crate::report::Host;

/// Looks at the machine; the frequency of its time-stamp counter is what KVM says.
pub fn look(tsc_khz: u32) -> Host {
    let read = |path| fs::read_to_string(path).unwrap_or_default();
    let cpuinfo = read("/proc/cpuinfo");
    let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    Host {
        kernel: read("/proc/sys/kernel/osrelease").trim().to_owned(),
        preempt_rt: read("/proc/sys/kernel/version").contains("PREEMPT_RT"),
        cpu: model.map_or("unknown", |(_, name)| name.trim()).to_owned(),
        tsc_khz,
    }
}
