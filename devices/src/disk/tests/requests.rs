//! Requests as a good driver makes them.

use super::*;

#[test]
fn what_was_written_is_read_back_from_its_sectors() {
    let mut guest = Guest::driven(false);
    guest.memory.write_slice(&[0xab; 1024], GuestAddress(DATA)).unwrap();
    assert_eq!(guest.ask(OUT, 5, &[readable(DATA, 1024)]), OK);
    assert_eq!(guest.used(), (1, 0, 1));
    let into = DATA + 0x1000;
    assert_eq!(guest.ask(IN, 4, &[writable(into, 2048)]), OK);
    assert_eq!(guest.used(), (2, 0, 2049));
    let mut read = [0; 2048];
    guest.memory.read_slice(&mut read, GuestAddress(into)).unwrap();
    assert_eq!([4, 0xab, 0xab, 7].map(|n| [n; 512]).concat(), read);
}

#[test]
fn memory_in_many_pieces_and_above_the_hole_is_one_transfer() {
    let mut guest = Guest::driven(false);
    let pieces = [writable(HIGH, 300), writable(DATA, 1), writable(HIGH + 0x1000, 211)];
    assert_eq!(guest.ask(IN, 9, &pieces), OK);
    assert_eq!(guest.transfers(), 1);
    for (at, bytes) in [(HIGH, 300), (DATA, 1), (HIGH + 0x1000, 211)] {
        let mut read = vec![0; bytes + 1];
        guest.memory.read_slice(&mut read, GuestAddress(at)).unwrap();
        assert_eq!((read.pop(), read), (Some(0), vec![9; bytes]));
    }
}

#[test]
fn where_one_descriptor_ends_means_nothing() {
    let mut guest = Guest::driven(false);
    // Header and data in one piece, and the header in three.
    guest.write_header(OUT, 2);
    guest.memory.write_slice(&[0x77; 512], GuestAddress(HEADER + 16)).unwrap();
    guest.offer(0, &[readable(HEADER, 528), writable(STATUS, 1)]);
    assert!(guest.server.serve(|| ()));
    assert_eq!(guest.status(), OK);
    guest.write_header(IN, 2);
    let header = [readable(HEADER, 5), readable(HEADER + 5, 0), readable(HEADER + 5, 11)];
    // Data and status in one piece.
    guest.offer(0, &[header[0], header[1], header[2], writable(DATA, 513)]);
    assert!(guest.server.serve(|| ()));
    assert_eq!(guest.memory.read_obj::<u8>(GuestAddress(DATA)).unwrap(), 0x77);
    assert_eq!(guest.memory.read_obj::<u8>(GuestAddress(DATA + 512)).unwrap(), OK);
}

#[test]
fn an_indirect_table_is_followed() {
    let mut guest = Guest::driven(false);
    guest.write_header(IN, 8);
    let table = DATA + 0x8000;
    let [mut a, mut b] = [readable(HEADER, 16), writable(DATA, 512)];
    (a.flags, a.next) = (NEXT, 1);
    (b.flags, b.next) = (WRITE | NEXT, 2);
    guest.write_descriptors(table, 0, &[a, b, writable(STATUS, 1)]);
    guest.offer(7, &[Descriptor { flags: INDIRECT, ..readable(table, 48) }]);
    assert!(guest.server.serve(|| ()));
    assert_eq!((guest.status(), guest.used()), (OK, (1, 7, 513)));
}

#[test]
fn a_full_queue_is_one_notification_and_one_interrupt() {
    let mut guest = Guest::driven(false);
    guest.write_header(IN, 1);
    for n in 0..QUEUE_SIZE / 4 {
        guest.offer(4 * n, &[readable(HEADER, 16), writable(DATA, 512), writable(STATUS, 1)]);
    }
    assert!(guest.server.serve(|| ()));
    assert_eq!((guest.transfers(), guest.used().0), (64, 64));
    assert!(!guest.server.serve(|| ()));
}

#[test]
fn the_rings_go_round() {
    let mut guest = Guest::driven(false);
    for n in 0..=u16::MAX {
        assert_eq!(guest.ask(IN, u64::from(n % 64), &[writable(DATA, 512)]), OK);
    }
    assert_eq!(guest.used(), (0, 0, 513));
}

