//! All schedules of a system: one table each, for the same partitions and the same frame.
//!
//! Each table is sound by itself. What is checked here is what only shows between them: the last
//! window of one schedule and the first of another meet at a switch, so there has to be room for
//! the guard there too, and a partition must run in at least one of them.

use thiserror::Error;

use crate::quiet::QuietTimes;
use crate::table::{
    Cpu, KICK_TIME, PartitionId, Placement, Role, Table, TableError, Window, guard_of, room_before,
};
pub use crate::table::{SCHEDULES_MAX, ScheduleId};
use crate::time::Nanos;
use crate::timetable::Timetable;

/// Why schedules are not sound. Windows are given by their positions in the input.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SchedulesError {
    /// There is none, or there are more than [`SCHEDULES_MAX`].
    #[error("there are {count} schedules, not 1 to {SCHEDULES_MAX}")]
    Count {
        /// How many there are.
        count: usize,
    },
    /// One of them is not sound.
    #[error("{error}")]
    Table {
        /// The schedule.
        schedule: ScheduleId,
        /// What is wrong with it.
        error: TableError,
    },
    /// A schedule beside others has no window: no partition could ask for another one again.
    #[error("the schedule has no window")]
    Empty {
        /// The schedule.
        schedule: ScheduleId,
    },
    /// A partition that is not the background has no window in any schedule.
    #[error("the partition would never run: it has no window and is not the background")]
    NeverRuns {
        /// The partition.
        partition: PartitionId,
    },
    /// At a switch, the guard of the first window reaches into the last one of the schedule before.
    #[error(
        "at a switch of schedules the release guard of {guard} needs a gap of {room} before the \
         window, but there is {gap}"
    )]
    NoRoomAtSwitch {
        /// The schedule that is left.
        from: ScheduleId,
        /// The schedule that is entered, and whose guard has no room.
        to: ScheduleId,
        /// The CPU.
        cpu: Cpu,
        /// The guard.
        guard: Nanos,
        /// The least time between the two windows.
        room: Nanos,
        /// The time between the two windows.
        gap: Nanos,
    },
}

/// Sound schedules; at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedules {
    tables: Box<[Table]>,
}

impl Schedules {
    /// Checks the schedules, given as the windows of each.
    ///
    /// # Errors
    /// The first rule that is broken, see [`SchedulesError`].
    pub fn new(
        frame: Nanos,
        placements: &[Placement],
        schedules: &[&[Window]],
    ) -> Result<Schedules, SchedulesError> {
        if !(1..=SCHEDULES_MAX).contains(&schedules.len()) {
            return Err(SchedulesError::Count { count: schedules.len() });
        }
        let table = |(i, windows): (usize, &&[Window])| {
            let schedule = ScheduleId(i);
            if windows.is_empty() && schedules.len() > 1 {
                return Err(SchedulesError::Empty { schedule });
            }
            Table::new(frame, placements, windows)
                .map_err(|error| SchedulesError::Table { schedule, error })
        };
        let tables = schedules.iter().enumerate().map(table).collect::<Result<_, _>>()?;
        let this = Schedules { tables };
        this.check_everyone_runs()?;
        this.check_switches()?;
        Ok(this)
    }

    /// The same schedules, with CPUs that background partitions have beyond those of their placements, each of them
    /// once. They change no window, so nothing is to be checked anew.
    #[must_use]
    pub fn with_further(self, further: &[(PartitionId, Cpu)]) -> Schedules {
        Schedules { tables: self.tables.into_iter().map(|t| t.with_further(further)).collect() }
    }

    fn check_everyone_runs(&self) -> Result<(), SchedulesError> {
        let runs = |partition: PartitionId| {
            self.placements()[partition.0].role == Role::Background
                || self.tables.iter().any(|t| t.windows_of(partition).next().is_some())
        };
        match (0..self.placements().len()).map(PartitionId).find(|p| !runs(*p)) {
            None => Ok(()),
            Some(partition) => Err(SchedulesError::NeverRuns { partition }),
        }
    }

