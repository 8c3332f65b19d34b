//! The table that is right, and each way of being wrong.

use proptest::prelude::*;
use takt_channel::Store;

use super::*;

const READABLE: u64 = 16 * memory::PAGE;
const WRITABLE: u64 = 4 * memory::PAGE;

/// A page as the host writes it.
#[derive(Clone)]
struct Page(Vec<u64>);

impl Load for Page {
    fn words(&self) -> usize {
        self.0.len()
    }

    fn load(&self, word: usize) -> u64 {
        self.0[word]
    }
}

impl Store for Page {
    fn store(&mut self, word: usize, value: u64) {
        self.0[word] = value;
    }
}

impl Page {
    fn put(&mut self, offset: usize, value: u32) {
        let shift = offset % 8 * 8;
        let kept = self.0[offset / 8] & !(0xffff_ffff << shift);
        self.0[offset / 8] = kept | u64::from(value) << shift;
    }

    fn port(&mut self, index: usize, field: usize, value: u32) {
        self.put(offset_of!(PortTable, ports) + index * size_of::<Entry>() + field, value);
    }

    fn port_word(&mut self, index: usize, field: usize, value: u64) {
        let at = offset_of!(PortTable, ports) + index * size_of::<Entry>() + field;
        self.0[at / 8] = value;
    }

    /// A port; kind, direction, maximum, depth and policy are the five numbers, and the regions are
    /// an offset and a number of pages each.
    fn entry(
        &mut self,
        index: usize,
        name: &[u8],
        [kind, direction, maximum, depth, policy]: [u32; 5],
        own: (u64, u32),
        peer: (u64, u32),
    ) {
        self.name(index, name);
        self.port(index, offset_of!(Entry, kind), kind);
        self.port(index, offset_of!(Entry, direction), direction);
        self.port(index, offset_of!(Entry, maximum), maximum);
        self.port(index, offset_of!(Entry, depth), depth);
        self.port(index, offset_of!(Entry, policy), policy);
        self.port_word(index, offset_of!(Entry, own), own.0);
        self.port(index, offset_of!(Entry, own_pages), own.1);
        self.port_word(index, offset_of!(Entry, peer), peer.0);
        self.port(index, offset_of!(Entry, peer_pages), peer.1);
    }

    fn name(&mut self, index: usize, name: &[u8]) {
        for (word, bytes) in name.chunks(8).enumerate() {
            let mut value = [0; 8];
            value[..bytes.len()].copy_from_slice(bytes);
            self.port_word(index, word * 8, u64::from_le_bytes(value));
        }
    }
}

/// A sampling destination `in`, a queuing source `send`, and a sampling source `out`.
fn good() -> Page {
    let mut page = Page(vec![0; 512]);
    page.put(offset_of!(PortTable, magic), takt_abi::MAGIC);
    page.put(offset_of!(PortTable, version), takt_abi::VERSION);
    page.put(offset_of!(PortTable, count), 3);
    page.0[offset_of!(PortTable, tsc_khz) / 8] = 1_000_000;
    page.entry(0, b"in", [1, 2, 512, 1, 0], (0, 0), (4096, 1));
    page.port_word(0, offset_of!(Entry, refresh_ns), 2_000_000);
    // 4 + 3 slots of 576 bytes do not fit in one page with their header: 4160 bytes.
    page.entry(1, b"send", [2, 1, 512, 4, 1], (0, 2), (8192, 1));
    page.entry(2, b"out", [1, 1, 512, 1, 0], (8192, 1), (0, 0));
    page
}

fn read(page: &Page) -> Result<Table, TableError> {
    Table::read(page, READABLE, WRITABLE)
}

fn defect(page: &Page) -> (u32, Defect) {
    match read(page).unwrap_err() {
        TableError::Port { index, defect } => (index, defect),
        other => panic!("{other}"),
    }
}

#[test]
fn a_good_table_gives_its_ports() {
    let table = read(&good()).unwrap();
    assert_eq!(table.clock, Clock::new(1_000_000));
    let [input, sender, output] = &table.ports[..] else { panic!("{table:?}") };
    assert_eq!((input.name.as_str(), input.direction), ("in", Direction::Destination));
    assert_eq!(input.kind, Kind::Sampling { refresh: Duration::from_millis(2) });
    assert_eq!((input.own, input.peer), (None, Some(Region { offset: 4096, bytes: 4096 })));
    assert_eq!(sender.kind, Kind::Queuing { depth: 4, policy: Policy::Refuse });
    assert_eq!(sender.own, Some(Region { offset: 0, bytes: 8192 }), "offset 0 is a place");
    assert_eq!(sender.peer, Some(Region { offset: 8192, bytes: 4096 }));
    assert_eq!((output.index, output.maximum, output.doorbell), (2, 512, false));
    assert_eq!(output.own, Some(Region { offset: 8192, bytes: 4096 }));
}

