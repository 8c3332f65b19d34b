//! Arrivals of a good host, of one that is disturbed, and of a hostile one.

use std::collections::VecDeque;

use super::*;

const MOST: Nanos = Nanos::from_micros(20);

fn guard() -> AutoGuard {
    AutoGuard::new(MOST)
}

fn repeat(guard: &mut AutoGuard, arrival: u64, times: u32) -> Vec<GuardChange> {
    (0..times).filter_map(|_| guard.arrived(Nanos(arrival))).collect()
}

#[test]
fn a_fixed_guard_stays_as_it_is() {
    let mut fixed = ReleaseGuard::Fixed(Nanos(5_000));
    assert_eq!(fixed.arrived(Nanos(1_000_000)), None);
    assert_eq!(fixed.length(), Nanos(5_000));
}

#[test]
fn it_begins_wide_and_narrows_by_halves_to_a_quarter_more_than_the_latest() {
    let mut guard = guard();
    assert_eq!(repeat(&mut guard, 4_800, SLOT - 1), []);
    assert_eq!(guard.length, MOST);
    let changes = repeat(&mut guard, 4_800, 1);
    let (from, to, latest) = (MOST, Nanos(14_500), Nanos(4_800));
    assert_eq!(changes, [GuardChange { from, to, why: Why::Narrowed, latest }]);
    let lengths: Vec<u64> =
        repeat(&mut guard, 4_800, 20 * SLOT).iter().map(|change| change.to.0).collect();
    assert_eq!(lengths, [11_750, 10_500, 9_750, 9_500, 9_250, 9_000]);
}

#[test]
fn one_arrival_without_its_margin_widens_at_once() {
    let mut guard = guard();
    repeat(&mut guard, 4_800, 20 * SLOT);
    assert_eq!(guard.length, Nanos(9_000));
    let change = guard.arrived(Nanos(5_600)).unwrap();
    assert_eq!((change.to, change.why), (Nanos(10_000), Why::Widened));
    // The way into the guest was longer than what was left.
    let change = guard.arrived(Nanos(7_001)).unwrap();
    assert_eq!((change.to, change.why, change.latest), (MOST, Why::TooShort, Nanos(7_001)));
}

#[test]
fn it_keeps_to_its_bounds() {
    let mut guard = guard();
    repeat(&mut guard, 0, 100 * SLOT);
    assert_eq!(guard.length, AUTO_LEAST);
    assert_eq!(guard.arrived(Nanos(u64::MAX)).map(|change| change.to), Some(MOST));
    assert_eq!(repeat(&mut guard, u64::MAX, 10 * SLOT), []);
    assert_eq!(guard.length, MOST);
    // A gap that leaves less than the least.
    let mut narrow = AutoGuard::new(Nanos(5_000));
    assert_eq!(repeat(&mut narrow, 0, 100 * SLOT), []);
    assert_eq!(narrow.length, Nanos(5_000));
}

#[test]
fn arrivals_that_never_leave_room_are_counted_without_end() {
    let mut guard = guard();
    guard.seen = u32::MAX;
    assert_eq!(guard.arrived(Nanos(1_000_000)), None);
    assert_eq!((guard.length, guard.seen), (MOST, u32::MAX));
}

#[test]
fn an_arrival_is_forgotten_after_eight_spans_and_after_a_mistake_later() {
    let spike = |guard: &mut AutoGuard| guard.arrived(Nanos(15_000));
    let mut guard = guard();
    spike(&mut guard);
    // The span in which it came is one of the eight.
    repeat(&mut guard, 1_000, SLOT * SLOTS as u32 - 1);
    assert_eq!(guard.length, MOST);
    repeat(&mut guard, 1_000, SLOT);
    assert!(guard.length < MOST);
    repeat(&mut guard, 1_000, SLOT * 20);
    // A mistake: the same spike is remembered twice as long.
    assert_eq!(spike(&mut guard).map(|change| change.why), Some(Why::TooShort));
    repeat(&mut guard, 1_000, 2 * SLOT * SLOTS as u32 - 1 - SLOT);
    assert_eq!(guard.length, MOST);
}

