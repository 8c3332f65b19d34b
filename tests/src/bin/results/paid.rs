//! What Linux pays.

use crate::{Measured, partition};

/// The paper's factors; the microkernel's processor was a 600 MHz Celeron.
const CALLS: [(&str, &str, &str); 5] = [
    ("getpid", "getpid()", "20.4"),
    ("fork+exit", "fork() + _exit()", "5.9"),
    ("vfork+exit", "vfork() + _exit()", "2.8"),
    ("fork+execve", "fork() + execve()", "7.12"),
    ("vfork+execve", "vfork() + execve()", "7.16"),
];

const GUEST: &str = "pay-0.log";
const NATIVE: &str = "native.log";

/// The calls of the paper's first table.
pub fn calls(measured: &Measured) -> Option<String> {
    let mut text = "| | on the bare host | in the guest | factor | the paper's |\n\
                    | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for (key, name, paper) in CALLS {
        let (native, guest) = (measured.paid(NATIVE, key)?, measured.paid(GUEST, key)?);
        text += &format!("| {name} | {native} | {guest} | {} | {paper} |\n", factor(guest, native));
    }
    let key = "vfork+execve-bare";
    let (native, guest) = (measured.paid(NATIVE, key)?, measured.paid(GUEST, key)?);
    text += &format!(
        "| the last, of a program without a C library | {native} | {guest} | {} | |\n",
        factor(guest, native)
    );
    Some(text)
}

/// Where the time of a start goes.
pub fn start(measured: &Measured) -> Option<String> {
    let of = |key| Some((measured.paid(NATIVE, key)?, measured.paid(GUEST, key)?));
    let (native, guest) = of("vfork+execve")?;
    let (cpuid_native, cpuid_guest) = of("cpuid")?;
    let (_, count) = of("cpuids-of-a-start")?;
    let extra = guest.saturating_sub(native);
    let explained = count * cpuid_guest.saturating_sub(cpuid_native);
    Some(format!(
        "| | |\n| --- | --- |\n\
         | a start in the guest takes longer than on the host, by | {extra} |\n\
         | CPUIDs in a start, counted by single steps | {count} |\n\
         | one CPUID on the bare host | {cpuid_native} |\n\
         | one CPUID in the guest | {cpuid_guest} |\n\
         | they make together, of the difference | {explained}, {:.0} % |\n\
         | factor without them | {} |\n",
        explained as f64 / extra.max(1) as f64 * 100.0,
        factor(guest.saturating_sub(explained), native),
    ))
}

/// The paper's second table.
pub fn compile(measured: &Measured) -> Option<String> {
    let key = "time-2";
    let native = measured.paid(NATIVE, key)?;
    let mut text = format!(
        "| | time | factor | beyond the share |\n| --- | --- | --- | --- |\n\
         | on the bare host | {} | | |\n",
        seconds(native)
    );
    for (run, share, frame) in [
        ("0", 0, "1 s"),
        ("10-10", 10, "10 ms"),
        ("30-10", 30, "10 ms"),
        ("10-1", 10, "1 ms"),
        ("30-1", 30, "1 ms"),
        ("10-1-auto", 10, "1 ms, with the guard \"auto\""),
        ("30-1-auto", 30, "1 ms, with the guard \"auto\""),
    ] {
        let guest = measured.paid(&format!("pay-{run}.log"), key)?;
        let left = guest * (100 - share) / 100;
        text += &format!(
            "| in the guest, the PLC has {share} % of each {frame} | {} | {} | {} |\n",
            seconds(guest),
            factor(guest, native),
            factor(left, native)
        );
    }
    text += "| the paper's, without a PLC | 441 s after 361 s | 1.22 | |\n";
    Some(text)
}

/// Where the time beyond the share goes in each frame of 1 ms, in ns.
pub struct Beyond {
    /// All of it.
    pub whole: u64,
    /// The PLC's thread is awake and waits for its release.
    pub guard: u64,
    /// From the window's end until that thread is out of the guest.
    pub kick: u64,
    /// What compiling in a guest takes more than on the host.
    pub guest: u64,
    /// To the PLC and back, and the window enforcer.
    pub rest: u64,
}

/// The same for a run in which compiling took `time` beside a PLC with a share of this many percent.
pub fn beyond_of(
    measured: &Measured,
    share: u64,
    time: u64,
    guard: u64,
    kick: u64,
) -> Option<Beyond> {
    const FRAME_NS: u64 = 1_000_000;
    let native = measured.paid(NATIVE, "time-2")?;
    let alone = measured.paid(GUEST, "time-2")?;
    let frames = (time / FRAME_NS).max(1);
    let whole = (time * (100 - share) / 100).saturating_sub(native) / frames;
    let guest = alone.saturating_sub(native) / frames;
    Some(Beyond { whole, guard, kick, guest, rest: whole.saturating_sub(guard + kick + guest) })
}

/// The same for the runs of all shares and guards: from the records of their windows.
pub fn beyond(measured: &Measured) -> Option<String> {
    let mut text = "| of each frame of 1 ms, in us | PLC with 10 % | with 30 % | 10 %, guard \"auto\" | 30 %, guard \"auto\" |\n\
                    | --- | --- | --- | --- | --- |\n"
        .to_owned();
    let mut columns = Vec::new();
    for (share, suffix) in [(10, ""), (30, ""), (10, "-auto"), (30, "-auto")] {
        let run = format!("pay-{share}-1{suffix}");
        let time = measured.paid(&format!("{run}.log"), "time-2")?;
        let report = measured.json(&format!("{run}.json"))?;
        let of = |key: &str| partition(&report, "plc")?[key]["p50"].as_u64();
        let Beyond { whole, guard, kick, guest, rest } =
            beyond_of(measured, share, time, of("release_guard_ns")?, of("kick_ns")?)?;
        columns.push([whole, guard, kick, guest, rest]);
    }
    let rows = [
        "**beyond the share**",
        "guard: the PLC's thread is awake and waits for its release, median",
        "from the window's end until that thread is out of the guest, median",
        "what compiling in a guest takes more than on the host, without a share",
        "the rest: to the PLC and back, the window enforcer",
    ];
    for (row, label) in rows.iter().enumerate() {
        let us = columns.iter().map(|column| format!(" {:.1} |", column[row] as f64 / 1e3));
        text += &format!("| {label} |{}\n", us.collect::<String>());
    }
    Some(text)
}

fn factor(guest: u64, native: u64) -> String {
    format!("{:.2}", guest as f64 / native.max(1) as f64)
}

/// Of ticks in the lab, where one is a nanosecond.
fn seconds(ticks: u64) -> String {
    format!("{:.3} s", ticks as f64 / 1e9)
}