#[test]
fn the_name_is_told() {
    let mut guest = Guest::driven(true);
    assert_eq!(guest.ask(GET_ID, 0, &[writable(DATA, 7), writable(DATA + 7, 13)]), OK);
    let name: [u8; 20] = guest.memory.read_obj(GuestAddress(DATA)).unwrap();
    assert_eq!(&name, b"twenty bytes of name");
}

#[test]
fn what_is_discarded_is_zeros_and_nothing_beside_it() {
    let mut guest = Guest::driven(false);
    guest.write_discarded(5, 2, 0);
    // The record in two pieces.
    assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 9), readable(DATA + 9, 7)]), OK);
    assert_eq!(guest.used(), (1, 0, 1));
    assert_eq!(guest.ask(IN, 4, &[writable(HIGH, 2048)]), OK);
    let mut read = [0; 2048];
    guest.memory.read_slice(&mut read, GuestAddress(HIGH)).unwrap();
    assert_eq!([4, 0, 0, 7].map(|n| [n; 512]).concat(), read);
}

#[test]
fn an_error_of_the_file_is_an_answer() {
    let mut guest = Guest::with(false, Some(io::ErrorKind::Unsupported)).drive();
    guest.write_discarded(0, 8, 0);
    assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16)]), UNSUPP);
    assert!(guest.shared.error().is_none(), "a medium may keep all space");
    let mut guest = Guest::with(false, Some(io::ErrorKind::Other)).drive();
    guest.write_discarded(0, 8, 0);
    assert_eq!(guest.ask(DISCARD, 0, &[readable(DATA, 16)]), IOERR);
    let mut guest = Guest::with(false, Some(io::ErrorKind::Other)).drive();
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, 512)]), IOERR);
    assert_eq!(guest.used(), (1, 0, 1));
    assert_eq!(guest.ask(OUT, 0, &[readable(DATA, 512)]), IOERR);
    assert_eq!(guest.ask(FLUSH, 0, &[]), IOERR);
    assert_eq!(guest.transfers(), 3);
    assert_eq!(guest.shared.error().unwrap().kind(), io::ErrorKind::Other);
}

#[test]
fn the_largest_request_that_a_driver_may_make_is_served() {
    let mut guest = Guest::driven(false);
    let last = SECTORS - SEGMENTS_MAX as u64;
    let pieces = [writable(DATA, 512); SEGMENTS_MAX];
    assert_eq!(guest.ask(IN, last, &pieces), OK);
    assert_eq!(guest.ask(IN, last + 1, &pieces), IOERR);
    assert_eq!(guest.ask(IN, 0, &[writable(DATA, SEGMENT_BYTES_MAX); 2]), OK);
    assert_eq!(guest.transfers(), 2);
}

#[test]
fn a_request_longer_than_the_buffer_moves_every_byte() {
    // Pieces that end where neither a sector nor the buffer does.
    let lengths = [1, 65_535, 65_536, 511, 22_017];
    let total: usize = lengths.iter().map(|bytes| *bytes as usize).sum();
    assert!(total > PIECE_BYTES && total.is_multiple_of(512));
    let mut guest = Guest::driven(false);
    let bytes: Vec<u8> = (0..total).map(|n| (n % 251) as u8).collect();
    guest.memory.write_slice(&bytes, GuestAddress(DATA)).unwrap();
    let pieces = |to: u64, make: fn(u64, u32) -> Descriptor| {
        let mut at = to;
        lengths.map(|bytes| {
            at += u64::from(bytes);
            make(at - u64::from(bytes), bytes)
        })
    };
    assert_eq!(guest.ask(OUT, 3, &pieces(DATA, readable)), OK);
    assert_eq!(guest.ask(IN, 3, &pieces(HIGH, writable)), OK);
    assert_eq!(guest.used(), (2, 0, total as u32 + 1));
    let mut read = vec![0; total];
    guest.memory.read_slice(&mut read, GuestAddress(HIGH)).unwrap();
    assert!(read == bytes);
    assert_eq!(guest.transfers(), 4);
}
