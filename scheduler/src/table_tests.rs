//! Each rule of the table, one test each.

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
    let partition = PartitionId(partition);
    Window { partition, offset: us(offset), duration: us(duration), period: us(1000) }
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
    let w = Window { offset: Nanos(u64::MAX), ..window(0, 0, 20) };
    assert!(matches!(Table::new(us(1000), &[plc(0)], &[w]), Err(TableError::PastFrame { .. })));
}

#[test]
fn a_guard_needs_room_also_across_the_frames_edge() {
    // The first window's guard lies at the end of the frame before.
    assert!(Table::new(us(1000), &[plc(0)], &[window(0, 0, 980)]).is_ok());
    assert_eq!(
        Table::new(us(1000), &[plc(0)], &[window(0, 0, 981)]),
        Err(TableError::NoRoomForGuard {
            window: 0,
            before: 0,
            guard: us(20),
            room: us(20),
            gap: us(19)
        })
    );
    // A window of another partition may have to be ended by a kick first.
    let behind = |offset| {
        Table::new(us(1000), &[plc(0), plc(0)], &[window(0, 100, 100), window(1, offset, 100)])
    };
    assert!(behind(250).is_ok());
    assert_eq!(
        behind(249),
        Err(TableError::NoRoomForGuard {
            window: 1,
            before: 0,
            guard: us(20),
            room: us(50),
            gap: us(49)
        })
    );
}

#[test]
fn several_backgrounds_have_together_what_windows_leave() {
    let placements = [background(0), background(1), background(0)];
    let table = Table::new(us(1000), &placements, &[]).unwrap();
    let of = |cpu| table.backgrounds_of(Cpu(cpu)).map(|id| id.0).collect::<Vec<_>>();
    assert_eq!((of(0), of(1), of(2)), (vec![0, 2], vec![1], vec![]));
    assert_eq!(table.guaranteed(PartitionId(0)), table.guaranteed(PartitionId(2)));
}

#[test]
fn a_background_partition_with_further_cpus_has_what_is_left_on_all() {
    let windows = [window(0, 0, 200)];
    let placements = [plc(0), background(0), background(2)];
    let table = Table::new(us(1000), &placements, &windows).unwrap();
    let left = table.guaranteed(PartitionId(1));
    let table = table.with_further(&[(PartitionId(1), Cpu(3)), (PartitionId(1), Cpu(2))]);
    assert_eq!(table.guaranteed(PartitionId(1)), left.plus(us(2000)));
    assert_eq!((table.left_on(Cpu(0)), table.left_on(Cpu(3))), (left, us(1000)));
    assert_eq!(table.cpus(), [0, 2, 3].map(Cpu));
    let processors = |id| table.processors_of(PartitionId(id)).collect::<Vec<_>>();
    assert_eq!((processors(0), processors(1)), (vec![Cpu(0)], [0, 3, 2].map(Cpu).to_vec()));
    let of = |cpu| table.backgrounds_of(Cpu(cpu)).map(|id| id.0).collect::<Vec<_>>();
    assert_eq!((of(0), of(2), of(3)), (vec![1], vec![1, 2], vec![1]));
}

#[test]
fn a_background_has_no_window() {
    assert_eq!(
        Table::new(us(1000), &[background(0)], &[window(0, 0, 100)]),
        Err(TableError::BackgroundWindow { window: 0 })
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
fn a_window_repeats_with_its_period() {
    let every = |period, offset, duration| {
        let w = Window { period: us(period), ..window(0, offset, duration) };
        Table::new(us(1000), &[plc(0)], &[w])
    };
    let table = every(250, 100, 50).unwrap();
    let starts: Vec<Nanos> = table.windows_of(PartitionId(0)).map(|w| w.offset).collect();
    assert_eq!(starts, [us(100), us(350), us(600), us(850)]);
    for period in [0, 300, 2000] {
        let error = TableError::Period { window: 0, period: us(period), frame: us(1000) };
        assert_eq!(every(period, 0, 50), Err(error));
    }
    let error = TableError::PastPeriod { window: 0, end: us(251), period: us(250) };
    assert_eq!(every(250, 100, 151), Err(error));
    let (guard, room, gap) = (us(20), us(20), us(19));
    let error = TableError::NoRoomForGuard { window: 0, before: 0, guard, room, gap };
    assert_eq!(every(250, 0, 231), Err(error));
}

#[test]
fn repetitions_have_a_bound() {
    let frame = Nanos::from_millis(60_000);
    let w = Window { partition: PartitionId(0), offset: us(0), duration: us(10), period: us(100) };
    assert_eq!(Table::new(frame, &[plc(0)], &[w]), Err(TableError::TooMany { window: 0 }));
}

#[test]
fn shares_add_up_to_the_frame() {
    let table =
        Table::new(us(1000), &[plc(0), background(0)], &[window(0, 0, 200), window(0, 500, 100)])
            .unwrap();
    assert_eq!(table.guaranteed(PartitionId(0)), us(300));
    let switching = 2 * (20 + WINDOW_COST.0 / 1000);
    assert_eq!(table.guaranteed(PartitionId(1)), us(1000 - 300 - switching));
    assert_eq!(table.backgrounds_of(Cpu(0)).collect::<Vec<_>>(), [PartitionId(1)]);
}
