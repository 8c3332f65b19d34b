//! The supply of hand-drawn frames. The search against a brute force is in `tests/analysis`.

use super::*;
use crate::table::{Cpu, Placement, Role, Window};

fn us(n: u64) -> Nanos {
    Nanos::from_micros(n)
}

/// Windows `start..end` in a frame of 1 ms, of one partition with a background beside it.
fn table(windows: &[(u64, u64)]) -> Table {
    let placements = [
        Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::ZERO } },
        Placement { cpu: Cpu(0), role: Role::Background },
    ];
    let window = |&(start, end)| Window {
        partition: PartitionId(0),
        offset: us(start),
        duration: us(end - start),
        period: us(1000),
    };
    let windows: Vec<Window> = windows.iter().map(window).collect();
    Table::new(us(1000), &placements, &windows).unwrap()
}

fn supply(windows: &[(u64, u64)], overhead: u64) -> Supply {
    Supply::of(&table(windows), PartitionId(0), us(overhead), us(0)).unwrap()
}

#[test]
fn time_counts_only_inside_windows() {
    let s = supply(&[(100, 300), (600, 700)], 0);
    let available = |from, to| s.available(us(from), us(to));
    assert_eq!(available(0, 100), us(0));
    assert_eq!(available(0, 200), us(100));
    assert_eq!(available(250, 650), us(100));
    assert_eq!(available(0, 1000), us(300));
    assert_eq!(available(650, 3150), us(50 + 300 + 300 + 50));
    assert_eq!(available(650, 200), us(0));
}

#[test]
fn demand_is_complete_with_its_last_nanosecond() {
    let s = supply(&[(100, 300), (600, 700)], 0);
    let finish = |from, demand| s.finish(us(from), demand).unwrap();
    assert_eq!(finish(0, us(200)), us(300));
    assert_eq!(finish(0, Nanos(200_001)), Nanos(600_001));
    assert_eq!(finish(250, us(150)), us(700));
    assert_eq!(finish(250, us(450)), us(1700));
    assert_eq!(finish(850, us(0)), us(850));
}

#[test]
fn the_worst_interval_starts_where_a_window_ends() {
    let s = supply(&[(100, 300), (600, 700)], 0);
    for (length, least) in [(0, 0), (400, 0), (401, 1), (500, 100), (800, 100), (1000, 300)] {
        assert_eq!(s.minimum(Start::Anywhere, us(length)), us(least), "{length}");
        assert_eq!(s.minimum(Start::Anywhere, us(5000 + length)), us(1500 + least), "{length}");
    }
    assert_eq!(s.longest(Start::Anywhere, us(100)), Some(us(500)));
    assert_eq!(s.longest(Start::Anywhere, us(101)), Some(us(801)));
    assert_eq!(s.longest(Start::Anywhere, us(300)), Some(us(1000)));
}

#[test]
fn each_window_pays_the_overhead_at_its_start() {
    let s = supply(&[(100, 300), (600, 700)], 30);
    assert_eq!(s.available(us(0), us(1000)), us(170 + 70));
    assert_eq!(s.finish(us(0), us(1)), Some(us(131)));
    // Windows that touch are entered twice.
    assert_eq!(supply(&[(0, 500), (500, 1000)], 30).minimum(Start::Anywhere, us(1000)), us(940));
}

#[test]
fn a_window_within_the_overhead_gives_nothing() {
    let s = supply(&[(100, 300), (600, 700)], 100);
    let without = supply(&[(100, 300)], 100);
    assert_eq!(s.slots, without.slots);
    // What begins with it has to wait for the next one.
    assert_eq!(s.longest(Start::Window, us(1)), Some(us(601)));
    assert_eq!(without.longest(Start::Window, us(1)), Some(us(101)));
    let (partition, overhead) = (PartitionId(0), us(200));
    assert_eq!(
        Supply::of(&table(&[(100, 300), (600, 700)]), partition, overhead, us(0)),
        Err(SupplyError::NothingLeft { partition, overhead })
    );
}

#[test]
fn interrupts_come_where_they_hurt() {
    let s = Supply::of(&table(&[(0, 300)]), PartitionId(0), us(0), us(18)).unwrap();
    assert_eq!(s.longest(Start::Window, us(150)), Some(us(168)));
    // At 300 it is too late for this window: 700, and then as above.
    assert_eq!(s.longest(Start::Outside, us(150)), Some(us(868)));
    // At 282 the interrupts of two windows are to come. So are they at 200: 82 in the first, 68 from 1018 on.
    assert_eq!(s.longest(Start::Anywhere, us(150)), Some(us(886)));
    assert_eq!(s.minimum(Start::Anywhere, us(886)), us(150));
    assert_eq!(s.minimum(Start::Outside, us(868)), us(150));
    assert_eq!(s.minimum(Start::Window, us(168)), us(150));
    assert_eq!(s.minimum(Start::Anywhere, us(17)), us(0));
    // Only what begins inside a window meets more than the function knows of.
    let held_up = |instant| s.held_up(us(instant));
    assert_eq!([0, 1000, 300, 700].map(held_up), [None; 4]);
    assert_eq!(held_up(1200), Some(us(1218)));
    assert_eq!(held_up(1290), Some(us(1300)));
    assert_eq!(supply(&[(0, 300)], 18).held_up(us(200)), None);
}

#[test]
fn a_background_and_a_stranger_have_no_windows() {
    for partition in [PartitionId(1), PartitionId(2)] {
        let refused = Supply::of(&table(&[(100, 300)]), partition, us(0), us(0));
        assert_eq!(refused, Err(SupplyError::NoWindows { partition }));
    }
}

#[test]
fn a_later_frame_is_as_exact_as_the_first() {
    let s = supply(&[(100, 300), (600, 700)], 0);
    // An hour of frames, and the one of the 1e9-th release.
    for frame in (0..3_600_000).step_by(997).chain([3_600_000, 500_000_000]) {
        let at = |offset| us(1000 * frame + offset);
        assert_eq!(s.finish(at(250), us(150)), Some(at(700)));
        assert_eq!(s.available(at(250), at(650)), us(100));
        assert_eq!(s.available(Nanos::ZERO, at(0)), us(300 * frame));
    }
}

#[test]
fn the_end_of_the_type_is_no_instant_of_a_completion() {
    let s = supply(&[(100, 300)], 0);
    let end = Nanos(u64::MAX);
    assert_eq!(s.finish(end, Nanos(1)), None);
    assert_eq!(s.finish(Nanos(1), end), None);
    assert_eq!(s.longest(Start::Anywhere, end), None);
    assert_eq!(s.available(Nanos::ZERO, end), s.minimum(Start::Anywhere, end).plus(us(200)));
}
