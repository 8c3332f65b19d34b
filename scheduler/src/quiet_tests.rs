//! Quiet times against an oracle that looks at every window of every frame.

use proptest::prelude::*;

use super::*;
use crate::schedules::Schedules;
use crate::table::{Placement, Role, ScheduleId, Window};

const CPU: Cpu = Cpu(0);

fn us(n: u64) -> Nanos {
    Nanos::from_micros(n)
}

/// The quiet times of schedules of a PLC with this guard, all times in us.
fn quiet(frame: u64, guard: u64, schedules: &[&[(u64, u64)]]) -> QuietTimes {
    let placement = Placement { cpu: CPU, role: Role::Windowed { guard: us(guard) } };
    let window = |&(offset, end): &(u64, u64)| Window {
        partition: PartitionId(0),
        offset: us(offset),
        duration: us(end - offset),
        period: us(frame),
    };
    let windows: Vec<Vec<Window>> =
        schedules.iter().map(|windows| windows.iter().map(window).collect()).collect();
    let windows: Vec<&[Window]> = windows.iter().map(Vec::as_slice).collect();
    Schedules::new(us(frame), &[placement], &windows).unwrap().quiet_on(CPU, None).unwrap()
}

fn switch(frame: u64) -> Switch {
    Switch { before: ScheduleId(0), after: ScheduleId(1), frame }
}

/// No switch at all.
const STAY: Switch = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };

#[test]
fn a_deadline_in_a_window_or_its_guard_waits_for_the_end() {
    let quiet = quiet(1000, 20, &[&[(0, 300)]]);
    let defer = |deadline: u64| quiet.defer(Nanos(deadline), Nanos(400_000), STAY).map(|t| t.0);
    assert_eq!(defer(969_999), None);
    assert_eq!(defer(970_000), Some(1_305_000), "its interrupt could last until the guard begins");
    assert_eq!(defer(980_000), Some(1_305_000), "the guard lies in the frame before");
    assert_eq!(defer(1_000_000), Some(1_305_000));
    assert_eq!(defer(1_304_999), Some(1_305_000), "it may expire that much early");
    assert_eq!(defer(1_305_000), None);
    assert_eq!(defer(3_600_000_299_999), Some(3_600_000_305_000), "an hour on");
}

#[test]
fn what_has_passed_and_what_never_comes_stay_where_they_are() {
    let quiet = quiet(1000, 20, &[&[(0, 300)]]);
    assert_eq!(quiet.defer(us(1_100), us(1_100), STAY), None);
    assert_eq!(quiet.defer(us(1_100), us(5_000), STAY), None);
    assert_eq!(quiet.defer(Nanos(0), us(5), STAY), None);
    // At the end of the type's time there is nothing to move it to.
    let last = Nanos(u64::MAX);
    assert!(quiet.defer(last, us(5), STAY).is_none_or(|moved| moved > last));
}

#[test]
fn the_rest_of_a_window_in_which_the_guest_runs_is_free() {
    let quiet = quiet(1000, 20, &[&[(100, 400), (420, 500)]]);
    let defer = |deadline, now| quiet.defer(us(deadline), us(now), STAY);
    assert_eq!(defer(300, 200), None, "its owner has given it back");
    assert_eq!(defer(300, 99), Some(us(505)), "it is still to come");
    assert_eq!(defer(410, 200), Some(us(505)), "the next one is not given back");
    assert_eq!(defer(405, 390), Some(us(505)));
    assert_eq!(defer(1_300, 200), Some(us(1_505)), "nor is that of the next frame");
}

#[test]
fn a_window_of_the_guests_own_is_none_of_the_others() {
    let plc = Placement { cpu: CPU, role: Role::Windowed { guard: us(20) } };
    let window = |partition, offset| Window {
        partition: PartitionId(partition),
        offset: us(offset),
        duration: us(100),
        period: us(1000),
    };
    let windows = [window(0, 100), window(1, 500)];
    let schedules = Schedules::new(us(1000), &[plc, plc], &[&windows]).unwrap();
    let own = schedules.quiet_on(CPU, Some(PartitionId(1))).unwrap();
    assert_eq!(own.defer(us(550), us(0), STAY), None);
    assert_eq!(own.defer(us(150), us(0), STAY), Some(us(205)));
    assert_eq!(schedules.quiet_on(Cpu(1), None), None);
}

