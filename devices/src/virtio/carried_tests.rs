//! Carried devices as a driver sees them, and as a hostile guest does: registers written by hand, before a
//! carrier that only notes what it is given.

use proptest::prelude::*;

use super::*;
use crate::virtio::driver::{HIGH, RAM, memory, page};
use crate::virtio::page::RegisterPage;
use crate::virtio::registers::Registers;
use crate::{net, vsock};

/// The devices that are carried.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    Net,
    Vsock,
}

impl Kind {
    const ALL: [Kind; 2] = [Kind::Net, Kind::Vsock];

    fn device(self, memory: &GuestMemoryMmap, link: &Arc<Link>, page: &RegisterPage) -> Registers {
        let (memory, link) = (memory.clone(), link.clone());
        let device = match self {
            Kind::Net => net::device([2, 0, 0, 0, 0, 7], memory, link),
            Kind::Vsock => vsock::device(7, memory, link),
        };
        Registers::new(device, page.clone())
    }
}

/// All features that the carrier knows. Among them are some that are not offered for it: a log of changed pages (26) by
/// either device, and by that of sockets sequences of packets (1) and merged buffers (15).
pub const KNOWN: u64 = 1 << 32 | 1 << 29 | 1 << 28 | 1 << 27 | 1 << 26 | 1 << 15 | 1 << 1;
/// Three parts of each queue.
pub const QUEUE_PARTS: [[u64; 3]; 2] = [[0x1000, 0x2000, 0x3000], [0x5000, 0x6000, HIGH]];

#[derive(Debug, PartialEq, Eq)]
pub enum Call {
    Start(u64, [Ring; QUEUES]),
    Stop,
}

#[derive(Clone, Default)]
struct Notes {
    calls: Arc<Mutex<Vec<Call>>>,
    refuses: bool,
}

impl Carrier for Notes {
    fn features(&self) -> u64 {
        KNOWN
    }

    fn start(&mut self, agreed: u64, rings: [Ring; QUEUES]) -> io::Result<()> {
        self.calls.lock().unwrap().push(Call::Start(agreed, rings));
        if self.refuses { Err(io::ErrorKind::Other.into()) } else { Ok(()) }
    }

    fn stop(&mut self) {
        self.calls.lock().unwrap().push(Call::Stop);
    }
}

pub struct Guest {
    kind: Kind,
    memory: GuestMemoryMmap,
    pub link: Arc<Link>,
    pub registers: Registers,
    notes: Notes,
}

impl Guest {
    pub fn new(kind: Kind) -> Self {
        Self::with(kind, Notes::default())
    }

    fn with(kind: Kind, notes: Notes) -> Self {
        let memory = memory();
        let link = Arc::new(Link::new(notes.clone()));
        let registers = kind.device(&memory, &link, &page());
        Self { kind, memory, link, registers, notes }
    }

    pub fn read(&self, offset: u64) -> u32 {
        self.registers.read_word(offset)
    }

    pub fn write(&mut self, offset: u64, value: u32) {
        self.registers.write_word(offset, value);
    }

    /// A driver's steps up to its last.
    pub fn start(&mut self, features: u64, sizes: [u32; 2], parts: [[u64; 3]; 2]) {
        self.registers.accept(features);
        for (number, (size, parts)) in (0..).zip(sizes.into_iter().zip(parts)) {
            self.registers.set_up_queue(number, size, parts);
        }
        self.registers.set_running();
    }

    pub fn calls(&self) -> Vec<Call> {
        std::mem::take(&mut self.notes.calls.lock().unwrap())
    }

    /// Fails unless each part of these rings is in the guest's RAM.
    pub fn assert_inside(&self, rings: &[Ring]) {
        let regions = [0, HIGH].map(|start| start..start + RAM);
        for ring in rings {
            let entries = u64::from(ring.size);
            for (start, bytes) in [
                (ring.descriptors, 16 * entries),
                (ring.available, 6 + 2 * entries),
                (ring.used, 6 + 8 * entries),
            ] {
                let inside = |r: &std::ops::Range<u64>| r.start <= start && start + bytes <= r.end;
                assert!(regions.iter().any(inside), "{start:#x} + {bytes}");
            }
        }
    }
}