    fn check_switches(&self) -> Result<(), SchedulesError> {
        for cpu in self.cpus() {
            for (to, next) in self.tables.iter().enumerate() {
                let Some(first) = next.windows_on(cpu).next() else { continue };
                for (from, last) in self.tables.iter().enumerate() {
                    let Some(last) = last.windows_on(cpu).last() else { continue };
                    let gap = self.frame().plus(first.offset).less(last.end());
                    let room = room_before(self.placements(), first, last);
                    if gap < room {
                        return Err(SchedulesError::NoRoomAtSwitch {
                            from: ScheduleId(from),
                            to: ScheduleId(to),
                            cpu,
                            guard: guard_of(self.placements(), first),
                            room,
                            gap,
                        });
                    }
                }
            }
        }
        Ok(())
    }

    /// The longest guard for which the gaps before the windows of a partition leave room, under every
    /// schedule and at every switch; `None` without windows.
    #[must_use]
    pub fn room_for_guard(&self, partition: PartitionId) -> Option<Nanos> {
        let cpu = self.placements().get(partition.0)?.cpu;
        let own = |(window, _, _): &(&Window, &Window, Nanos)| window.partition == partition;
        let room = |(_, before, gap): (&Window, &Window, Nanos)| {
            gap.less(if before.partition == partition { Nanos::ZERO } else { KICK_TIME })
        };
        let gaps = self.tables.iter().flat_map(|table| gaps_in(table, cpu));
        gaps.chain(self.gaps_at_switches(cpu)).filter(own).map(room).min()
    }

    /// How far into a window of a partition the kick of another partition can reach, under any schedule
    /// and at any switch: nowhere if the partition has a guard, whose gaps have room for a kick.
    #[must_use]
    pub fn kick_into(&self, partition: PartitionId) -> Nanos {
        let Some(cpu) = self.placements().get(partition.0).map(|p| p.cpu) else {
            return Nanos::ZERO;
        };
        let behind_another = |(window, before, _): &(&Window, &Window, Nanos)| {
            window.partition == partition && before.partition != partition
        };
        let gaps = self.tables.iter().flat_map(|table| gaps_in(table, cpu));
        let gaps = gaps.chain(self.gaps_at_switches(cpu)).filter(behind_another);
        gaps.map(|(_, _, gap)| KICK_TIME.less(gap)).max().unwrap_or(Nanos::ZERO)
    }

    /// The first window of each schedule, the last one of each, and the time between them.
    fn gaps_at_switches(&self, cpu: Cpu) -> impl Iterator<Item = (&Window, &Window, Nanos)> {
        let firsts = self.tables.iter().filter_map(move |table| table.windows_on(cpu).next());
        firsts.flat_map(move |first| {
            let lasts = self.tables.iter().filter_map(move |table| table.windows_on(cpu).last());
            lasts.map(move |last| (first, last, self.frame().plus(first.offset).less(last.end())))
        })
    }

    /// The tables, by [`ScheduleId`]; never empty.
    #[must_use]
    pub fn tables(&self) -> &[Table] {
        &self.tables
    }

    /// Length of the major frame.
    #[must_use]
    pub fn frame(&self) -> Nanos {
        self.tables[0].frame()
    }

    /// Where each partition runs, by [`PartitionId`].
    #[must_use]
    pub fn placements(&self) -> &[Placement] {
        self.tables[0].placements()
    }

    /// The CPUs that the partitions use, in order, each once.
    #[must_use]
    pub fn cpus(&self) -> Vec<Cpu> {
        self.tables[0].cpus()
    }

    /// When a partition runs; `None` for a background partition, which has no releases.
    #[must_use]
    pub fn timetable_of(&self, partition: PartitionId) -> Option<Timetable> {
        self.timetable(|table| table.windows_of(partition).collect())
    }

