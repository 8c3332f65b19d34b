//! The report as text for people.

use std::fmt::Write;

use super::{HostPort, Output, Partition, Report, Summary};

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
            let changed = r.release_guard_ns.filter(|guard| guard.min < guard.max);
            if changed.is_some() {
                describe_summary(text, "release guard", changed);
            }
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
        if let Some(operator) = &self.operator {
            let _ = writeln!(text, "  operators      {operator}");
        }
        if let Some(off) = &self.power_off {
            let _ = writeln!(text, "  power off      {off}");
        }
        for net in &self.nets {
            let _ = writeln!(text, "  network        {net}");
        }
        if let Some(vsock) = &self.vsock {
            let _ = writeln!(text, "  vsock          {vsock}");
        }
        if self.held_up {
            text.push_str("  devices        held up by a program of the host, and still open\n");
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
