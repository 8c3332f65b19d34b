//! The trace: all windows of a run, for a viewer of time lines.
//!
//! `takt run --trace` writes all of a run, `takt ctl FILE trace` a part of it elsewhere.
//!
//! A run writes it through a queue that its own thread empties: a disk that does not keep up costs windows
//! in the picture, which are counted and marked, and no other harm.
//!
//! The file is in the Chrome trace-event format (JSON, the form that is one array), which
//! <https://ui.perfetto.dev> and `chrome://tracing` open. It is written while the run lasts, so
//! memory does not grow with it; a run that is cut off leaves a file without its last bracket,
//! which both viewers accept. A window takes about 800 bytes, and each detour about 250 more: at
//! 1000 windows a second, 50 MB a minute.
//!
//! Each CPU is a process and each partition has two threads in it:
//!
//! | thread | slice or mark | means |
//! | --- | --- | --- |
//! | `NAME` | `wake-up` | from when the thread was to wake up to when it did |
//! | | `entry` | from there to the entry into the guest |
//! | | `guest` | in the guest, waiting for the release included |
//! | | `port exit`, `memory exit`, `signal`, `other exit` | left and entered again |
//! | | *`release`* | the release; its `args` have the whole record |
//! | | *`late release`* | the guest was entered only here, after the release |
//! | | *`lost releases`* | so many before this one were skipped; those after the last window are only in the report |
//! | | *`done`*, *`end of the guest`* | left before the window's end, and not to return in it, or ever |
//! | | *`kick`*, *`overrun`* | the window's end enforced; its end, if the scan was not done |
//! | | *`unfinished`* | the window's end, if tasks go on in the next one |
//! | `NAME: claims` | `scan`, `unfinished scan` | what the guest says of its scan |
//!
//! A mark *`dropped`* of the schedule's process says how many events are missing before it.
//!
//! Marks (in italics) have no length. Claims have a thread of their own because they need not fit
//! the rest: a scan begins in one slice of the guest and ends in another. One that cannot be true
//! is not drawn; see [`WindowRecord::scan`]. The schedule that holds is a process of its own.
//!
//! `ts` and `dur` are microseconds with three decimals, so exact to a nanosecond. `ts` is
//! 1000 at the epoch, since what leads to the first release lies before it. What has `tsc` in its
//! name is a value of the time-stamp counter, as it was read.
//!
//! Slices of a thread must not overlap, which the viewers would draw wrongly without a word. So a
//! slice begins no earlier than the one before it ends, whatever the stamps say.

mod events;

use std::io::{self, Write};
use std::sync::Arc;

use serde::{Serialize, Serializer};
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::{Cpu, PartitionId};
use takt_scheduler::time::{Nanos, Timebase, Tsc};

use self::events::{Events, LATEST_NS, NOTHING, Name, Phase, Track};
use takt_record::{Detour, Exit, WindowRecord};

/// How far before the epoch the trace begins.
const LEAD: Nanos = Nanos::from_millis(1);

/// A trace that is being written.
///
/// Writing never fails where it would be in the way: the first error ends the trace, and
/// [`finish`](Trace::finish) tells it.
pub struct Trace<W: Write> {
    events: Events<W>,
    base: Timebase,
    partitions: Box<[Tracks]>,
    schedules: Box<[Arc<str>]>,
    schedule: Track,
}

/// The two threads of a partition.
#[derive(Clone, Copy)]
struct Tracks {
    host: Track,
    claims: Track,
}

#[derive(Serialize)]
struct Count {
    releases: u64,
}

#[derive(Serialize)]
struct Dropped {
    events: u64,
}

#[derive(Serialize)]
struct Late {
    late_ns: u64,
}

#[derive(Serialize)]
struct DetourArgs {
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<Hex>,
    left_tsc: u64,
    entered_tsc: u64,
}

#[derive(Serialize)]
struct ScanArgs {
    release: u64,
    start_tsc: u64,
    done_tsc: u64,
}

#[derive(Serialize)]
struct WindowArgs<'a> {
    release: u64,
    schedule: &'a str,
    release_tsc: u64,
    end_tsc: u64,
    due_tsc: u64,
    woken_tsc: u64,
    entered_tsc: u64,
    left_tsc: u64,
    kicked_tsc: Option<u64>,
    claimed_last_stamp_tsc: u64,
    exits: u32,
    /// `null` if KVM does not tell.
    kernel_exits: Option<u64>,
}

