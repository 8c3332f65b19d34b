//! What a run tells at its end: a table for people and the same as JSON for programs.

mod wake_ups;

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use serde::{Deserialize, Serialize};
use takt_scheduler::quiet;

use crate::worst::{LateStart, LongScan};
pub use wake_ups::{WakeUps, WindowEnforcer};

/// Version of the JSON form: grows with every change that a reader could stumble over.
pub const SCHEMA_VERSION: u32 = 3;

/// A whole report. Field names are the JSON keys; times are nanoseconds.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// How Takt was run; see `scripts/run`. It says what the times mean.
    pub lane: String,
    /// What emulates this machine, and which of its known faults are left in it, as the script that
    /// started it says; `null` for a machine that is not emulated.
    pub emulator: Option<String>,
    /// Where.
    pub host: Host,
    /// `name` of the partition file's system.
    pub system: String,
    /// The time-stamp counter at the epoch, from which all times count: a stamp that somebody else on
    /// the host took, as when he started Takt, can be compared with it.
    pub epoch_tsc: u64,
    /// From the epoch to the end of the run.
    pub duration_ns: u64,
    /// False if a test has switched off the kick at a window's end.
    pub kick: bool,
    /// How the host's tick lay to the windows.
    pub tick: Tick,
    /// Which schedule held at the end.
    pub schedule: Schedule,
    /// In the order of the partition file.
    pub partitions: Vec<Partition>,
    /// What ends windows, by its CPU.
    pub window_enforcers: Vec<WindowEnforcer>,
    /// The ends of channels that are Takt's own, in the order of the partition file.
    pub host_ports: Vec<HostPort>,
    /// What Takt itself held.
    pub process: Process,
    /// What of Takt's own output has reached nobody.
    pub output: Output,
}

/// What of Takt's own output has reached nobody, because it was not read or its disk did not keep up. What
/// partitions lost is told of each of them.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Output {
    /// Bytes of Takt's own lines for which there was no room.
    pub takt_dropped_bytes: u64,
    /// Bytes, of whomever, that were still not read at the end of the run or could not be written.
    pub unread_bytes: u64,
    /// Events that the trace has not got.
    pub trace_dropped_events: u64,
}

/// How the host's tick lay to the windows.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Tick {
    /// From one to the next.
    pub period_ns: u64,
    /// What is clear of it, from the epoch on; `null` if it meets releases wherever it lies.
    pub clear: Option<Clear>,
    /// How far it may creep in either direction until that is clear no more.
    pub margin_ns: u64,
    /// How far it has crept: the host's clock against the TSC, from the start to the end.
    pub crept_ns: u64,
}

/// What is clear of the host's tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clear {
    /// All windows, from their guards to their ends.
    Windows,
    /// The releases, from their guards on.
    Releases,
}

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |ns: u64| ns as f64 / 1e3;
        write!(f, "host's tick: every {:.0} us, ", us(self.period_ns))?;
        match self.clear {
            None => f.write_str("wherever it lies it meets releases")?,
            Some(Clear::Windows) => write!(f, "{:.0} us off all windows", us(self.margin_ns))?,
            Some(Clear::Releases) => {
                write!(f, "in windows, {:.0} us off all releases", us(self.margin_ns))?;
            }
        }
        write!(f, " at the start, crept by {:.3} us", us(self.crept_ns))
    }
}

impl From<quiet::Clear> for Clear {
    fn from(clear: quiet::Clear) -> Self {
        match clear {
            quiet::Clear::Windows => Clear::Windows,
            quiet::Clear::Releases => Clear::Releases,
        }
    }
}

/// What became of the deadlines of a Linux's timer.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Deadlines {
    /// How often Linux has programmed its timer.
    pub programmed: u64,
    /// Deadlines that lay in a window or its guard, and were moved to its end.
    pub moved: u64,
    /// Of those: put back, since the PLC was done early or the schedule changed.
    pub put_back: u64,
}

/// What Takt's own process held when the guests started, and when the run was over.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Process {
    /// When the guests started; `null` if the host does not tell.
    pub start: Option<Footprint>,
    /// When the run was over.
    pub end: Option<Footprint>,
    /// How long it took to start them.
    pub starting: Starting,
}

/// What is held at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Footprint {
    /// Resident anonymous memory, which the guests' is not (`RssAnon`, proc_pid_status(5)).
    pub anonymous_bytes: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

