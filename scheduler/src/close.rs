//! Which windows another partition follows so closely that their ends must come in time, whatever the clock does.
//!
//! The schedule lies on the TSC, and threads sleep by a clock that may be steered ([`crate::sleep`]). A step of its
//! rate by a tenth is felt once, until a thread looks at the clock again: by a ninth of what was left of each sleep.
//! A program that never ends is then kicked out late, and the thread of another partition wakes late if it has not
//! looked since before that window. Both matter only where the other one's release comes soon after. Before the end of
//! such a window the window enforcer looks at the clock
//! ([`Sleeper::until_end`](crate::sleep::Sleeper::until_end)), and tells the others of a step.

use crate::quiet::{LEAD, WAKE_UP};
use crate::reservation::CpuReservations;
use crate::schedules::Schedules;
use crate::sleep::{LAZY, PIECE_MIN, SHORT, SURE};
use crate::table::{Cpu, KICK_TIME, PartitionId, Table, Window, guard_of};
use crate::time::Nanos;

/// What a clock that has become slower by a tenth may have run until the readings of two looks show it.
const UNSEEN: Nanos = Nanos::from_micros(40);

impl Schedules {
    /// Which windows on a CPU must end in time, by schedule and in the order of [`Table::windows_on`]: those that are
    /// followed closely, and those of a partition that has no budget for a late kick
    /// ([`CpuReservations::by_a_clock_whose_steering_is`]). None, if the window enforcer has no budget for a look.
    #[must_use]
    pub fn must_end_in_time_on(&self, cpu: Cpu) -> Vec<Vec<bool>> {
        let reservations = CpuReservations::of(self, cpu);
        let may_look = reservations.has_room_for_looks();
        let without_room: Vec<PartitionId> = reservations.without_room().collect();
        let of = |table: &Table| {
            let must = |window: &Window| {
                without_room.contains(&window.partition)
                    || self.is_followed_closely(table, window, cpu)
            };
            table.windows_on(cpu).map(|window| may_look && must(window)).collect()
        };
        self.tables().iter().map(of).collect()
    }

    /// Whether another partition follows `window` closely, under its own schedule and whatever the next frame has.
    #[must_use]
    pub fn is_followed_closely(&self, table: &Table, window: &Window, cpu: Cpu) -> bool {
        let this_frame = table.windows_on(cpu).filter(|next| next.offset > window.offset);
        let this_frame = this_frame.map(|next| (next, next.offset));
        let next_frame = self.tables().iter().flat_map(|table| table.windows_on(cpu));
        let next_frame = next_frame.map(|next| (next, self.frame().plus(next.offset)));
        let guard = |window| guard_of(self.placements(), window);
        this_frame.chain(next_frame).any(|(next, start)| {
            let another = next.partition != window.partition && guard(next) > Nanos::ZERO;
            let asleep = guard(window).plus(window.duration);
            another && is_close(asleep, start.less(window.end()))
        })
    }
}

/// Whether a release that comes `until` after the end of a window is close to one that lasts `asleep` with its own
/// guard: a kick that is as late as it may be reaches it, and so does a thread that has last looked before that window,
/// and may wake behind it only.
fn is_close(asleep: Nanos, until: Nanos) -> bool {
    // The owner's thread is the last to look before the window.
    let unseen = asleep.plus(SHORT).plus(UNSEEN).min(LAZY);
    Nanos(unseen.0.div_ceil(9)).plus(KICK_TIME) > until
}

/// How often the window enforcer may look at the clock within a window of this length. In one that need not end in time
/// only the sleep to the end of a long one is divided.
#[must_use]
pub fn looks_within(window: Nanos, guard: Nanos, must_end_in_time: bool) -> u64 {
    let whole = if must_end_in_time { SURE } else { LAZY };
    let mut remaining = window.plus(guard).plus(LEAD).plus(WAKE_UP).plus(PIECE_MIN);
    let mut looks = 0;
    while remaining > whole {
        remaining = Nanos(remaining.0.div_ceil(9));
        looks += 1;
    }
    looks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::{Placement, Role};

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    fn window(partition: usize, offset: u64, duration: u64) -> Window {
        let [offset, duration, period] = [offset, duration, 2_000].map(us);
        Window { partition: PartitionId(partition), offset, duration, period }
    }

    /// For windows of three partitions with a guard of 20 us each, in a frame of 2 ms.
    fn must_end_in_time(schedules: &[&[Window]]) -> Vec<Vec<bool>> {
        let placement = Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } };
        let owners = schedules.concat().iter().map(|window| window.partition.0).max().unwrap();
        let placements = vec![placement; owners + 1];
        Schedules::new(us(2_000), &placements, schedules).unwrap().must_end_in_time_on(Cpu(0))
    }

    #[test]
    fn a_window_is_followed_closely_where_a_late_kick_reaches_the_next_release() {
        // (300 + 20 + 112 + 40) / 9 + 30 = 83.
        for (offset, expected) in [(350, true), (382, true), (384, false)] {
            let windows = [window(0, 0, 300), window(1, offset, 100)];
            assert_eq!(must_end_in_time(&[&windows]), [[expected, false]], "{offset}");
        }
    }

    #[test]
    fn one_of_its_own_and_the_next_frame_count_as_they_are() {
        let own = [window(0, 0, 300), window(0, 320, 100)];
        assert_eq!(must_end_in_time(&[&own]), [[false, false]]);
        let last = [window(1, 0, 100), window(0, 1_650, 300)];
        assert_eq!(must_end_in_time(&[&last]), [[false, true]]);
        // Whatever schedule the next frame has.
        let alone = [window(0, 1_650, 300)];
        let first = [window(1, 0, 100)];
        assert_eq!(must_end_in_time(&[&alone, &first]), [vec![true], vec![false]]);
    }

    #[test]
    fn one_whose_partition_has_no_budget_for_a_late_kick_must_end_in_time_too() {
        let long = |duration| must_end_in_time(&[&[window(0, 0, duration)]]);
        let found = [1_200, 1_450, 1_540].map(long);
        // The last one leaves no budget for a look.
        assert_eq!(found, [[[false]], [[true]], [[false]]]);
    }

    #[test]
    fn looks_in_a_window_are_few_and_more_in_a_long_one() {
        let within = |n| {
            let looks = |must_end_in_time| looks_within(us(n), us(20), must_end_in_time);
            (looks(true), looks(false))
        };
        assert_eq!(
            [100, 300, 1_500, 3_000, 20_000].map(within),
            [(0, 0), (1, 0), (1, 0), (2, 1), (3, 2)]
        );
    }
}
