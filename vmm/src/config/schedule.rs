//! The schedule: windows with names become windows with numbers, and the scheduler's own rules
//! are applied and explained.
//!
//! The rules of time live in `takt_scheduler::table`, where they are tested exhaustively. They
//! speak of window 3 and partition 0; this file knows the lines those came from.

use takt_scheduler::reservation::{CEILING_PERMILLE, CpuReservations, KICK_MARGIN};
use takt_scheduler::table::{
    Cpu, FRAME_MAX, FRAME_MIN, PartitionId, Placement, Table, TableError, WINDOW_MIN, Window,
};
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::partition::{Checked, check_name};
use super::raw::{self, Keys};
use super::units::Duration;

/// The frame, where it is given, and the windows: raw, and as the scheduler takes them.
struct Draft<'a> {
    frame: &'a Spanned<Duration>,
    partitions: &'a [Checked],
    raw: Vec<&'a raw::Window>,
    windows: Vec<Window>,
}

/// Length of the major frame.
pub fn check_frame(frame: &Spanned<Duration>) -> Result<Nanos, Diagnostic> {
    let length = frame.get_ref().0;
    if (FRAME_MIN..=FRAME_MAX).contains(&length) {
        return Ok(length);
    }
    let found = format!(
        "the major frame of {length} is too {}",
        if length < FRAME_MIN { "short" } else { "long" }
    );
    Err(Diagnostic::new(frame.span(), found, format!("{FRAME_MIN} to {FRAME_MAX}")))
}

/// The one schedule of the file: its name and its table.
pub fn check(
    schedules: &[Spanned<Keys<raw::Schedule>>],
    system: &raw::System,
    header: &Span,
    partitions: &[Checked],
) -> Result<(String, Table), Diagnostic> {
    let allowed = "exactly one table [[schedule]] in this version of Takt";
    let schedule = match schedules {
        [] => return Err(Diagnostic::new(header.clone(), "the system has no schedule", allowed)),
        [one] => &one.get_ref().0,
        [first, second, ..] => {
            return Err(Diagnostic::new(second.span(), "a second schedule", allowed)
                .and(first.span(), "the other one"));
        }
    };
    let name = check_name(&schedule.name)?.to_owned();
    let raw: Vec<&raw::Window> = schedule.window.0.iter().map(|w| &w.get_ref().0).collect();
    let windows = raw.iter().map(|w| window(w, partitions)).collect::<Result<Vec<_>, _>>()?;
    let draft = Draft { frame: &system.major_frame, partitions, raw, windows };

    let placements: Vec<Placement> =
        partitions.iter().map(|p| Placement { cpu: p.partition.cpu, role: p.role }).collect();
    let frame = system.major_frame.get_ref().0;
    let table =
        Table::new(frame, &placements, &draft.windows).map_err(|error| draft.explain(error))?;
    table.cpus().into_iter().try_for_each(|cpu| draft.check_bandwidth(&table, cpu))?;
    Ok((name, table))
}

fn window(raw: &raw::Window, partitions: &[Checked]) -> Result<Window, Diagnostic> {
    let name = raw.partition.get_ref();
    let Some(owner) = partitions.iter().find(|p| p.partition.name == *name) else {
        let names: Vec<String> = partitions.iter().map(|p| quote(&p.partition.name)).collect();
        let found = format!("there is no partition {}", quote(name));
        return Err(Diagnostic::new(raw.partition.span(), found, names.join(", ")));
    };
    Ok(Window {
        partition: owner.partition.id,
        offset: raw.offset.get_ref().0,
        duration: raw.duration.get_ref().0,
    })
}