/// How long a run took to start.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Starting {
    /// From the command to the epoch, the first release; `null` if nobody took the time. The kernel's
    /// part, which loads Takt itself, is not in it.
    pub first_release_ns: Option<u64>,
    /// Of that: what it took to clear the guests' memory.
    pub clearing_ns: u64,
}

impl fmt::Display for Starting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |ns: u64| ns as f64 / 1e6;
        write!(f, "guest memory cleared in {:.1} ms", ms(self.clearing_ns))?;
        match self.first_release_ns {
            Some(ns) => write!(f, ", first release {:.1} ms after the command", ms(ns)),
            None => Ok(()),
        }
    }
}

/// Where the schedule stood at the end.
#[derive(Clone, Debug, Serialize)]
pub struct Schedule {
    /// The schedule that held.
    pub current: String,
    /// The schedule that would have held next: another one while a switch was under way.
    pub next: String,
    /// When it began to hold, since the epoch; `null` if it always did.
    pub last_switch_ns: Option<u64>,
}

/// The machine below Takt.
#[derive(Clone, Debug, Serialize)]
pub struct Host {
    /// Kernel release.
    pub kernel: String,
    /// True for a PREEMPT_RT kernel.
    pub preempt_rt: bool,
    /// Processor, as its kernel names it.
    pub cpu: String,
    /// Frequency of the time-stamp counter.
    pub tsc_khz: u32,
}

/// One partition.
#[derive(Clone, Debug, Serialize)]
pub struct Partition {
    /// Its name.
    pub name: String,
    /// `plc` or `linux`.
    pub kind: &'static str,
    /// How it ended.
    pub end: String,
    /// True if it ended by a failure of its own.
    pub failed: bool,
    /// How often its guest was started anew.
    pub restarts: u64,
    /// CPU time of its thread, as a part of the run's duration.
    pub cpu_share: f64,
    /// Its errors.
    pub events: Events,
    /// Its illegal requests: mostly accesses to ports and memory that nothing answers.
    pub illegal_accesses: u64,
    /// Bytes of console output that were dropped.
    pub console_dropped: u64,
    /// Only for partitions with windows and a scan.
    #[serde(flatten)]
    pub releases: Option<Releases>,
    /// Only for partitions with windows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_ups: Option<WakeUps>,
    /// Only for a background partition.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub donation: Option<Donation>,
    /// Only for a Linux beside windows on its CPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadlines: Option<Deadlines>,
    /// Only for Linux: from the start of its vCPU to its first process; `null` if it did not get
    /// there, or if its console does not show the kernel's messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boot_to_init_ns: Option<Option<u64>>,
    /// Only for Linux: that its kernel did nothing any more when the run ended; `null` if nothing
    /// is known that speaks for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stuck: Option<Option<Stuck>>,
}

/// A kernel that does nothing any more; see `docs/health.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stuck {
    /// In which way.
    pub how: How,
    /// Since when it is known, from the epoch on.
    pub since_ns: u64,
}

/// In which way a kernel does nothing any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum How {
    /// It uses the processor, and takes no interrupt since it has switched them off.
    Spinning,
    /// It uses the processor, and takes no interrupt though it has not switched them off.
    Deaf,
    /// It has halted with interrupts off: nothing wakes it.
    Halted,
    /// Its console says that it has panicked.
    Panicked,
}

impl fmt::Display for Stuck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self.how {
            How::Spinning => "spins with interrupts off",
            How::Deaf => "spins and gets no interrupt",
            How::Halted => "has halted with interrupts off",
            How::Panicked => "has panicked, as its console says,",
        };
        write!(f, "{what} since {:.3} s", self.since_ns as f64 / 1e9)
    }
}

/// The errors of a partition; see `docs/health.md`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Events {
    /// How often each error happened, those that are ignored included. What never did is left out.
    pub totals: BTreeMap<&'static str, u64>,
    /// The first events.
    pub list: Vec<Event>,
    /// Events that are not in the list.
    pub unlisted: u64,
}

/// An error that was not ignored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// Place among the events of the partition, from 1.
    pub sequence: u64,
    /// When it was seen, since the epoch.
    pub at_ns: u64,
    /// Which error.
    pub error: &'static str,
    /// What is known of it.
    pub detail: String,
    /// What followed.
    pub action: &'static str,
}

