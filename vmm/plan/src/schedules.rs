//! The schedules: windows with names become windows with numbers, and the scheduler's own rules
//! are applied.
//!
//! The rules of time live in `takt_scheduler`, where they are tested exhaustively. They speak of
//! window 3 and partition 0; a [`Draft`] knows the lines those came from, and [`super::explain`]
//! brings both together.

use takt_scheduler::guard::{AUTO_LEAST, AUTO_MOST};
use takt_scheduler::reservation::{
    CEILING_PERMILLE, CpuReservations, KICK_MARGIN, KICKER_PIECE, Reservation,
};
use takt_scheduler::schedules::{SCHEDULES_MAX, ScheduleId, Schedules, SchedulesError};
use takt_scheduler::table::{Cpu, FRAME_MAX, FRAME_MIN, PartitionId, Placement, Role, Window};
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::names::check_name;
use super::partition::{self, Checked};
use super::periods;
use super::raw::{self, Keys};
use super::units::Duration;

/// All schedules as they are written, beside what the scheduler takes.
pub struct Draft<'a> {
    /// The header of `[system]`.
    pub header: &'a Span,
    pub frame: &'a Spanned<Duration>,
    pub partitions: &'a [Checked],
    pub schedules: Vec<Lines<'a>>,
}

/// One schedule of a [`Draft`].
pub struct Lines<'a> {
    pub header: Span,
    pub name: &'a Spanned<String>,
    /// The windows, and what the scheduler takes for each.
    pub raw: Vec<&'a Spanned<Keys<raw::Window>>>,
    pub windows: Vec<Window>,
}

/// The bounds of the major frame's length.
pub fn check_frame(frame: &Spanned<Duration>) -> Result<(), Diagnostic> {
    let length = frame.get_ref().0;
    if (FRAME_MIN..=FRAME_MAX).contains(&length) {
        return Ok(());
    }
    let found = format!(
        "the major frame of {length} is too {}",
        if length < FRAME_MIN { "short" } else { "long" }
    );
    Err(Diagnostic::new(frame.span(), found, format!("{FRAME_MIN} to {FRAME_MAX}")))
}