#[test]
fn rings_go_to_the_carrier_and_come_back() {
    for kind in Kind::ALL {
        let mut guest = Guest::new(kind);
        assert_eq!([guest.read(0x0), guest.read(0x4)], [0x7472_6976, 2]);
        guest.start(1 << 32, [256, 64], QUEUE_PARTS);
        assert_eq!((guest.read(0x70), guest.read(0x60)), (0xf, 1));
        let ring = |size, [descriptors, available, used]: [u64; 3]| Ring {
            size,
            descriptors,
            available,
            used,
        };
        let rings = [ring(256, QUEUE_PARTS[0]), ring(64, QUEUE_PARTS[1])];
        assert_eq!(guest.calls(), [Call::Start(1 << 32, rings)]);
        // The reason is there for each interrupt, whatever is acknowledged.
        guest.write(0x64, 1);
        assert_eq!(guest.read(0x60), 1);
        guest.write(0x70, 0);
        assert_eq!((guest.calls(), guest.read(0x70), guest.read(0x60)), (vec![Call::Stop], 0, 0));
    }
}

#[test]
fn a_driver_of_the_old_kind_or_of_what_is_not_offered_is_refused() {
    for kind in Kind::ALL {
        let mut guest = Guest::new(kind);
        for features in [0, 1 << 5, 1 << 32 | 1 << 17, 1 << 32 | 1 << 26] {
            guest.start(features, [256; 2], QUEUE_PARTS);
            assert_eq!(guest.read(0x70), 0x47, "{features:#x}");
            assert_eq!(guest.calls(), []);
        }
    }
}

#[test]
fn rings_that_are_not_in_ram_go_nowhere() {
    Kind::ALL.into_iter().for_each(place_rings);
}

fn place_rings(kind: Kind) {
    let mut guest = Guest::new(kind);
    let [good, other] = QUEUE_PARTS;
    // The last place of a part that fits, and the first that does not; for 256 entries.
    let tables = [(RAM - 4096, true), (RAM - 4080, false), (RAM, false), (u64::MAX - 15, false)];
    let available =
        [(RAM - 518, true), (RAM - 516, false), (HIGH - 2, false), (u64::MAX - 1, false)];
    let used =
        [(RAM - 2056, true), (RAM - 2052, false), (HIGH + RAM, false), (u64::MAX - 3, false)];
    for (part, places) in [tables, available, used].into_iter().enumerate() {
        for (address, fits) in places {
            for queue in 0..2 {
                let mut parts = [good, other];
                parts[queue][part] = address;
                let before = guest.link.refusals();
                guest.start(1 << 32, [256; 2], parts);
                let calls = guest.calls();
                let started = calls.iter().any(|call| matches!(call, Call::Start(..)));
                assert_eq!(started, fits, "queue {queue}, part {part} at {address:#x}");
                assert_eq!(guest.read(0x70) & 0x40 == 0, fits);
                assert_eq!(guest.link.refusals() - before, u64::from(!fits));
            }
        }
    }
}

#[test]
fn an_address_that_is_not_aligned_or_a_size_that_is_none_breaks_the_device() {
    Kind::ALL.into_iter().for_each(misplace_and_missize);
}

fn misplace_and_missize(kind: Kind) {
    let mut guest = Guest::new(kind);
    let [good, other] = QUEUE_PARTS;
    for part in 0..3 {
        let mut odd = good;
        odd[part] += 1;
        guest.start(1 << 32, [256; 2], [odd, other]);
        // The queue keeps its old address, 0, or is refused; it is never the odd one.
        for call in guest.calls() {
            if let Call::Start(_, rings) = call {
                guest.assert_inside(&rings);
            }
        }
    }
    for size in [0, 3, 512, 0x1_0000, u32::MAX] {
        guest.start(1 << 32, [256, size], QUEUE_PARTS);
        assert_eq!(guest.read(0x70) & 0x40, 0x40, "{size}");
        assert!(!guest.calls().iter().any(|call| matches!(call, Call::Start(..))));
    }
}