/// An address, as people read it; a viewer would show a number rounded.
struct Hex(u64);

impl Serialize for Hex {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{:#x}", self.0))
    }
}

impl<W: Write> Trace<W> {
    /// Begins a trace of a whole run. Partitions are given with the CPU of each, by [`PartitionId`];
    /// schedules by [`ScheduleId`].
    pub fn new(out: W, base: Timebase, partitions: &[(&str, Cpu)], schedules: &[&str]) -> Self {
        Self::since(out, base, partitions, schedules, Tsc(0), ScheduleId(0))
    }

    /// Begins a trace in the midst of a run, of whatever happens after `since`, when `schedule` holds.
    pub fn since(
        out: W,
        base: Timebase,
        partitions: &[(&str, Cpu)],
        schedules: &[&str],
        since: Tsc,
        schedule: ScheduleId,
    ) -> Self {
        // Viewers have an own idea of process 0 and of thread 0.
        let process = |cpu: Cpu| (cpu.0 as u64).saturating_add(1);
        let last = partitions.iter().map(|(_, cpu)| process(*cpu)).max().unwrap_or(0);
        let mut threads = 1..;
        let mut track = |process| {
            let thread = threads.next().unwrap_or(0);
            Track { process, thread, drawn_to: 0 }
        };
        let schedule_track = track(last.saturating_add(1));
        let tracks = partitions
            .iter()
            .map(|(_, cpu)| Tracks { host: track(process(*cpu)), claims: track(process(*cpu)) });
        let mut this = Self {
            events: Events::new(out),
            base,
            partitions: tracks.collect(),
            schedules: schedules.iter().map(|name| Arc::from(*name)).collect(),
            schedule: schedule_track,
        };
        this.name(schedule_track, "process_name", "schedule");
        this.name(schedule_track, "thread_name", "schedule");
        for (i, (name, cpu)) in partitions.iter().enumerate() {
            let Tracks { host, claims } = this.partitions[i];
            this.name(host, "process_name", &format!("CPU {}", cpu.0));
            this.name(host, "thread_name", name);
            this.name(claims, "thread_name", &format!("{name}: claims"));
        }
        let at = this.ns(since);
        this.begin_schedule(at, schedule);
        this.events.commit();
        this
    }

    /// Adds a window with its detours, which are in the order of time and lie in the window.
    pub fn add(&mut self, partition: PartitionId, w: &WindowRecord, detours: &[Detour]) {
        let Some(Tracks { mut host, mut claims }) = self.partitions.get(partition.0).copied()
        else {
            return;
        };
        self.tell_dropped(self.ns(w.release));
        self.slice(&mut host, "wake-up", w.due, w.woken, NOTHING);
        self.slice(&mut host, "entry", w.woken, w.entered, NOTHING);
        let mut entered = w.entered;
        for detour in detours {
            self.slice(&mut host, "guest", entered, detour.left, NOTHING);
            self.detour(&mut host, detour);
            entered = detour.entered;
        }
        self.slice(&mut host, "guest", entered, w.left, NOTHING);
        self.marks(host, w);
        self.scan(&mut claims, w);
        self.partitions[partition.0] = Tracks { host, claims };
        self.events.commit();
    }

