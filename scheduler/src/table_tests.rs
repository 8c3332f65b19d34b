//! Each rule of the table, one test each, and a brute-force check of the release arithmetic.

use proptest::prelude::*;

use super::*;

fn us(n: u64) -> Nanos {
    Nanos::from_micros(n)
}

fn plc(cpu: usize) -> Placement {
    Placement { cpu: Cpu(cpu), role: Role::Windowed { guard: us(20) } }
}

fn background(cpu: usize) -> Placement {
    Placement { cpu: Cpu(cpu), role: Role::Background }
}

fn window(partition: usize, offset: u64, duration: u64) -> Window {
    Window { partition: PartitionId(partition), offset: us(offset), duration: us(duration) }
}

#[test]
fn the_frame_has_bounds() {
    for frame in [us(0), us(99), Nanos::from_millis(60_001)] {
        let table = Table::new(frame, &[background(0)], &[]);
        assert_eq!(table, Err(TableError::Frame { frame }));
    }
}

#[test]
fn windows_may_touch_but_not_overlap() {
    let both = [plc(0), Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(0) } }];
    assert!(Table::new(us(1000), &both, &[window(0, 0, 300), window(1, 300, 300)]).is_ok());
    assert_eq!(
        Table::new(us(1000), &both, &[window(1, 299, 300), window(0, 0, 300)]),
        Err(TableError::Overlap { earlier: 1, later: 0, end: us(300), start: us(299) })
    );
}

#[test]
fn windows_on_different_cpus_do_not_meet() {
    let table = Table::new(us(1000), &[plc(0), plc(1)], &[window(0, 0, 900), window(1, 0, 900)]);
    assert_eq!(table.unwrap().cpus(), [Cpu(0), Cpu(1)]);
}

#[test]
fn a_window_ends_with_the_frame_at_the_latest() {
    assert!(Table::new(us(1000), &[plc(0)], &[window(0, 700, 300)]).is_ok());
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[window(0, 701, 300)]),
        Err(TableError::PastFrame { window: 0, end: us(1001), frame: us(1000) })
    );
}

#[test]
fn a_window_near_the_end_of_the_type_does_not_wrap() {
    let w = Window { partition: PartitionId(0), offset: Nanos(u64::MAX), duration: us(20) };
    assert!(matches!(Table::new(us(1000), &[plc(0)], &[w]), Err(TableError::PastFrame { .. })));
}

#[test]
fn a_guard_needs_room_also_across_the_frames_edge() {
    // The first window's guard lies at the end of the frame before.
    assert!(Table::new(us(1000), &[plc(0)], &[window(0, 0, 980)]).is_ok());
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[window(0, 0, 981)]),
        Err(TableError::NoRoomForGuard { window: 0, before: 0, guard: us(20), gap: us(19) })
    );
    assert_eq!(
        Table::new(us(1000), &[plc(0), plc(0)], &[window(0, 100, 100), window(1, 219, 100)]),
        Err(TableError::NoRoomForGuard { window: 1, before: 0, guard: us(20), gap: us(19) })
    );
}

#[test]
fn one_background_per_cpu() {
    assert!(Table::new(us(1000), &[background(0), background(1)], &[]).is_ok());
    let (first, second) = (PartitionId(0), PartitionId(1));
    assert_eq!(
        Table::new(us(1000), &[background(3), background(3)], &[]),
        Err(TableError::TwoBackgrounds { first, second, cpu: Cpu(3) })
    );
}

#[test]
fn a_background_has_no_window_and_everyone_else_has_one() {
    assert_eq!(
        Table::new(us(1000), &[background(0)], &[window(0, 0, 100)]),
        Err(TableError::BackgroundWindow { window: 0 })
    );
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[]),
        Err(TableError::NeverRuns { partition: PartitionId(0) })
    );
}

#[test]
fn a_window_needs_an_owner_and_a_length() {
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[window(1, 0, 100)]),
        Err(TableError::NoSuchPartition { window: 0 })
    );
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[window(0, 0, 9)]),
        Err(TableError::TooShort { window: 0, duration: us(9) })
    );
}

#[test]
fn shares_add_up_to_the_frame() {
    let table =
        Table::new(us(1000), &[plc(0), background(0)], &[window(0, 0, 200), window(0, 500, 100)])
            .unwrap();
    assert_eq!(table.guaranteed(PartitionId(0)), us(300));
    assert_eq!(table.guaranteed(PartitionId(1)), us(1000 - 300 - 2 * 20));
    assert_eq!(table.background_of(Cpu(0)), Some(PartitionId(1)));
    assert_eq!(table.releases_of(PartitionId(1)), None);
    let releases = table.releases_of(PartitionId(0)).unwrap();
    assert_eq!(releases.longest(), us(200));
    assert_eq!(releases.shortest_period(), us(500));
}

#[test]
fn releases_repeat_without_drift() {
    let table =
        Table::new(us(1000), &[plc(0)], &[window(0, 50, 200), window(0, 500, 100)]).unwrap();
    let releases = table.releases_of(PartitionId(0)).unwrap();
    // An hour of frames.
    for frame in (0..3_600_000).step_by(7) {
        let r = releases.nth(2 * frame + 1);
        assert_eq!((r.frame, r.start), (frame, us(1000 * frame + 500)));
        assert_eq!(r.end, us(1000 * frame + 600));
    }
}

proptest! {
    /// The closed form agrees with walking through all releases one by one.
    #[test]
    fn first_ending_after_is_what_a_walk_finds(
        cuts in prop::collection::btree_set(0u64..100, 2..12),
        now in 0u64..350_000,
    ) {
        let cuts: Vec<u64> = cuts.into_iter().map(|c| c * 10).collect();
        let windows: Vec<Window> =
            cuts.chunks_exact(2).map(|c| window(0, c[0], c[1] - c[0])).collect();
        let unguarded = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::ZERO } };
        let table = Table::new(us(1000), &[unguarded], &windows).unwrap();
        let releases = table.releases_of(PartitionId(0)).unwrap();
        let now = Nanos(now * 10);
        let walked = (0..).map(|n| releases.nth(n)).find(|r| r.end > now).unwrap();
        prop_assert_eq!(releases.first_ending_after(now), walked);
    }
}