impl<'a> Draft<'a> {
    /// Reads names, and finds the owner of each window.
    pub fn new(
        schedules: &'a [Spanned<Keys<raw::Schedule>>],
        system: &'a raw::System,
        header: &'a Span,
        partitions: &'a [Checked],
    ) -> Result<Draft<'a>, Diagnostic> {
        let frame = &system.major_frame;
        let mut draft = Draft { header, frame, partitions, schedules: Vec::new() };
        for schedule in schedules {
            let next = draft.lines(schedule)?;
            if draft.schedules.len() == SCHEDULES_MAX {
                // Before names are compared: those of thousands would take long.
                draft.schedules.push(next);
                return Err(draft.explain(SchedulesError::Count { count: schedules.len() }));
            }
            let same = |other: &&Lines<'_>| other.name.get_ref() == next.name.get_ref();
            if let Some(other) = draft.schedules.iter().find(same) {
                let found = format!("a second schedule is named {}", quote(next.name.get_ref()));
                let allowed = "a name of its own for each schedule";
                return Err(Diagnostic::new(next.name.span(), found, allowed)
                    .and(other.name.span(), "the other one"));
            }
            draft.schedules.push(next);
        }
        Ok(draft)
    }

    fn lines(&self, schedule: &'a Spanned<Keys<raw::Schedule>>) -> Result<Lines<'a>, Diagnostic> {
        let Keys(raw) = schedule.get_ref();
        check_name(&raw.name)?;
        let windows = raw.window.0.iter().map(|w| self.window(&w.get_ref().0));
        Ok(Lines {
            header: schedule.span(),
            name: &raw.name,
            windows: windows.collect::<Result<_, _>>()?,
            raw: raw.window.0.iter().collect(),
        })
    }

    fn window(&self, raw: &raw::Window) -> Result<Window, Diagnostic> {
        let owner =
            partition::find(self.partitions, raw.partition.get_ref(), raw.partition.span())?;
        Ok(Window {
            partition: owner.partition.id,
            offset: raw.offset.get_ref().0,
            duration: raw.duration.get_ref().0,
            period: raw.period.as_ref().unwrap_or(self.frame).get_ref().0,
        })
    }

    /// Applies the scheduler's rules, and that of the kernel's deadline scheduler.
    pub fn check(&self) -> Result<Schedules, Diagnostic> {
        let mut placements: Vec<Placement> = self
            .partitions
            .iter()
            .map(|p| Placement { cpu: p.partition.cpu, role: p.role })
            .collect();
        let windows: Vec<&[Window]> = self.schedules.iter().map(|s| &*s.windows).collect();
        let frame = self.frame.get_ref().0;
        let make = |placements: &[Placement]| {
            Schedules::new(frame, placements, &windows).map_err(|error| self.explain(error))
        };
        let mut schedules = make(&placements)?;
        if self.partitions.iter().any(|p| p.partition.auto_guard) {
            for (placement, checked) in placements.iter_mut().zip(self.partitions) {
                let room = schedules.room_for_guard(checked.partition.id);
                if let (true, Some(room)) = (checked.partition.auto_guard, room) {
                    placement.role = Role::Windowed { guard: room.clamp(AUTO_LEAST, AUTO_MOST) };
                }
            }
            schedules = make(&placements)?;
        }
        for cpu in schedules.cpus() {
            periods::check(self, &schedules, cpu)?;
            self.check_bandwidth(&schedules, cpu)?;
        }
        let further = |p: &Checked| {
            let id = p.partition.id;
            p.partition.cpus().skip(1).map(|cpu| (id, cpu)).collect::<Vec<_>>()
        };
        let further: Vec<(PartitionId, Cpu)> = self.partitions.iter().flat_map(further).collect();
        Ok(schedules.with_further(&further))
    }

    /// The names, by [`ScheduleId`].
    pub fn names(&self) -> Vec<String> {
        self.schedules.iter().map(|s| s.name.get_ref().clone()).collect()
    }

    /// A partition's longest window in a schedule.
    pub fn longest(&self, schedule: ScheduleId, owner: PartitionId) -> Option<&raw::Window> {
        self.schedules[schedule.0].longest(|w| w.partition == owner).map(|(_, raw)| raw)
    }

    /// Whether the kernel would admit what the windows of one CPU ask for. Points at the longest
    /// window: it weighs most.
    fn check_bandwidth(&self, schedules: &Schedules, cpu: Cpu) -> Result<(), Diagnostic> {
        let reservations = CpuReservations::of(schedules, cpu);
        let on_cpu = |w: &Window| self.partitions[w.partition.0].partition.cpu == cpu;
        let longest = self
            .schedules
            .iter()
            .filter_map(|schedule| schedule.longest(on_cpu))
            .max_by_key(|(window, _)| window.duration);
        let Some((_, longest)) = longest else { return Ok(()) };
        if reservations.permille() <= CEILING_PERMILLE {
            return match reservations.kicker.filter(|_| !reservations.has_room_for_looks()) {
                Some(kicker) => self.check_ends(schedules, cpu, reservations.permille(), kicker),
                None => Ok(()),
            };
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
        let across = if self.schedules.len() > 1 { ", also across a switch" } else { "" };
        let allowed = format!(
            "at most {} of a CPU; a partition reserves its guard, its longest window and \
             {KICK_MARGIN} in its shortest time from release to release{across}",
            percent(CEILING_PERMILLE)
        );
        Err(Diagnostic::new(longest.duration.span(), found, allowed))
    }

    /// Whether windows that must end in time under a steered clock do, on a CPU on which nothing can look at the clock
    /// ([`takt_scheduler::close`]).
    fn check_ends(
        &self,
        schedules: &Schedules,
        cpu: Cpu,
        reserved: u64,
        kicker: Reservation,
    ) -> Result<(), Diagnostic> {
        for (lines, table) in self.schedules.iter().zip(schedules.tables()) {
            let close: Vec<&Window> = table
                .windows_on(cpu)
                .filter(|window| schedules.is_followed_closely(table, window, cpu))
                .collect();
            // What the file has once may be repeated, and followed closely at any of its places.
            let followed = |once: &Window| {
                close.iter().any(|window| {
                    (window.partition, window.duration) == (once.partition, once.duration)
                        && window.offset.less(once.offset).0 % once.period.0 == 0
                })
            };
            let Some((_, window)) = lines.longest(followed) else { continue };
            let found = format!(
                "another partition's window follows closely, and CPU {} has no room for a look at the clock before this \
                 one ends: {} of it are reserved, and {KICKER_PIECE} more every {} are needed",
                cpu.0,
                percent(reserved),
                kicker.period,
            );
            let allowed = format!(
                "at most {} of a CPU with that, or a longer gap behind this window",
                percent(CEILING_PERMILLE)
            );
            return Err(Diagnostic::new(window.duration.span(), found, allowed));
        }
        Ok(())
    }
}

impl Lines<'_> {
    /// The longest of some windows; of equal ones the last.
    fn longest(&self, of: impl Fn(&Window) -> bool) -> Option<(&Window, &raw::Window)> {
        let raw = self.raw.iter().map(|raw| &raw.get_ref().0);
        let windows = self.windows.iter().zip(raw).filter(|(window, _)| of(window));
        windows.max_by_key(|(window, _)| window.duration)
    }
}

/// A share in parts of a thousand, as people write it.
pub fn percent(permille: u64) -> String {
    format!("{}.{} %", permille / 10, permille % 10)
}
