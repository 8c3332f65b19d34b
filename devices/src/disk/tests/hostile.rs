//! What no driver does. The server touches only the guest's RAM, never panics, does a queue's
//! worth of work at most, and serves the next guest as if nothing had been.

use std::sync::mpsc::{Receiver, Sender, channel};

use super::*;

const STATUS_PIECE: Descriptor = writable(STATUS, 1);
const HEADER_PIECE: Descriptor = readable(HEADER, 16);

#[test]
fn a_chain_that_loops_ends_at_the_length_of_the_queue() {
    let mut guest = Guest::driven(false);
    guest.write_header(IN, 0);
    let piece = Descriptor { flags: WRITE | NEXT, next: 1, ..writable(DATA, 512) };
    guest.write_descriptors(
        TABLE,
        0,
        &[Descriptor { flags: NEXT, next: 1, ..HEADER_PIECE }, piece],
    );
    guest.make_available(0);
    guest.assert_broken_until_reset();
    assert_eq!(guest.transfers(), 1);
}

#[test]
fn a_chain_to_a_descriptor_that_does_not_exist_has_no_place_for_an_answer() {
    for (head, next) in [(QUEUE_SIZE, 0), (u16::MAX, 0), (0, QUEUE_SIZE), (0, u16::MAX)] {
        let mut guest = Guest::driven(false);
        guest.write_descriptors(TABLE, 0, &[Descriptor { flags: NEXT, next, ..HEADER_PIECE }]);
        guest.make_available(head);
        guest.assert_broken_until_reset();
    }
}

#[test]
fn a_chain_longer_than_the_queue_is_refused() {
    let mut guest = Guest::driven(false);
    let table = DATA + 0x8000;
    // In an indirect table there is room for more than in the queue.
    let mut pieces = vec![Descriptor { flags: NEXT, next: 1, ..HEADER_PIECE }];
    for next in 2..SEGMENTS_MAX as u16 + 3 {
        pieces.push(Descriptor { flags: WRITE | NEXT, next, ..writable(DATA, 512) });
    }
    pieces.push(STATUS_PIECE);
    assert_eq!(pieces.len(), usize::from(QUEUE_SIZE) + 1);
    guest.write_descriptors(table, 0, &pieces);
    let bytes = 16 * pieces.len() as u32;
    guest.offer(0, &[Descriptor { flags: INDIRECT, ..readable(table, bytes) }]);
    guest.assert_broken_until_reset();
}

#[test]
fn an_indirect_table_in_an_indirect_table_or_of_odd_length_is_refused() {
    let table = DATA + 0x8000;
    let indirect = |bytes| Descriptor { flags: INDIRECT, ..readable(table, bytes) };
    for bytes in [0, 1, 15, 17, u32::MAX, 0xffff_fff0] {
        let mut guest = Guest::driven(false);
        guest.offer(0, &[indirect(bytes)]);
        guest.assert_broken_until_reset();
    }
    let mut guest = Guest::driven(false);
    guest.write_descriptors(table, 0, &[indirect(16)]);
    guest.offer(0, &[indirect(16)]);
    guest.assert_broken_until_reset();
    let mut guest = Guest::driven(false);
    guest.offer(0, &[Descriptor { address: u64::MAX - 15, ..indirect(32) }]);
    guest.assert_broken_until_reset();
}

#[test]
fn memory_that_is_not_the_guests_is_an_error_and_is_not_touched() {
    let places = [
        (RAM, 512),
        (RAM - 1, 512),
        (0xd000_0000, 512),
        (HIGH - 1, 512),
        (HIGH + RAM - 511, 512),
        (u64::MAX, 512),
        (u64::MAX - 511, 512),
        (u64::MAX - 255, 512),
        (1 << 63, 512),
        (DATA, 1 << 31),
        (DATA, SEGMENT_BYTES_MAX + 512),
    ];
    let mut guest = Guest::driven(false);
    for (address, bytes) in places {
        assert_eq!(guest.ask(IN, 0, &[writable(address, bytes)]), IOERR, "{address:#x}");
        assert_eq!(guest.ask(OUT, 0, &[readable(address, bytes)]), IOERR, "{address:#x}");
    }
    assert!(!guest.needs_reset());
    assert_eq!(guest.transfers(), 0);
}