/// How a partition kept its time.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Releases {
    /// Releases that happened.
    pub releases: u64,
    /// Windows that the guest needed to start up, before its first scan.
    pub start_up_windows: u64,
    /// Releases that never happened.
    pub lost: u64,
    /// Releases that came later than the guard can absorb.
    pub late_releases: u64,
    /// Windows that ended by a kick before the guest's scan was complete.
    pub overruns: u64,
    /// Windows that ended by a kick after the scan, while lesser tasks of the guest went on.
    pub unfinished_windows: u64,
    /// Windows that are in none of these figures because the event thread could not keep up.
    pub unrecorded: u64,
    /// From the release to the guest's start.
    pub release_latency_ns: Option<Summary>,
    /// From the guest's start to its end.
    pub execution_ns: Option<Summary>,
    /// From when the thread was to wake up to when it did.
    pub wake_up_latency_ns: Option<Summary>,
    /// From the wake-up to the last look at the clock before the guest.
    pub entry_ns: Option<Summary>,
    /// From the end of the scan to the thread's being out of the guest; not for a guest with tasks that
    /// may run in between.
    pub exit_ns: Option<Summary>,
    /// In overruns, from the window's end to the guest's last time stamp: its own claim of when
    /// it last ran.
    pub overrun_ns: Option<Summary>,
    /// Where a kick ended a window, from that end to the thread's being out of the guest.
    pub kick_ns: Option<Summary>,
    /// Exits from the guest in a window, as KVM counts them: those of the guest's own doing, and
    /// those of the host's interrupts. Not a time. `None` if KVM does not tell.
    pub vm_exits: Option<Summary>,
    /// The releases that started latest, and why; those that were on time are left out.
    pub late_starts: Vec<LateStart>,
    /// The scans that took longest, and why.
    pub longest_scans: Vec<LongScan>,
}

/// What became of the messages of an end on the host.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct HostPort {
    /// Name of the channel.
    pub channel: String,
    /// Name of the port.
    pub port: String,
    /// Messages that went through: packets to and from clients, or records.
    pub messages: u64,
    /// Messages that were overwritten before Takt took them.
    pub lost: u64,
    /// Claims of the channel's other end that cannot be true.
    pub hostile: u64,
    /// Connections that were closed at once, because there were too many.
    pub refused: u64,
    /// Clients that were let go of, because of what they sent.
    pub dropped: u64,
}

/// A distribution, in nanoseconds if it is one of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Summary {
    /// Smallest value, exact.
    pub min: u64,
    /// Median.
    pub p50: u64,
    /// 99 % of the values are at most this.
    pub p99: u64,
    /// 99.9 % of the values are at most this.
    pub p999: u64,
    /// Largest value, exact.
    pub max: u64,
}

/// What a background partition was left, and what it got of that.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Donation {
    /// Time that no windowed partition of the CPU used, from its wake-up (the guard included) to
    /// its leaving the guest.
    pub offered_ns: u64,
    /// CPU time that the partition used. A guest that halts uses less than it is offered.
    pub received_ns: u64,
    /// The share of the CPU that is its own whatever the others do, by analysis.
    pub minimum_share: f64,
}

impl Report {
    /// The report as text, one line per figure and partition.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::new();
        let seconds = self.duration_ns as f64 / 1e9;
        let rt = if self.host.preempt_rt { ", PREEMPT_RT" } else { "" };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{}: {seconds:.3} s, lane {}, kernel {}{rt}, TSC {:.3} MHz",
            self.system,
            self.lane,
            self.host.kernel,
            f64::from(self.host.tsc_khz) / 1e3,
        );
        if let Some(emulator) = &self.emulator {
            let _ = writeln!(text, "emulated by {emulator}");
        }
        for partition in &self.partitions {
            partition.describe(&mut text);
        }
        for enforcer in &self.window_enforcers {
            enforcer.describe(&mut text);
        }
        self.output.describe(&mut text);
        let _ = writeln!(text, "\n{}", self.tick);
        for port in &self.host_ports {
            describe_host_port(&mut text, port);
        }
        text
    }
}