impl Draft<'_> {
    fn explain(&self, error: TableError) -> Diagnostic {
        let found = error.to_string();
        match error {
            TableError::Frame { .. } => {
                Diagnostic::new(self.frame.span(), found, format!("{FRAME_MIN} to {FRAME_MAX}"))
            }
            TableError::NoSuchPartition { window } => {
                Diagnostic::new(self.raw[window].partition.span(), found, "a partition's name")
            }
            TableError::TooShort { window, .. } => {
                let allowed = format!("at least {WINDOW_MIN}");
                Diagnostic::new(self.raw[window].duration.span(), found, allowed)
            }
            TableError::PastFrame { window, frame, .. } => self.past_frame(window, frame, found),
            TableError::Overlap { earlier, later, end, .. } => {
                let allowed = format!(
                    "windows on one CPU one after another: this one from {end} on, \
                     or the other one shorter"
                );
                Diagnostic::new(self.raw[later].offset.span(), found, allowed)
                    .and(self.raw[earlier].duration.span(), "the other window")
            }
            TableError::NoRoomForGuard { window, before, guard, .. } => {
                self.no_room(window, before, guard, found)
            }
            TableError::TwoBackgrounds { first, second, .. } => {
                let background = |id: PartitionId| {
                    let partition = &self.partitions[id.0];
                    partition.background.clone().unwrap_or(partition.header.clone())
                };
                Diagnostic::new(background(second), found, "one background partition on each CPU")
                    .and(background(first), "the other one")
            }
            TableError::BackgroundWindow { window } => {
                let owner = &self.partitions[self.windows[window].partition.0];
                let allowed = "no window for a background partition, or `background = false`";
                Diagnostic::new(self.raw[window].partition.span(), found, allowed)
                    .and(owner.background.clone().unwrap_or(owner.header.clone()), "it is one")
            }
            TableError::NeverRuns { partition } => {
                let owner = &self.partitions[partition.0];
                let allowed = format!(
                    "a [[schedule.window]] with `partition = {}`, \
                     or for a \"linux\" `background = true`",
                    quote(&owner.partition.name)
                );
                Diagnostic::new(owner.name.clone(), found, allowed)
            }
        }
    }

    fn past_frame(&self, window: usize, frame: Nanos, found: String) -> Diagnostic {
        let Window { offset, .. } = self.windows[window];
        let rest = frame.less(offset);
        let (span, at_most) = if rest < WINDOW_MIN {
            let latest = frame.less(WINDOW_MIN);
            (self.raw[window].offset.span(), format!("the latest offset is {latest}"))
        } else {
            (self.raw[window].duration.span(), format!("at offset {offset} at most {rest}"))
        };
        let allowed = format!("windows that end within the major frame; {at_most}");
        Diagnostic::new(span, found, allowed).and(self.frame.span(), "the major frame")
    }

    fn no_room(&self, window: usize, before: usize, guard: Nanos, found: String) -> Diagnostic {
        let allowed = format!(
            "a gap of at least {guard} before each window of {}, or a shorter `release_guard`",
            quote(&self.partitions[self.windows[window].partition.0].partition.name)
        );
        let label = if before == window {
            "the window before it is itself, a frame earlier"
        } else if self.windows[before].offset > self.windows[window].offset {
            "the window before it, in the frame before"
        } else {
            "the window before it"
        };
        Diagnostic::new(self.raw[window].offset.span(), found, allowed)
            .and(self.raw[before].duration.span(), label)
    }

    /// Whether the kernel would admit what the windows of one CPU ask for. Points at the longest
    /// window: it weighs most.
    fn check_bandwidth(&self, table: &Table, cpu: Cpu) -> Result<(), Diagnostic> {
        let reservations = CpuReservations::of(table, cpu);
        let on_cpu =
            |(_, w): &(usize, &Window)| self.partitions[w.partition.0].partition.cpu == cpu;
        let longest =
            self.windows.iter().enumerate().filter(on_cpu).max_by_key(|(_, w)| w.duration);
        let Some((longest, _)) = longest else { return Ok(()) };
        if reservations.permille() <= CEILING_PERMILLE {
            return Ok(());
        }
        let mut parts: Vec<String> = Vec::new();
        for (id, r) in &reservations.partitions {
            let name = quote(&self.partitions[id.0].partition.name);
            parts.push(format!("{} every {} for {name}", r.runtime, r.period));
        }
        parts.extend(
            reservations.kicker.map(|r| format!("{} every {} to end windows", r.runtime, r.period)),
        );
        let found = format!(
            "the windows of CPU {} reserve {} of it: {}",
            cpu.0,
            percent(reservations.permille()),
            parts.join(", ")
        );
        let allowed = format!(
            "at most {} of a CPU; a partition reserves its guard, its longest window and \
             {KICK_MARGIN} in its shortest time from release to release",
            percent(CEILING_PERMILLE)
        );
        Err(Diagnostic::new(self.raw[longest].duration.span(), found, allowed))
    }
}

/// A share in parts of a thousand, as people write it.
pub fn percent(permille: u64) -> String {
    format!("{}.{} %", permille / 10, permille % 10)
}
