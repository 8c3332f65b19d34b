//! Whether a PLC's windows are entered, as the supervisor thread sees it.
//!
//! A thread that comes too late tells of that itself. One that does not come at all cannot.

use takt_scheduler::switch::Switch;
use takt_scheduler::time::Nanos;
use takt_scheduler::timetable::{Slot, Timetable};

use crate::health::Detail;

/// How long no window may be entered, beyond two frames: a window is told of at its end.
const PATIENCE: Nanos = Nanos::from_millis(1_000);

/// When a window was entered last.
pub struct Attendance {
    timetable: Timetable,
    /// Time in windows so far.
    occupied: Nanos,
    /// When that was seen to grow, or did not have to; `None` from the error until then.
    seen: Option<Nanos>,
}

impl Attendance {
    /// From the epoch on.
    #[must_use]
    pub fn new(timetable: Timetable) -> Self {
        Self { timetable, occupied: Nanos::ZERO, seen: Some(Nanos::ZERO) }
    }

    /// The error that windows were not entered for too long, once. `occupied` grows with each window, and there is
    /// none while there is no guest.
    pub fn look(&mut self, occupied: Option<Nanos>, switch: Switch, now: Nanos) -> Option<Detail> {
        let slot = self.timetable.catch_up(&self.timetable.first(switch), now, switch);
        if matches!(slot, Slot::Idle(_)) || occupied != Some(self.occupied) {
            (self.occupied, self.seen) = (occupied.unwrap_or(self.occupied), Some(now));
        }
        let (absent, frame) = (now.less(self.seen?), self.timetable.frame());
        let found = absent > frame.plus(frame).plus(PATIENCE);
        self.seen = self.seen.filter(|_| !found);
        found.then(|| Detail::Absent(Nanos::from_millis(absent.0 / 1_000_000)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::schedules::{ScheduleId, Schedules};
    use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};

    /// A frame of 10 ms, and a window in the first of two schedules.
    fn attendance() -> Attendance {
        let ms = Nanos::from_millis;
        let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos(20_000) } };
        let window = |id, at| Window {
            partition: PartitionId(id),
            offset: ms(at),
            duration: ms(1),
            period: ms(10),
        };
        let tables: [&[Window]; 2] = [&[window(0, 1), window(1, 5)], &[window(1, 5)]];
        let schedules = Schedules::new(ms(10), &[plc, plc], &tables).unwrap();
        Attendance::new(schedules.timetable_of(PartitionId(0)).unwrap())
    }

    const FIRST: Switch = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };

    #[test]
    fn a_plc_whose_windows_are_not_entered_is_told_of_once_until_one_is() {
        let mut attendance = attendance();
        let mut absent_at =
            |occupied, ms| attendance.look(Some(Nanos(occupied)), FIRST, Nanos::from_millis(ms));
        let absent = |ms| Some(Detail::Absent(Nanos::from_millis(ms)));
        assert_eq!([absent_at(0, 1_020), absent_at(0, 1_021)], [None, absent(1_021)]);
        assert_eq!([absent_at(0, 9_000), absent_at(1, 10_000)], [None, None]);
        assert_eq!([absent_at(1, 11_020), absent_at(1, 11_040)], [None, absent(1_040)]);
    }

    #[test]
    fn a_plc_without_a_guest_or_without_windows_misses_none() {
        let mut attendance = attendance();
        let ms = Nanos::from_millis;
        // The second schedule holds from 2 s to 6 s.
        let leaves = Switch { before: ScheduleId(0), after: ScheduleId(1), frame: 200 };
        let comes = Switch { before: ScheduleId(1), after: ScheduleId(0), frame: 600 };
        assert_eq!(attendance.look(None, FIRST, ms(1_900)), None);
        let mut at = |switch, at| attendance.look(Some(Nanos::ZERO), switch, ms(at));
        assert_eq!([at(leaves, 2_500), at(leaves, 5_000), at(comes, 5_980)], [None; 3]);
        assert_eq!(at(comes, 6_900), None);
        assert_eq!(at(comes, 7_100), Some(Detail::Absent(ms(1_120))));
    }
}