#[test]
fn a_short_wake_up_is_over_before_the_quiet_time_that_it_would_fall_into() {
    let quiet = quiet(1000, 20, &[&[(0, 300), (350, 500)]]);
    let before = |at: u64| quiet.before(Nanos(at), WAKE_UP, STAY).map(|at| at.0);
    assert_eq!(before(600_000), Some(600_000));
    assert_eq!(before(964_999), Some(964_999), "over when the next quiet time begins");
    assert_eq!(before(965_000), Some(964_999));
    assert_eq!(before(1_200_000), Some(964_999));
    // Between the windows is room for one: the first quiet time ends at 305, the second begins at 320.
    assert_eq!(before(1_310_000), Some(1_310_000));
    assert_eq!(before(1_400_000), Some(1_314_999));
    assert_eq!(before(200_000), None, "there is nothing before the epoch");
    let full = super::tests::quiet(1000, 0, &[&[(0, 500), (500, 1000)]]);
    assert_eq!(full.before(us(100_000), WAKE_UP, STAY), None);
}

proptest! {
    #[test]
    fn what_is_found_before_an_instant_is_the_last_that_disturbs_none(
        starts in proptest::collection::btree_set(0u64..19, 1..5),
        at in 60_000u64..400_000,
        room in 5u64..200,
    ) {
        let windows: Vec<_> = starts.iter().map(|start| (start * 50, start * 50 + 40)).collect();
        let quiet = quiet(1000, 5, &[&windows]);
        let room = us(room);
        let free = |at: u64| {
            (0..=room.0).step_by(1000).all(|after| {
                quiet.next(Nanos(at + after), STAY) == Some(Nanos(at + after))
            })
        };
        let at = at * 10;
        if let Some(Nanos(found)) = quiet.before(Nanos(at), room, STAY) {
            prop_assert!(found <= at && free(found), "{found} for {at}");
            let later = (found + 1..=at).step_by(997);
            for later in later.chain([at].into_iter().filter(|at| *at > found)) {
                prop_assert!(!free(later), "{later} is later than {found}");
            }
        }
    }
}

#[test]
fn a_frame_without_a_gap_moves_nothing() {
    let full = quiet(1000, 0, &[&[(0, 500), (500, 1000)]]);
    assert_eq!(full.defer(us(100), us(0), STAY), None);
    assert_eq!(full.next(us(100), STAY), None);
    assert_eq!(full.roomy(us(100), us(10), STAY), None);
    // Until a switch there is none, and from then on there is.
    let some = quiet(1000, 0, &[&[(0, 1000)], &[(0, 500)]]);
    assert_eq!(some.defer(us(1_600), us(0), switch(3)), Some(us(3_505)));
    assert_eq!(some.defer(us(1_600), us(0), switch(1_000)), None);
}

#[test]
fn a_switch_is_known_from_its_frame_on() {
    let quiet = quiet(1000, 20, &[&[(0, 300)], &[(500, 800)]]);
    let defer = |deadline| quiet.defer(us(deadline), us(400), switch(2));
    assert_eq!((defer(1_100), defer(1_600)), (Some(us(1_305)), None));
    assert_eq!((defer(2_100), defer(2_600)), (None, Some(us(2_805))));
}

#[test]
fn a_timer_of_our_own_keeps_its_distance() {
    let quiet = quiet(1000, 20, &[&[(0, 300), (380, 700)]]);
    let roomy = |at| quiet.roomy(us(at), us(50), STAY);
    assert_eq!(roomy(100), Some(Nanos(327_500)), "in the middle of 305 to 350");
    assert_eq!(roomy(710), Some(us(760)));
    assert_eq!(roomy(900), Some(Nanos(1_327_500)), "too near to the next window");
    assert_eq!(roomy(965), Some(Nanos(1_327_500)));
}

#[test]
fn the_tick_goes_where_it_is_farthest_from_all_windows() {
    let ms4 = Nanos::from_millis(4);
    let all = [quiet(1000, 20, &[&[(0, 300)]])];
    let phase = tick_phase(&all, ms4).unwrap();
    // Free from 305 to 970 us of each frame.
    assert_eq!((phase.offset, phase.margin), (Nanos(637_500), Nanos(332_500)));
    assert_eq!((phase.step, phase.clear), (us(1000), Clear::Windows));
    // A tick that comes ten times in a frame meets a window of it, but needs to meet no release.
    let all = [quiet(40_000, 20, &[&[(0, 10_000)]])];
    let phase = tick_phase(&all, ms4).unwrap();
    assert_eq!((phase.clear, phase.step), (Clear::Releases, ms4));
    assert_eq!(phase.offset, Nanos(1_985_000));
    // With 300 ticks in a second their places in a frame have no end.
    assert_eq!(tick_phase(&[quiet(1000, 20, &[&[(0, 300)]])], Nanos(3_333_333)), None);
    assert_eq!(tick_phase(&[], ms4), None);
}

#[test]
fn all_cpus_and_schedules_count_for_the_tick() {
    let all = [quiet(1000, 20, &[&[(0, 300)], &[(700, 900)]]), quiet(1000, 20, &[&[(310, 500)]])];
    let phase = tick_phase(&all, Nanos::from_millis(1)).unwrap();
    assert_eq!((phase.offset, phase.margin), (Nanos(587_500), Nanos(82_500)));
}