/// What the guard promises, in other words than the guard's own: from all arrivals.
struct Model {
    arrivals: VecDeque<u64>,
}

impl Model {
    /// The latest of those that it may not have forgotten yet.
    fn latest(&self, spans: usize) -> u64 {
        self.arrivals.iter().rev().take(spans * SLOT as usize).copied().max().unwrap_or(0)
    }
}

/// Plays `arrivals` and looks at each step for what must always hold; returns how often a release was
/// late that the bound would have kept.
fn play(arrivals: impl Iterator<Item = u64>) -> u32 {
    let mut guard = guard();
    let mut model = Model { arrivals: VecDeque::new() };
    let mut mistakes = 0;
    for (n, arrival) in arrivals.enumerate() {
        let before = guard.length;
        assert!((AUTO_LEAST..=MOST).contains(&before));
        // Never narrower than proven: a quarter more than the latest of at least seven spans.
        if n % 97 == 0 {
            let proven = model.latest(SLOTS - 1);
            assert!(
                before.0 >= Nanos(proven).plus(Nanos(proven / 4)).plus(ENTRY).min(MOST).0,
                "{n}: {before}"
            );
        }
        // Narrower than the bound only after a span.
        assert!(before == MOST || n >= SLOT as usize);
        let change = guard.arrived(Nanos(arrival));
        let needed = Nanos(arrival).plus(ENTRY);
        if needed > before {
            assert_eq!(guard.length, MOST);
            mistakes += u32::from(needed <= MOST);
        }
        // Whatever has just come would be in time the next time.
        assert!(guard.length >= needed.min(MOST));
        match change {
            None => assert_eq!(guard.length, before),
            Some(change) => {
                assert_eq!((change.from, change.to), (before, guard.length));
                assert_ne!(change.from, change.to);
                assert_eq!(change.why == Why::Narrowed, change.to < change.from);
                assert!(change.to.0 >= before.0 / 2, "by no more than a half");
            }
        }
        model.arrivals.push_back(arrival);
        if model.arrivals.len() > SLOTS * SLOT as usize {
            model.arrivals.pop_front();
        }
    }
    mistakes
}

/// A sequence without pattern, and the same each time.
fn noise(mut state: u64) -> impl Iterator<Item = u64> {
    std::iter::repeat_with(move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state >> 33
    })
}

#[test]
fn what_it_promises_holds_for_arrivals_of_every_kind() {
    let steady = noise(1).map(|n| 3_300 + n % 1_500);
    assert_eq!(play(steady.take(60_000)), 0);
    // A tail: one in some hundreds is later, as beside a Linux full of timers.
    let tail = noise(2).map(|n| if n % 401 == 0 { 4_800 + n % 2_000 } else { 3_300 + n % 1_500 });
    assert_eq!(play(tail.take(200_000)), 0);
    // Slower and slower, each a little later than all before.
    assert_eq!(play((0..100_000).map(|n| 1_000 + n / 8)), 0);
    for seed in 3..9 {
        play(noise(seed).map(|n| n % 30_000).take(20_000));
        play(noise(seed).map(|n| if n % 5_003 == 0 { u64::MAX } else { n % 5_000 }).take(60_000));
    }
}

#[test]
fn a_host_that_waits_for_the_guard_to_narrow_makes_ever_fewer_releases_late() {
    // Nothing until the guard has fallen below what the next spike needs, and then that spike.
    let mut guard = guard();
    let mut mistakes = Vec::new();
    for n in 0..2_000_000u32 {
        let lies_in_wait = guard.length >= Nanos(17_000);
        let arrival = if lies_in_wait { 1_000 } else { 16_000 };
        if guard.arrived(Nanos(arrival)).is_some_and(|change| change.why == Why::TooShort) {
            mistakes.push(n);
        }
    }
    // Each needs twice the patience of the one before.
    assert!((5..=9).contains(&mistakes.len()), "{mistakes:?}");
    let waits: Vec<u32> = mistakes.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(waits.windows(2).all(|pair| pair[1] > pair[0] * 3 / 2), "{waits:?}");
}