#[test]
fn a_header_that_cannot_be_read_is_an_error() {
    for header in [readable(RAM, 16), readable(u64::MAX - 7, 16), readable(HEADER, 15)] {
        let mut guest = Guest::driven(false);
        guest.write_header(FLUSH, 0);
        guest.offer(0, &[header, STATUS_PIECE]);
        assert!(guest.server.serve(|| ()));
        assert_eq!((guest.status(), guest.transfers()), (IOERR, 0));
    }
}

#[test]
fn a_request_without_a_place_for_its_status_stops_the_device() {
    let no_place = [
        vec![HEADER_PIECE],
        vec![HEADER_PIECE, readable(DATA, 512)],
        vec![HEADER_PIECE, writable(STATUS, 0)],
        vec![HEADER_PIECE, writable(RAM, 1)],
        vec![HEADER_PIECE, writable(RAM - 511, 512)],
        vec![HEADER_PIECE, writable(0xd000_0000, 1)],
        vec![HEADER_PIECE, writable(u64::MAX, 1)],
        vec![HEADER_PIECE, writable(u64::MAX, 2)],
        vec![HEADER_PIECE, writable(u64::MAX - 1, u32::MAX)],
        // Longer together than a chain can be.
        vec![HEADER_PIECE, writable(DATA, u32::MAX), STATUS_PIECE],
    ];
    for chain in no_place {
        let mut guest = Guest::driven(false);
        guest.write_header(FLUSH, 0);
        guest.offer(0, &chain);
        guest.assert_broken_until_reset();
        // That is the one after the reset.
        assert_eq!(guest.transfers(), 1);
    }
}

#[test]
fn sectors_that_are_not_there_are_an_error() {
    let mut guest = Guest::driven(false);
    let beyond = [
        (SECTORS, 512),
        (SECTORS - 1, 1024),
        (u64::MAX, 512),
        (u64::MAX, 1024),
        (u64::MAX / 512, 512),
        (u64::MAX / 512 + 1, 512),
        (1 << 55, 512),
    ];
    for (sector, bytes) in beyond {
        assert_eq!(guest.ask(IN, sector, &[writable(DATA, bytes)]), IOERR, "{sector:#x}");
        assert_eq!(guest.ask(OUT, sector, &[readable(DATA, bytes)]), IOERR, "{sector:#x}");
    }
    assert_eq!(guest.transfers(), 0);
    assert_eq!(guest.ask(IN, SECTORS - 1, &[writable(DATA, 512)]), OK);
}

#[test]
fn transfers_of_nothing_and_of_parts_of_a_sector_are_an_error() {
    let mut guest = Guest::driven(false);
    assert_eq!(guest.ask(IN, 0, &[]), IOERR);
    assert_eq!(guest.ask(OUT, 0, &[]), IOERR);
    for bytes in [1, 511, 513] {
        assert_eq!(guest.ask(IN, 0, &[writable(DATA, bytes)]), IOERR);
        assert_eq!(guest.ask(OUT, 0, &[readable(DATA, bytes)]), IOERR);
    }
    assert_eq!(guest.ask(GET_ID, 0, &[writable(DATA, 19)]), IOERR);
    assert_eq!(guest.ask(GET_ID, 0, &[writable(DATA, 21)]), IOERR);
    assert_eq!(guest.transfers(), 0);
}

#[test]
fn what_cannot_be_discarded_is_an_error() {
    let mut guest = Guest::driven(false);
    let beyond = [
        (0, 0),
        (0, 1 << 21),
        (0, (1 << 21) + 1),
        (0, u32::MAX),
        (SECTORS, 1),
        (SECTORS - 1, 2),
        (u64::MAX, 1),
        (u64::MAX / 512, 1),
        (1 << 55, 8),
    ];
    for (sector, sectors) in beyond {
        guest.write_discarded(sector, sectors, 0);
        assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16)]), IOERR, "{sector:#x} {sectors}");
    }
    guest.write_discarded(0, 8, 0);
    for bytes in [0, 8, 15, 17, 32] {
        assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, bytes)]), IOERR, "{bytes}");
    }
    assert_eq!(guest.ask(DISCARD, 0, &[readable(RAM - 8, 16)]), IOERR);
    assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16), writable(HIGH, 512)]), IOERR);
    for flags in [1, 2, u32::MAX] {
        guest.write_discarded(0, 8, flags);
        assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16)]), UNSUPP);
    }
    assert_eq!(guest.transfers(), 0);
}