/// Windows that leave room for a guard of 20 us, also at a switch, in steps of 5 us.
fn windows() -> impl Strategy<Value = Vec<(u64, u64)>> {
    prop::collection::vec((4u64..60, 2u64..60), 1..6).prop_map(|gaps| {
        let mut at = 0;
        let mut windows = Vec::new();
        for (gap, length) in gaps {
            let start = at + gap * 5;
            at = start + length * 5;
            if at <= 1000 {
                windows.push((start, at));
            }
        }
        windows
    })
}

/// Every window of the frames around `at`, with its lead and tail: `(from, start, end, to)`.
fn walk(schedules: [&[(u64, u64)]; 2], lead: u64, turn: u64, at: u64) -> Vec<[i64; 4]> {
    let frame = (at / 1_000_000) as i64;
    let frames = (frame - 2).max(0)..frame + 12;
    frames
        .flat_map(|frame| {
            let windows = schedules[usize::from(frame >= turn as i64)];
            let base = frame * 1_000_000;
            windows.iter().map(move |&(start, end)| {
                let (start, end) = (base + start as i64 * 1000, base + end as i64 * 1000);
                [start - lead as i64 * 1000, start, end, end + 5_000]
            })
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Never early, in no quiet time, and the first such instant.
    #[test]
    fn a_deferred_deadline_is_the_first_free_instant(
        before in windows(),
        after in windows(),
        guard in prop::sample::select(vec![0u64, 5, 10, 20]),
        turn in 0u64..8,
        deadline in 0u64..10_000_000,
        ahead in 0u64..3_000_000,
    ) {
        prop_assume!(!before.is_empty() && !after.is_empty());
        let quiet = quiet(1000, guard, &[&before, &after]);
        let now = deadline.saturating_sub(ahead);
        let all = walk([&before, &after], guard + 10, turn, now);
        let now_signed = now as i64;
        let open = all.iter().position(|w| (w[1]..w[2]).contains(&now_signed));
        // Windows up to the open one are over.
        let left = &all[open.map_or(0, |open| open + 1)..];
        let free = |t: i64| left.iter().all(|w| !(w[0]..w[3]).contains(&t));
        let ends = left.iter().map(|w| w[3]);
        let mut candidates: Vec<i64> = ends.chain([deadline as i64]).collect();
        candidates.sort_unstable();
        let first = candidates.into_iter().find(|&t| t >= deadline as i64 && free(t));
        let expected = first.filter(|&t| t > deadline as i64 && deadline > now);
        let found = quiet.defer(Nanos(deadline), Nanos(now), switch(turn));
        prop_assert_eq!(found.map(|t| t.0 as i64), expected);
    }

    /// A timer of our own lies in no quiet time and at most some gaps later.
    #[test]
    fn a_roomy_instant_is_free(
        before in windows(),
        after in windows(),
        turn in 0u64..8,
        at in 0u64..10_000_000,
    ) {
        prop_assume!(!before.is_empty() && !after.is_empty());
        let quiet = quiet(1000, 20, &[&before, &after]);
        let found = quiet.roomy(Nanos(at), us(50), switch(turn)).unwrap().0;
        prop_assert!((at..at + 3_000_000).contains(&found));
        let all = walk([&before, &after], 30, turn, at);
        prop_assert!(all.iter().all(|w| !(w[0]..w[3]).contains(&(found as i64))));
    }

    /// Ticks at the place that is found, and anywhere within the margin, fall into no window.
    #[test]
    fn a_tick_at_its_place_meets_no_window(
        before in windows(),
        after in windows(),
        period in prop::sample::select(vec![1_000u64, 4_000, 10_000, 500]),
        creep in 0u64..=100,
        later in any::<bool>(),
    ) {
        prop_assume!(!before.is_empty() && !after.is_empty());
        let quiet = quiet(1000, 20, &[&before, &after]);
        let Some(phase) = tick_phase(&[quiet], us(period)) else { return Ok(()) };
        let creep = (phase.margin.0 * creep / 101) as i64;
        let at = phase.offset.0 as i64 + if later { creep } else { -creep };
        for tick in 0..40 {
            let at = at + tick * period as i64 * 1000 + 20_000_000;
            for turn in [0, 1_000] {
                let all = walk([&before, &after], 30, turn, at as u64);
                let meets = |w: &[i64; 4]| match phase.clear {
                    Clear::Windows => (w[0]..w[3]).contains(&at),
                    Clear::Releases => (w[0]..w[1]).contains(&at),
                };
                prop_assert!(!all.iter().any(meets), "{phase:?} {at}");
            }
        }
    }
}