impl Partition {
    fn describe(&self, text: &mut String) {
        let share = self.cpu_share * 100.0;
        let _ =
            writeln!(text, "\n{} ({}): {}, CPU share {share:.1} %", self.name, self.kind, self.end);
        if self.restarts > 0 {
            let _ = writeln!(text, "  restarts       {}", self.restarts);
        }
        if let Some(boot) = self.boot_to_init_ns {
            let _ = match boot {
                Some(ns) => writeln!(text, "  boot to init   {:.3} s", ns as f64 / 1e9),
                None => writeln!(text, "  boot to init   not seen"),
            };
        }
        if let Some(Some(stuck)) = self.stuck {
            let _ = writeln!(text, "  kernel         {stuck}");
        }
        if let Some(r) = &self.releases {
            let _ = writeln!(
                text,
                "  releases       {}   lost {}   late {}   overruns {}   (start-up: {} windows)",
                r.releases, r.lost, r.late_releases, r.overruns, r.start_up_windows
            );
            if r.unfinished_windows > 0 {
                let _ = writeln!(
                    text,
                    "  unfinished     {} windows, whose tasks went on in the next",
                    r.unfinished_windows
                );
            }
            if r.unrecorded > 0 {
                let _ = writeln!(text, "  unrecorded     {} (not in these figures)", r.unrecorded);
            }
            let _ = writeln!(
                text,
                "  {:<18}{:>11}{:>11}{:>11}{:>11}{:>11}",
                "in us", "min", "p50", "p99", "p99.9", "max"
            );
            describe_summary(text, "release latency", r.release_latency_ns);
            describe_summary(text, "execution", r.execution_ns);
            describe_summary(text, "wake-up latency", r.wake_up_latency_ns);
            describe_summary(text, "entry", r.entry_ns);
            describe_summary(text, "exit", r.exit_ns);
            if r.overruns + r.unfinished_windows > 0 {
                describe_summary(text, "kick", r.kick_ns);
            }
            if r.overruns > 0 {
                describe_summary(text, "ran past its end", r.overrun_ns);
            }
            // What would read "0.0 us" is for those who read the JSON.
            for start in r.late_starts.iter().filter(|start| start.latency_ns >= 100) {
                let us = start.latency_ns as f64 / 1e3;
                let _ = writeln!(
                    text,
                    "  release {} was {us:.1} us late: {}",
                    start.release, start.parts
                );
            }
        }
        if let Some(w) = self.wake_ups {
            w.describe(text);
        }
        if let Some(d) = self.donation {
            let received = d.received_ns as f64 / d.offered_ns.max(1) as f64 * 100.0;
            let _ = writeln!(
                text,
                "  donation       {:.3} s left by windows, {received:.1} % of it used; minimum share {:.1} %",
                d.offered_ns as f64 / 1e9,
                d.minimum_share * 100.0
            );
        }
        if let Some(d) = self.deadlines {
            let _ = writeln!(
                text,
                "  deadlines      {} programmed, {} moved out of windows, {} of those put back",
                d.programmed, d.moved, d.put_back
            );
        }
        if !self.events.totals.is_empty() {
            let totals = self.events.totals.iter();
            let totals: Vec<String> = totals.map(|(error, n)| format!("{error} {n}")).collect();
            let _ = writeln!(text, "  errors         {}", totals.join(", "));
        }
        if self.console_dropped > 0 {
            let _ = writeln!(text, "  {} bytes of console output dropped", self.console_dropped);
        }
    }
}

impl Output {
    fn describe(&self, text: &mut String) {
        for (count, what) in [
            (self.takt_dropped_bytes, "bytes of Takt's own lines dropped"),
            (self.unread_bytes, "bytes of the console were not read"),
            (self.trace_dropped_events, "events are missing in the trace"),
        ] {
            if count > 0 {
                let _ = writeln!(text, "\n{count} {what}");
            }
        }
    }
}

fn describe_host_port(text: &mut String, port: &HostPort) {
    let _ = write!(text, "\nhost:{} ({}): {} messages", port.port, port.channel, port.messages);
    for (count, what) in [
        (port.lost, "lost"),
        (port.hostile, "impossible claims"),
        (port.refused, "connections refused"),
        (port.dropped, "clients dropped"),
    ] {
        if count > 0 {
            let _ = write!(text, ", {count} {what}");
        }
    }
    text.push('\n');
}

fn describe_summary(text: &mut String, name: &str, summary: Option<Summary>) {
    let _ = write!(text, "  {name:<18}");
    match summary {
        None => text.push_str("          -"),
        Some(s) => {
            for ns in [s.min, s.p50, s.p99, s.p999, s.max] {
                let _ = write!(text, "{:>11.3}", ns as f64 / 1e3);
            }
        }
    }
    text.push('\n');
}

#[cfg(test)]
mod tests;