    /// The windows of all partitions on a CPU, each in the order of [`Table::windows_on`]; `None`
    /// where there are none in any schedule.
    #[must_use]
    pub fn timetable_on(&self, cpu: Cpu) -> Option<Timetable> {
        self.timetable(|table| table.windows_on(cpu).collect())
    }

    /// When only the owners of windows should be served on a CPU, under all schedules; without
    /// the windows of `except`. `None` where there are none.
    #[must_use]
    pub fn quiet_on(&self, cpu: Cpu, except: Option<PartitionId>) -> Option<QuietTimes> {
        QuietTimes::new(&self.tables, cpu, except)
    }

    fn timetable<'a>(
        &'a self,
        windows: impl Fn(&'a Table) -> Vec<&'a Window>,
    ) -> Option<Timetable> {
        let span = |w: &&Window| (w.offset, w.end());
        let schedules: Box<[Box<[_]>]> =
            self.tables.iter().map(|t| windows(t).iter().map(span).collect()).collect();
        let any = schedules.iter().any(|windows| !windows.is_empty());
        any.then(|| Timetable::new(self.frame(), schedules))
    }

    /// The least time per frame that is a partition's own, over all schedules; see
    /// [`Table::guaranteed`].
    #[must_use]
    pub fn guaranteed(&self, partition: PartitionId) -> Nanos {
        self.tables.iter().map(|t| t.guaranteed(partition)).min().unwrap_or(Nanos::ZERO)
    }
}