#[test]
fn a_disk_that_is_only_read_is_never_written() {
    let mut guest = Guest::driven(true);
    assert_eq!(guest.ask(OUT, 0, &[readable(DATA, 512)]), IOERR);
    guest.write_discarded(0, 8, 0);
    assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16)]), IOERR);
    assert_eq!(guest.transfers(), 0);
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512)]), OK);
}

#[test]
fn data_in_the_wrong_direction_and_second_status_bytes_are_an_error() {
    let mut guest = Guest::driven(false);
    assert_eq!(guest.ask(IN, 0, &[readable(DATA, 512)]), IOERR);
    assert_eq!(guest.ask(IN, 0, &[readable(DATA, 512), writable(DATA, 512)]), IOERR);
    assert_eq!(guest.ask(OUT, 0, &[writable(DATA, 512)]), IOERR);
    // Of several places the last is the status, whatever the driver meant.
    assert_eq!(guest.ask(OUT, 0, &[readable(DATA, 512), writable(STATUS, 1)]), IOERR);
    assert_eq!(guest.ask(FLUSH, 0, &[writable(STATUS, 1)]), IOERR);
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512), writable(STATUS, 1)]), IOERR);
    assert_eq!(guest.transfers(), 0);
}

#[test]
fn everything_else_is_unsupported() {
    let mut guest = Guest::driven(false);
    for kind in [2, 3, 5, 7, 9, 10, 12, 13, 14, 24, 1 << 31, u32::MAX] {
        assert_eq!(guest.ask(kind, 0, &[writable(DATA, 512)]), UNSUPP, "{kind}");
        assert_eq!(guest.ask(kind, 0, &[readable(DATA, 512)]), UNSUPP, "{kind}");
    }
    assert_eq!(guest.transfers(), 0);
}

#[test]
fn more_requests_than_the_queue_holds_are_none() {
    for available in [QUEUE_SIZE + 1, 0x8000, u16::MAX] {
        let mut guest = Guest::driven(false);
        guest.memory.write_obj(available, GuestAddress(AVAILABLE + 2)).unwrap();
        guest.assert_broken_until_reset();
        assert_eq!(guest.transfers(), 1);
    }
}

#[test]
fn a_queue_where_there_is_no_memory_is_not_served() {
    let nowhere = [RAM, RAM - 16, 0xd000_0000, HIGH - 16, u64::MAX - 15, !0xfff, 1 << 63];
    for at in nowhere {
        for rings in [[at, AVAILABLE, USED], [TABLE, at, USED], [TABLE, AVAILABLE, at]] {
            let mut guest = Guest::new(false);
            guest.set_up(128, rings);
            guest.assert_broken_until_reset();
        }
    }
}

#[test]
fn a_queue_of_a_size_or_at_a_place_that_none_has_is_refused() {
    let good = [TABLE, AVAILABLE, USED];
    let mut cases =
        [0, 3, 127, 512, 0x1_0000, 0x1_0080, u32::MAX].map(|size| (size, good)).to_vec();
    cases.push((128, [TABLE + 8, AVAILABLE, USED]));
    cases.push((128, [TABLE, AVAILABLE + 1, USED]));
    cases.push((128, [TABLE, AVAILABLE, USED + 2]));
    for (size, rings) in cases {
        let mut guest = Guest::new(false);
        guest.set_up(size, rings);
        assert!(guest.needs_reset(), "{size}");
        assert!(guest.shared.was_broken(), "{size}");
        assert!(!guest.server.serve(|| ()));
        guest.start_driver();
        assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512)]), OK);
    }
}

#[test]
fn a_driver_that_is_ready_before_its_time_has_no_queue() {
    let mut guest = Guest::new(false);
    guest.write(0x70, 0xf);
    assert!(guest.needs_reset());
    let mut guest = Guest::new(false);
    guest.negotiate();
    guest.write(0x70, 0xf);
    assert!(guest.needs_reset());
    assert!(!guest.server.serve(|| ()));
}

#[test]
fn rings_that_lie_on_each_other_harm_only_their_guest() {
    let mut guest = Guest::new(false);
    guest.set_up(128, [TABLE, TABLE, TABLE]);
    for n in 0..64u16 {
        guest.memory.write_obj([n; 32], GuestAddress(TABLE)).unwrap();
        let _ = guest.server.serve(|| ());
    }
    guest.start_driver();
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512)]), OK);
}