#[test]
fn a_table_of_something_else_is_refused() {
    assert_eq!(Table::read(&good(), 4095, 0), Err(TableError::TooSmall(4095)));
    let changed = |offset, value| {
        let mut page = good();
        page.put(offset, value);
        read(&page).unwrap_err()
    };
    assert_eq!(changed(offset_of!(PortTable, magic), 7), TableError::Magic(7));
    assert_eq!(changed(offset_of!(PortTable, version), 3), TableError::Version(3));
    assert_eq!(changed(offset_of!(PortTable, count), 43), TableError::Count(43));
    assert_eq!(changed(offset_of!(PortTable, count), u32::MAX), TableError::Count(u32::MAX));
    assert_eq!(changed(offset_of!(PortTable, tsc_khz), 0), TableError::Frequency);
}

#[test]
fn each_wrong_number_of_a_port_is_named() {
    for (index, field, value, expected) in [
        (0, offset_of!(Entry, kind), 0, Defect::Kind(0)),
        (0, offset_of!(Entry, kind), 3, Defect::Kind(3)),
        (1, offset_of!(Entry, direction), 0, Defect::Direction(0)),
        (0, offset_of!(Entry, policy), 1, Defect::Policy(1)),
        (1, offset_of!(Entry, policy), 0, Defect::Policy(0)),
        (1, offset_of!(Entry, policy), 3, Defect::Policy(3)),
        (0, offset_of!(Entry, maximum), 0, GeometryError::Maximum(0).into()),
        (1, offset_of!(Entry, maximum), 65537, GeometryError::Maximum(65537).into()),
        (1, offset_of!(Entry, depth), 0, GeometryError::Depth(0).into()),
        (1, offset_of!(Entry, depth), 1025, GeometryError::Depth(1025).into()),
        (0, offset_of!(Entry, refresh_ns), 0, Defect::Refresh),
        (2, offset_of!(Entry, doorbell), 2, Defect::Doorbell(2)),
        (0, offset_of!(Entry, own_pages), 1, Defect::Superfluous { which: "read-write" }),
        (2, offset_of!(Entry, peer_pages), 1, Defect::Superfluous { which: "read-only" }),
        (
            1,
            offset_of!(Entry, own_pages),
            1,
            Defect::TooSmall { which: "read-write", found: 4096, needed: 4160 },
        ),
        (
            1,
            offset_of!(Entry, peer_pages),
            0,
            Defect::TooSmall { which: "read-only", found: 0, needed: 128 },
        ),
    ] {
        let mut page = good();
        page.port(index, field, value);
        assert_eq!(defect(&page), (index as u32, expected), "{field} {value}");
    }
}

#[test]
fn a_region_must_be_on_pages_of_the_memory_and_not_on_the_table() {
    for (index, field, offset) in [
        (0, offset_of!(Entry, peer), 0),
        (0, offset_of!(Entry, peer), 4097),
        (0, offset_of!(Entry, peer), READABLE),
        (0, offset_of!(Entry, peer), !4095),
        (1, offset_of!(Entry, own), WRITABLE - 4096),
        (1, offset_of!(Entry, own), 8),
        (1, offset_of!(Entry, own), 1 << 63),
    ] {
        let mut page = good();
        page.port_word(index, field, offset);
        let (found, defect) = defect(&page);
        assert!(matches!(defect, Defect::Place { offset: o, .. } if o == offset), "{defect}");
        assert_eq!(found, index as u32);
    }
    let mut page = good();
    page.port(0, offset_of!(Entry, peer_pages), u32::MAX);
    assert!(matches!(defect(&page), (0, Defect::Place { .. })));
}

#[test]
fn a_name_is_one_printable_word_and_the_only_one() {
    for name in [&b"\0"[..], b"a b", b"\xff", b"a\0b", b"n\n"] {
        let mut page = good();
        page.name(0, name);
        assert_eq!(defect(&page), (0, Defect::Name), "{name:?}");
    }
    let mut page = good();
    page.name(2, b"send");
    assert_eq!(defect(&page), (2, Defect::Duplicate("send".to_owned())));
    page.name(2, &[b'x'; 32]);
    assert_eq!(read(&page).unwrap().ports[2].name, "x".repeat(32));
}

proptest! {
    #[test]
    fn no_table_makes_a_port_outside_the_memory(
        changes in prop::collection::vec((0..507_usize, prop_oneof![any::<u64>(), 0..10_u64]), 0..40),
        count in 0..43_u32,
    ) {
        let mut page = good();
        for (word, value) in changes {
            page.0[word] = value;
        }
        page.put(offset_of!(PortTable, magic), takt_abi::MAGIC);
        page.put(offset_of!(PortTable, version), takt_abi::VERSION);
        page.put(offset_of!(PortTable, count), count);
        if let Ok(table) = read(&page) {
            for port in table.ports {
                let within = |region: Option<Region>, end| {
                    region.is_none_or(|r| r.offset.checked_add(r.bytes).unwrap() <= end)
                };
                prop_assert!(within(port.own, WRITABLE) && within(port.peer, READABLE));
            }
        }
    }
}