/// Each window of a CPU, the one before it in the circle of the frame, and the time between them.
fn gaps_in(table: &Table, cpu: Cpu) -> Vec<(&Window, &Window, Nanos)> {
    let windows: Vec<&Window> = table.windows_on(cpu).collect();
    let Some(&last) = windows.last() else { return Vec::new() };
    let mut before = last;
    // The one before the first is the last one of the frame before.
    let mut start = table.frame();
    let mut gaps = Vec::with_capacity(windows.len());
    for window in windows {
        gaps.push((window, before, start.plus(window.offset).less(before.end())));
        (before, start) = (window, Nanos::ZERO);
    }
    gaps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    fn plc() -> Placement {
        Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } }
    }

    fn window(partition: usize, offset: u64, duration: u64) -> Window {
        let partition = PartitionId(partition);
        Window { partition, offset: us(offset), duration: us(duration), period: us(1000) }
    }

    fn new(partitions: usize, schedules: &[&[Window]]) -> Result<Schedules, SchedulesError> {
        Schedules::new(us(1000), &vec![plc(); partitions], schedules)
    }

    #[test]
    fn one_to_sixteen() {
        let one: &[Window] = &[window(0, 0, 100)];
        assert_eq!(new(1, &[]), Err(SchedulesError::Count { count: 0 }));
        assert!(new(1, &[one; 16]).is_ok());
        assert_eq!(new(1, &[one; 17]), Err(SchedulesError::Count { count: 17 }));
    }

    #[test]
    fn a_defect_names_its_schedule() {
        let error = TableError::TooShort { window: 0, duration: us(9) };
        assert_eq!(
            new(1, &[&[window(0, 0, 100)], &[window(0, 0, 9)]]),
            Err(SchedulesError::Table { schedule: ScheduleId(1), error })
        );
        assert_eq!(
            new(1, &[&[window(0, 0, 100)], &[]]),
            Err(SchedulesError::Empty { schedule: ScheduleId(1) })
        );
    }

    #[test]
    fn everyone_runs_in_some_schedule() {
        assert!(new(2, &[&[window(0, 0, 100)], &[window(1, 0, 100)]]).is_ok());
        let never = Err(SchedulesError::NeverRuns { partition: PartitionId(1) });
        assert_eq!(new(2, &[&[window(0, 0, 100)], &[window(0, 200, 100)]]), never);
        assert_eq!(new(2, &[&[window(0, 0, 100)]]), never);
        let background = Placement { cpu: Cpu(0), role: Role::Background };
        assert!(Schedules::new(us(1000), &[background], &[&[]]).is_ok());
    }

    #[test]
    fn a_guard_needs_room_at_a_switch_too() {
        let late = [window(0, 700, 300)];
        let early = [window(0, 0, 300)];
        assert!(new(1, &[&late]).is_ok() && new(1, &[&early]).is_ok());
        let (from, to) = (ScheduleId(1), ScheduleId(0));
        assert_eq!(
            new(1, &[&early, &late]),
            Err(SchedulesError::NoRoomAtSwitch {
                from,
                to,
                cpu: Cpu(0),
                guard: us(20),
                room: us(20),
                gap: us(0)
            })
        );
        assert!(new(1, &[&early, &[window(0, 680, 300)]]).is_ok());
    }

    #[test]
    fn the_room_for_a_guard_is_where_the_next_longer_one_is_refused() {
        let with = |guard: u64, schedules: &[&[Window]]| {
            let role = Role::Windowed { guard: us(guard) };
            let other = |cpu| Placement { cpu: Cpu(cpu), role: Role::Windowed { guard: us(0) } };
            let placements = [Placement { role, ..plc() }, other(0), other(1)];
            Schedules::new(us(1000), &placements, schedules)
        };
        let others = [window(1, 400, 100), window(2, 0, 900)];
        let first = |own: &[Window]| [own, &others].concat();
        for (schedules, room) in [
            (vec![first(&[window(0, 550, 100)])], 20),
            (vec![first(&[window(0, 0, 300)])], 470),
            (vec![first(&[window(0, 50, 100), window(0, 200, 100)])], 50),
            (vec![first(&[window(0, 0, 300)]), vec![window(0, 600, 350)]], 50),
            (vec![vec![window(1, 990, 10), window(2, 0, 10)], first(&[window(0, 60, 300)])], 30),
        ] {
            let windows: Vec<&[Window]> = schedules.iter().map(Vec::as_slice).collect();
            let found = with(1, &windows).unwrap().room_for_guard(PartitionId(0));
            assert_eq!(found, Some(us(room)), "{windows:?}");
            assert!(with(room, &windows).is_ok(), "{windows:?}");
            assert!(with(room + 1, &windows).is_err(), "{windows:?}");
        }
        let background = Placement { cpu: Cpu(0), role: Role::Background };
        let none = Schedules::new(us(1000), &[background], &[&[]]).unwrap();
        assert_eq!(none.room_for_guard(PartitionId(0)), None);
    }

    #[test]
    fn a_kick_reaches_into_a_window_where_the_gap_before_it_is_short() {
        let role = Role::Windowed { guard: us(0) };
        let placements = [Placement { role, ..plc() }; 2];
        let into = |schedules: &[&[Window]]| {
            let schedules = Schedules::new(us(1000), &placements, schedules).unwrap();
            schedules.kick_into(PartitionId(0))
        };
        let own = window(0, 300, 100);
        assert_eq!(into(&[&[own, window(1, 0, 300)]]), us(30));
        assert_eq!(into(&[&[own, window(1, 0, 289)]]), us(19));
        assert_eq!(into(&[&[own, window(1, 0, 270)]]), us(0));
        // Its own windows end without a kick of another partition.
        assert_eq!(into(&[&[own, window(0, 400, 100), window(1, 600, 100)]]), us(0));
        // Around the end of the frame, and at a switch.
        assert_eq!(into(&[&[window(0, 0, 100), window(1, 500, 495)]]), us(25));
        assert_eq!(into(&[&[window(0, 5, 100)], &[window(1, 500, 500)]]), us(25));
    }

    #[test]
    fn a_share_is_promised_under_every_schedule() {
        let both = new(1, &[&[window(0, 0, 300)], &[window(0, 0, 100)]]).unwrap();
        assert_eq!(both.guaranteed(PartitionId(0)), us(100));
    }
}
