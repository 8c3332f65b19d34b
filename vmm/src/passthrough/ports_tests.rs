//! A guest's accesses to I/O ports, within its ranges and beyond.

use super::*;

const WIDTHS: [Width; 3] = [Width::One, Width::Two, Width::Four];

/// Notes each access; reads count upwards.
#[derive(Debug, Default)]
struct Fake {
    seen: Vec<(Direction, u16, Width, u32)>,
    next: u32,
}

impl Ports for Fake {
    fn read(&mut self, port: u16, width: Width) -> u32 {
        self.next += 0x0101_0101;
        self.seen.push((Direction::In, port, width, 0));
        self.next
    }

    fn write(&mut self, port: u16, width: Width, value: u32) {
        self.seen.push((Direction::Out, port, width, value));
    }
}

const PARALLEL: PortRange = PortRange { first: 0x378, last: 0x37b, host: 0x378 };
const MOVED: PortRange = PortRange { first: 0x2000, last: 0x2007, host: 0xc080 };
const LAST: PortRange = PortRange { first: 0xfffe, last: 0xffff, host: 0xfffe };

fn map() -> PortMap<Fake> {
    PortMap::new(&[PARALLEL, MOVED, LAST], Fake::default())
}

fn access(port: u16, width: Width, direction: Direction, data: &mut [u8]) -> PortAccess<'_> {
    PortAccess { port, width, direction, data }
}

#[test]
fn an_access_keeps_its_width_and_value() {
    let mut map = map();
    let mut data = [0x11, 0x22, 0x33, 0x44];
    for width in WIDTHS {
        let data = &mut data[..width.bytes()];
        assert!(map.perform(&mut access(0x378, width, Direction::Out, data)));
    }
    let out = |width, value| (Direction::Out, 0x378, width, value);
    let expected = [out(Width::One, 0x11), out(Width::Two, 0x2211), out(Width::Four, 0x4433_2211)];
    assert_eq!(map.ports.seen, expected);

    let mut data = [0; 4];
    assert!(map.perform(&mut access(0x37a, Width::Two, Direction::In, &mut data[..2])));
    assert_eq!(data, [1, 1, 0, 0]);
}

#[test]
fn a_string_is_as_many_accesses_to_one_port() {
    let mut map = map();
    let mut data = [1, 2, 3, 4, 5, 6];
    assert!(map.perform(&mut access(0x379, Width::Two, Direction::Out, &mut data)));
    let out = |value| (Direction::Out, 0x379, Width::Two, value);
    assert_eq!(map.ports.seen, [out(0x0201), out(0x0403), out(0x0605)]);
    map.ports.seen.clear();
    assert!(map.perform(&mut access(0x379, Width::One, Direction::In, &mut data)));
    assert_eq!(data, [1, 2, 3, 4, 5, 6]);
    assert_eq!(map.ports.seen, [(Direction::In, 0x379, Width::One, 0); 6]);
}

#[test]
fn a_range_may_lie_elsewhere_on_the_host() {
    let mut map = map();
    assert!(map.perform(&mut access(0x2004, Width::Four, Direction::Out, &mut [7, 0, 0, 0])));
    assert_eq!(map.ports.seen, [(Direction::Out, 0xc084, Width::Four, 7)]);
    assert_eq!(MOVED.host_last(), 0xc087);
}

#[test]
fn whatever_a_guest_tries_stays_inside_its_ranges() {
    let inside = |port: u16, width: Width| {
        let last = u32::from(port) + width.bytes() as u32 - 1;
        [PARALLEL, MOVED, LAST]
            .iter()
            .any(|r| u32::from(r.first) <= port.into() && last <= r.last.into())
    };
    let mut map = map();
    for direction in [Direction::In, Direction::Out] {
        for width in WIDTHS {
            for port in 0..=u16::MAX {
                let mut data = [0; 4];
                let data = &mut data[..width.bytes()];
                let done = map.perform(&mut access(port, width, direction, data));
                assert_eq!(done, inside(port, width), "{port:#x} {width:?}");
                if !done && direction == Direction::In {
                    assert!(data.iter().all(|byte| *byte == 0xff));
                }
            }
        }
    }
    // 4, 3 and 1 places in the first range, 8, 7 and 5 in the second, 2, 1 and 0 in the last.
    assert_eq!(map.ports.seen.len(), 2 * (8 + 15 + 8));
    let host = [0x378..=0x37b, 0xc080..=0xc087, 0xfffe..=0xffff];
    for (_, port, width, _) in &map.ports.seen {
        let last = port.checked_add(width.bytes() as u16 - 1).unwrap();
        assert!(host.iter().any(|r| r.contains(port) && r.contains(&last)), "{port:#x}");
    }
}

#[test]
fn bytes_that_are_no_whole_accesses_are_refused() {
    let mut map = map();
    let mut data = [0; 3];
    assert!(!map.perform(&mut access(0x378, Width::Two, Direction::In, &mut data)));
    assert_eq!(data, [0xff; 3]);
    assert!(map.ports.seen.is_empty());
    assert!(map.perform(&mut access(0x378, Width::Two, Direction::In, &mut [])));
    assert!(map.ports.seen.is_empty());
}

#[test]
fn a_port_is_the_partitions_up_to_both_ends_of_a_range() {
    let map = map();
    for port in [0x378, 0x37b, 0x2000, 0x2007, 0xfffe, 0xffff] {
        assert!(map.has(port), "{port:#x}");
    }
    for port in [0, 0x377, 0x37c, 0x1fff, 0x2008, 0xc080, 0xfffd] {
        assert!(!map.has(port), "{port:#x}");
    }
}