#[test]
fn a_queue_does_not_change_while_the_carrier_has_it() {
    Kind::ALL.into_iter().for_each(write_to_running_queues);
}

fn write_to_running_queues(kind: Kind) {
    let mut guest = Guest::new(kind);
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    let _ = guest.calls();
    guest.write(0x30, 0);
    for register in [0x38, 0x80, 0x84, 0x90, 0xa0] {
        guest.write(register, 0xdead_bee0);
    }
    // Ready a second time, the last step a second time, another queue than there is.
    guest.write(0x44, 1);
    guest.write(0x70, 0xf);
    guest.write(0x30, 3);
    guest.write(0x44, 0);
    assert_eq!(guest.calls(), []);
    // One queue taken away ends both, once.
    for queue in [1, 0] {
        guest.write(0x30, queue);
        guest.write(0x44, 0);
    }
    assert_eq!(guest.calls(), [Call::Stop]);
    guest.write(0x44, 1);
    guest.write(0x70, 0xf);
    assert_eq!(guest.calls(), [], "only a reset starts it again");
}

#[test]
fn a_carrier_that_refuses_breaks_the_device_until_a_reset() {
    let mut guest = Guest::with(Kind::Vsock, Notes { refuses: true, ..Notes::default() });
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    assert_eq!((guest.read(0x70), guest.read(0x60)), (0x4f, 2));
    assert_eq!(guest.link.error().map(io::Error::kind), Some(io::ErrorKind::Other));
    assert_eq!(guest.link.refusals(), 0, "it is not the driver's error");
    guest.write(0x70, 0);
    assert_eq!((guest.read(0x70), guest.read(0x60)), (0, 0));
    assert_eq!(guest.calls().len(), 1, "what has not started is not stopped");
}

#[test]
fn a_new_machine_finds_the_device_as_at_power_on() {
    let mut guest = Guest::new(Kind::Net);
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    guest.link.reset();
    // The guest has the same memory again, and the same page of registers.
    let page = guest.registers.page().clone();
    guest.registers = guest.kind.device(&guest.memory, &guest.link, &page);
    assert_eq!((guest.read(0x70), guest.read(0x60)), (0, 0));
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    assert_eq!(guest.calls().len(), 3);
}

/// At the end of a run the guest's memory is let go of by the end of the carrier itself.
#[test]
fn a_carrier_that_is_gone_is_told_nothing_and_gets_no_rings() {
    let mut guest = Guest::new(Kind::Vsock);
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    let _ = guest.calls();
    guest.link.end();
    guest.link.reset();
    guest.start(1 << 32, [256; 2], QUEUE_PARTS);
    assert_eq!((guest.calls(), guest.read(0x70) & 0x40), (vec![], 0x40));
}

proptest! {
    /// Whatever is written wherever: what the carrier gets is the guest's own, and it gets nothing twice
    /// without having given it back.
    #[test]
    fn the_carrier_gets_only_the_guests_ram(
        writes in prop::collection::vec(
            (prop::sample::select(vec![
                0x20u64, 0x24, 0x30, 0x38, 0x44, 0x44, 0x64, 0x70, 0x70, 0x80, 0x84, 0x90, 0x94, 0xa0, 0xa4,
            ]), prop::sample::select(vec![
                0u32, 1, 2, 3, 7, 0xb, 0xf, 16, 256, 0x1000, 0xf_f000, 0xf_fffe, 0x10_0000,
                0x7fff_ffff, 0xffff_fff0, u32::MAX,
            ])), 0..200),
        honest: bool,
        kind in prop::sample::select(Kind::ALL.to_vec()),
    ) {
        let mut guest = Guest::new(kind);
        if honest {
            guest.start(1 << 32, [256; 2], QUEUE_PARTS);
        }
        for (register, value) in writes {
            guest.write(register, value);
        }
        let mut has = false;
        for call in guest.calls() {
            match call {
                Call::Start(_, rings) => {
                    prop_assert!(!has);
                    guest.assert_inside(&rings);
                    has = true;
                }
                Call::Stop => {
                    prop_assert!(has);
                    has = false;
                }
            }
        }
    }
}