#[test]
fn a_request_over_the_rings_themselves_harms_only_its_guest() {
    let mut guest = Guest::driven(false);
    for at in [TABLE, AVAILABLE, USED] {
        assert_eq!(guest.ask(IN, 0, &[writable(at, 4096)]), OK);
        guest.start_driver();
    }
}

#[test]
fn no_more_is_discarded_at_once_than_a_driver_was_told() {
    let mut guest = Guest::driven(false);
    let shape = Shape { sectors: u64::from(DISCARD_SECTORS_MAX) + 1, read_only: false };
    let ((begun, begins), (go, gone)) = (channel(), channel());
    let disk = Disk { shape, id: [0; 20], medium: Slow { begun, go: gone } };
    let mut server = Server::new(guest.shared.clone(), guest.memory.clone(), disk);
    for (more, answer) in [(1, IOERR), (0, OK)] {
        go.send(()).unwrap();
        guest.write_discarded(0, DISCARD_SECTORS_MAX + more, 0);
        guest.write_header(DISCARD, 0);
        guest.offer(0, &[HEADER_PIECE, readable(DATA, 16), STATUS_PIECE]);
        assert!(server.serve(|| ()));
        assert_eq!(guest.status(), answer);
    }
    assert_eq!(begins.try_iter().count(), 1);
}

/// A medium that takes as long as it is told: each call says that it has begun, and waits for the word.
struct Slow {
    begun: Sender<()>,
    go: Receiver<()>,
}

impl Slow {
    fn wait(&self) -> io::Result<()> {
        self.begun.send(()).unwrap();
        self.go.recv().unwrap();
        Ok(())
    }
}

impl Medium for Slow {
    fn read(&mut self, _: u64, into: &mut [u8]) -> io::Result<()> {
        into.fill(7);
        self.wait()
    }
    fn write(&mut self, _: u64, _: &[u8]) -> io::Result<()> {
        self.wait()
    }
    fn discard(&mut self, _: u64, _: u64) -> io::Result<()> {
        self.wait()
    }
    fn flush(&mut self) -> io::Result<()> {
        self.wait()
    }
}

#[test]
fn a_reset_waits_for_no_medium_and_the_guests_memory_is_its_own_after_it() {
    for (kind, data) in
        [(IN, writable(DATA, 512)), (OUT, readable(DATA, 512)), (FLUSH, readable(DATA, 0))]
    {
        let mut guest = Guest::driven(false);
        let shape = Shape { sectors: SECTORS, read_only: false };
        let ((begun, begins), (go, gone)) = (channel(), channel());
        let medium = Slow { begun, go: gone };
        let disk = Disk { shape, id: [0; 20], medium };
        let mut server = Server::new(guest.shared.clone(), guest.memory.clone(), disk);
        guest.memory.write_slice(&[UNTOUCHED; 512], GuestAddress(DATA)).unwrap();
        guest.write_header(kind, 0);
        for n in 0..8 {
            guest.offer(4 * n, &[HEADER_PIECE, data, STATUS_PIECE]);
        }
        let thread = std::thread::spawn(move || (server.serve(|| ()), server));
        begins.recv().unwrap();
        // The medium has not answered, and has no word to. This would not come back if it waited.
        guest.write(0x70, 0);
        assert_eq!((guest.read(0x60), guest.read(0x70)), (0, 0));
        // The driver begins anew at once, with rings that lie where the old ones did.
        guest.start_driver();
        go.send(()).unwrap();
        let (interrupts, mut server) = thread.join().unwrap();
        assert!(!interrupts, "a guest that has reset its disk is interrupted");
        assert!(begins.try_recv().is_err(), "a request of the old queue was begun");
        let mut read = [0; 512];
        guest.memory.read_slice(&mut read, GuestAddress(DATA)).unwrap();
        assert_eq!((read, guest.status()), ([UNTOUCHED; 512], UNTOUCHED));
        assert_eq!(guest.used().0, 0);
        // The same server goes on with the new queue.
        guest.write_header(IN, 0);
        guest.offer(0, &[HEADER_PIECE, writable(DATA, 512), STATUS_PIECE]);
        go.send(()).unwrap();
        assert!(server.serve(|| ()));
        guest.memory.read_slice(&mut read, GuestAddress(DATA)).unwrap();
        assert_eq!((read, guest.status()), ([7; 512], OK));
    }
}

