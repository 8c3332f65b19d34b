//! The timetable against a walk through every frame, and what it says of distances.

use proptest::prelude::*;

use super::*;

const FRAME: Nanos = Nanos::from_micros(1000);

fn us(n: u64) -> Nanos {
    Nanos::from_micros(n)
}

fn timetable(schedules: &[&[(u64, u64)]]) -> Timetable {
    let spans = |windows: &&[(u64, u64)]| windows.iter().map(|&(s, e)| (us(s), us(e))).collect();
    Timetable::new(FRAME, schedules.iter().map(spans).collect())
}

fn switch(frame: u64) -> Switch {
    Switch { before: ScheduleId(0), after: ScheduleId(1), frame }
}

/// No switch at all.
const STAY: Switch = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };

fn release(slot: Slot) -> Release {
    match slot {
        Slot::Window(release) => release,
        Slot::Idle(idle) => panic!("{idle:?}"),
    }
}

/// All slots from the epoch on, one by one.
fn walk(timetable: &Timetable, switch: Switch) -> impl Iterator<Item = Slot> {
    std::iter::successors(Some(timetable.first(switch)), move |slot| {
        Some(timetable.after(slot, switch))
    })
}

#[test]
fn an_hour_of_frames_does_not_drift() {
    let timetable = timetable(&[&[(50, 250), (500, 600)]]);
    let mut slot = timetable.first(STAY);
    for frame in 0..3_600_000 {
        let first = release(slot);
        assert_eq!(
            (first.sequence, first.frame, first.start),
            (2 * frame, frame, us(1000 * frame + 50))
        );
        let second = timetable.after(&slot, STAY);
        assert_eq!(release(second).end, us(1000 * frame + 600));
        slot = timetable.after(&second, STAY);
    }
}

#[test]
fn a_switch_changes_the_windows_at_its_frame_and_keeps_the_count() {
    let timetable = timetable(&[&[(0, 100), (500, 600)], &[(200, 300)]]);
    let starts: Vec<_> = walk(&timetable, switch(2))
        .take(6)
        .map(release)
        .map(|r| (r.sequence, r.schedule.0, r.start.0 / 1000))
        .collect();
    let expected = [(0, 0, 0), (1, 0, 500), (2, 0, 1000), (3, 0, 1500), (4, 1, 2200), (5, 1, 3200)];
    assert_eq!(starts, expected);
}

#[test]
fn a_schedule_without_a_window_is_waited_out_frame_by_frame() {
    let timetable = timetable(&[&[], &[(200, 300)]]);
    let mut slots = walk(&timetable, switch(2));
    for frame in 0..2 {
        let idle = Idle { sequence: 0, frame, start: us(1000 * frame) };
        assert_eq!(slots.next(), Some(Slot::Idle(idle)));
    }
    let first = release(slots.next().unwrap());
    assert_eq!((first.sequence, first.start), (0, us(2200)));
}

#[test]
fn distances_count_across_frames_and_switches() {
    let one = timetable(&[&[(0, 100), (400, 600)]]);
    assert_eq!(
        (one.longest(), one.shortest_period(), one.shortest_between_ends()),
        (us(200), us(400), us(500))
    );
    // From 900 us under the first to 50 us under the second.
    let two = timetable(&[&[(900, 950)], &[(50, 200)], &[]]);
    assert_eq!(
        (two.longest(), two.shortest_period(), two.shortest_between_ends()),
        (us(150), us(150), us(250))
    );
}

#[test]
fn an_instant_without_end_does_not_wrap() {
    let timetable = timetable(&[&[(0, 100)]]);
    let far = timetable.catch_up(&timetable.first(STAY), Nanos(u64::MAX), STAY);
    assert!(release(far).frame > 1 << 40);
}

fn windows() -> impl Strategy<Value = Vec<(u64, u64)>> {
    prop::collection::btree_set(0u64..=100, 0..10).prop_map(|cuts| {
        let cuts: Vec<u64> = cuts.into_iter().map(|c| c * 10).collect();
        cuts.chunks_exact(2).map(|c| (c[0], c[1])).collect()
    })
}

proptest! {
    /// The closed form agrees with walking through all slots one by one.
    #[test]
    fn catching_up_is_what_a_walk_finds(
        before in windows(),
        after in windows(),
        turn in 0u64..8,
        from in 0usize..12,
        now in 0u64..1000,
    ) {
        prop_assume!(!before.is_empty() || !after.is_empty());
        let timetable = timetable(&[&before, &after]);
        let switch = switch(turn);
        let slots: Vec<Slot> = walk(&timetable, switch).take(200).collect();
        let now = Nanos(now * 10_000);
        let open = |slot: &&Slot| match slot {
            Slot::Window(release) => release.end > now,
            // An idle frame is left when the next one begins.
            Slot::Idle(idle) => idle.start.plus(FRAME) > now,
        };
        let walked = slots[from + 1..].iter().find(open).unwrap();
        prop_assert_eq!(timetable.catch_up(&slots[from], now, switch), *walked);
    }
}