    /// Events that were left out, because the file did not keep up.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.events.dropped()
    }

    /// From `at` on, another schedule holds. The first one holds from the start.
    pub fn switch(&mut self, at: Tsc, schedule: ScheduleId) {
        let ns = self.ns(at).max(self.schedule.drawn_to);
        self.end_schedule(ns);
        self.begin_schedule(ns, schedule);
        self.events.commit();
    }

    /// Ends the file.
    ///
    /// # Errors
    /// The first error since the trace was begun. What was written before it can be viewed.
    pub fn finish(mut self) -> io::Result<()> {
        let drawn = self.partitions.iter().map(|t| t.host.drawn_to).max().unwrap_or(0);
        self.tell_dropped(drawn);
        self.end_schedule(drawn.max(self.schedule.drawn_to));
        self.events.finish()
    }

    fn tell_dropped(&mut self, at: u64) {
        let events = self.events.take_untold();
        if events > 0 {
            let args = Some(Dropped { events });
            self.events.add(self.schedule, Phase::Mark, "dropped", at, None, args);
        }
    }

    fn marks(&mut self, track: Track, w: &WindowRecord) {
        let schedule = self.schedules.get(w.schedule.0).cloned().unwrap_or_default();
        let args = WindowArgs {
            release: w.sequence,
            schedule: &schedule,
            release_tsc: w.release.0,
            end_tsc: w.end.0,
            due_tsc: w.due.0,
            woken_tsc: w.woken.0,
            entered_tsc: w.entered.0,
            left_tsc: w.left.0,
            kicked_tsc: w.kicked.map(|kicked| kicked.0),
            claimed_last_stamp_tsc: w.last_stamp.0,
            exits: w.exits,
            kernel_exits: Some(w.kernel_exits).filter(|exits| *exits > 0),
        };
        self.mark(track, "release", w.release, Some(args));
        if w.skipped > 0 {
            let count = Count { releases: w.skipped };
            self.mark(track, "lost releases", w.release, Some(count));
        }
        if w.is_late() {
            let late_ns = self.base.frequency.nanos(w.entered.since(w.release)).0;
            self.mark(track, "late release", w.entered, Some(Late { late_ns }));
        }
        match w.kicked {
            Some(kicked) => self.mark(track, "kick", kicked, NOTHING),
            None if w.ended => self.mark(track, "end of the guest", w.left, NOTHING),
            None if w.left < w.end => self.mark(track, "done", w.left, NOTHING),
            None => {}
        }
        if w.overrun {
            self.mark(track, "overrun", w.end, NOTHING);
        }
        if w.unfinished {
            self.mark(track, "unfinished", w.end, NOTHING);
        }
    }

    fn scan(&mut self, track: &mut Track, w: &WindowRecord) {
        let Some(scan) = w.scan() else { return };
        let (name, end) = if w.finished_scan().is_some() {
            ("scan", scan.done)
        } else {
            ("unfinished scan", w.left)
        };
        let args = ScanArgs { release: w.sequence, start_tsc: scan.start.0, done_tsc: scan.done.0 };
        self.slice(track, name, scan.start, end, Some(args));
    }

    fn detour(&mut self, track: &mut Track, detour: &Detour) {
        let (name, at) = match detour.exit {
            Exit::Port(port) => ("port exit", Some(Hex(port.into()))),
            Exit::Memory(address) => ("memory exit", Some(Hex(address))),
            Exit::Signal => ("signal", None),
            Exit::Other => ("other exit", None),
        };
        let args = DetourArgs { at, left_tsc: detour.left.0, entered_tsc: detour.entered.0 };
        self.slice(track, name, detour.left, detour.entered, Some(args));
    }

    /// Draws a slice, or what of it lies behind the one before. One without length is left out.
    fn slice(
        &mut self,
        track: &mut Track,
        name: &str,
        from: Tsc,
        to: Tsc,
        args: Option<impl Serialize>,
    ) {
        let from = self.ns(from).max(track.drawn_to);
        let to = self.ns(to);
        if from < to {
            track.drawn_to = to;
            self.events.add(*track, Phase::Slice, name, from, Some(to - from), args);
        }
    }

    fn mark(&mut self, track: Track, name: &str, at: Tsc, args: Option<impl Serialize>) {
        self.events.add(track, Phase::Mark, name, self.ns(at), None, args);
    }

    fn begin_schedule(&mut self, at: u64, schedule: ScheduleId) {
        let name = self.schedules.get(schedule.0).cloned().unwrap_or_default();
        self.schedule.drawn_to = at;
        self.events.add(self.schedule, Phase::Begin, &name, at, None, NOTHING);
    }

    fn end_schedule(&mut self, at: u64) {
        self.events.add(self.schedule, Phase::End, "", at, None, NOTHING);
    }

    fn name(&mut self, track: Track, what: &str, name: &str) {
        self.events.add(track, Phase::Metadata, what, 0, None, Some(Name { name }));
    }

    /// The place of an instant in the trace, in nanoseconds; nothing is before its beginning.
    fn ns(&self, instant: Tsc) -> u64 {
        let lead = self.base.frequency.ticks(LEAD).0;
        let ticks = (u128::from(instant.0) + u128::from(lead))
            .saturating_sub(u128::from(self.base.epoch.0));
        let ns = ticks * 1_000_000 / u128::from(self.base.frequency.khz());
        u64::try_from(ns).unwrap_or(u64::MAX).min(LATEST_NS)
    }
}

#[cfg(test)]
mod tests;