#[test]
fn an_answer_waits_for_no_slow_request_behind_it() {
    for (slow, early) in [(FLUSH, 1), (DISCARD, 1), (IN, 0)] {
        let mut guest = Guest::driven(false);
        let shape = Shape { sectors: SECTORS, read_only: false };
        let ((begun, begins), (go, gone)) = (channel(), channel());
        let disk = Disk { shape, id: [0; 20], medium: Slow { begun, go: gone } };
        let mut server = Server::new(guest.shared.clone(), guest.memory.clone(), disk);
        guest.write_header(IN, 0);
        guest.offer(0, &[HEADER_PIECE, writable(DATA + 512, 512), STATUS_PIECE]);
        let header = HEADER + 0x100;
        guest.memory.write_obj([slow, 0], GuestAddress(header)).unwrap();
        guest.memory.write_obj(0u64, GuestAddress(header + 8)).unwrap();
        guest.write_discarded(0, 8, 0);
        let data = match slow {
            FLUSH => vec![],
            DISCARD => vec![readable(DATA, 16)],
            _ => vec![writable(DATA, 512)],
        };
        let chain = [vec![readable(header, 16)], data, vec![STATUS_PIECE]].concat();
        guest.offer(8, &chain);
        for _ in 0..2 {
            go.send(()).unwrap();
        }
        let mut done = Vec::new();
        assert!(server.serve(|| done.push((begins.try_iter().count(), guest.used().0))));
        // The first is answered, and the second has not begun.
        assert!(done.len() >= early && done.iter().all(|done| *done == (1, 1)), "{slow}: {done:?}");
    }
}

/// Each request takes 2 ms.
#[test]
fn an_answer_is_told_before_it_is_old() {
    struct Steady;
    impl Medium for Steady {
        fn read(&mut self, _: u64, _: &mut [u8]) -> io::Result<()> {
            std::thread::sleep(std::time::Duration::from_millis(2));
            Ok(())
        }
        fn write(&mut self, _: u64, _: &[u8]) -> io::Result<()> {
            Ok(())
        }
        fn discard(&mut self, _: u64, _: u64) -> io::Result<()> {
            Ok(())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut guest = Guest::driven(false);
    let disk =
        Disk { shape: Shape { sectors: SECTORS, read_only: false }, id: [0; 20], medium: Steady };
    let mut server = Server::new(guest.shared.clone(), guest.memory.clone(), disk);
    guest.write_header(IN, 0);
    for n in 0..6 {
        guest.offer(4 * n, &[HEADER_PIECE, writable(DATA, 512), STATUS_PIECE]);
    }
    let mut early = 0;
    assert!(server.serve(|| early += 1));
    assert!(early >= 2, "{early}");
}

#[test]
fn registers_survive_every_write() {
    let mut guest = Guest::driven(false);
    let mut number = 0x2545_f491_4f6c_dd1du64;
    for _ in 0..100_000 {
        number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let offset = number >> 40 & 0xfff;
        let width = 1 << (number >> 62);
        let data = (number >> 8).to_le_bytes();
        let offset = if number >> 33 & 1 == 0 { offset & 0xff } else { offset };
        guest.registers.write(offset, &data[..width]);
        let _ = guest.server.serve(|| ());
    }
    guest.start_driver();
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512)]), OK);
}

#[test]
fn rings_full_of_chance_are_survived() {
    let mut guest = Guest::driven(false);
    let mut number = 1u64;
    let mut chance = || {
        number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        number >> 32
    };
    for round in 0..2_000u32 {
        let descriptors: Vec<Descriptor> = (0..QUEUE_SIZE)
            .map(|_| Descriptor {
                address: chance() & 0x1f_ffff | (chance() & 1) << 32,
                bytes: chance() as u32 & 0x1_03ff,
                flags: chance() as u16 & 7,
                next: chance() as u16 & 0x11f,
            })
            .collect();
        guest.write_descriptors(TABLE, 0, &descriptors);
        for _ in 0..chance() & 0x3f {
            guest.make_available(chance() as u16 & 0xff);
        }
        let before = guest.transfers();
        let _ = guest.server.serve(|| ());
        assert!(guest.transfers() - before <= QUEUE_SIZE.into(), "round {round}");
        guest.start_driver();
    }
}
