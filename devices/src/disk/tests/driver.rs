//! What a driver finds, and how it gets to its first request.

use super::*;

#[test]
fn linux_finds_a_disk_and_its_size() {
    let guest = Guest::new(false);
    assert_eq!([0, 4, 8].map(|at| guest.read(at)), [0x7472_6976, 2, 2]);
    assert_eq!(
        [0x100, 0x104, 0x108, 0x10c].map(|at| guest.read(at)),
        [SECTORS as u32, 0, 1 << 16, 254]
    );
    // What may be discarded at once: 1 GiB, in one piece, in blocks of 4 KiB.
    assert_eq!([0x124, 0x128, 0x12c].map(|at| guest.read(at)), [1 << 21, 1, 8]);
    // Only the first queue is there.
    assert_eq!(guest.read(0x34), u32::from(QUEUE_SIZE));
}

#[test]
fn what_is_offered_depends_on_whether_the_disk_may_be_written() {
    for (read_only, low) in [(false, 1 << 9 | 1 << 13), (true, 1 << 5)] {
        let mut guest = Guest::new(read_only);
        assert_eq!(guest.read(0x10), low | 1 << 1 | 1 << 2 | 1 << 28);
        guest.write(0x14, 1);
        assert_eq!(guest.read(0x10), 1);
        guest.write(0x14, 2);
        assert_eq!(guest.read(0x10), 0);
    }
}

#[test]
fn a_driver_that_accepts_too_much_or_too_little_is_refused() {
    for (low, high) in [(1 << 9, 0), (1 << 9 | 1 << 14, 1), (0, 1), (1 << 9, 3)] {
        let mut guest = Guest::new(false);
        guest.write(0x70, 3);
        guest.write(0x20, low);
        guest.write(0x24, 1);
        guest.write(0x20, high);
        guest.write(0x70, 0xb);
        assert_eq!(guest.read(0x70), 3, "{low:#x} {high:#x}");
    }
}

#[test]
fn nothing_changes_under_a_queue_in_use() {
    let mut guest = Guest::driven(false);
    for register in [0x38, 0x80, 0x84, 0x90, 0x94, 0xa0, 0xa4] {
        guest.write(register, 0xdead_beec);
    }
    // No feature can be added either, and no other queue disturbs this one.
    guest.write(0x20, u32::MAX);
    guest.write(0x30, 1);
    guest.write(0x44, 0);
    assert_eq!((guest.read(0x34), guest.read(0x44)), (0, 0));
    guest.write(0x30, 0);
    assert_eq!(guest.read(0x44), 1);
    assert_eq!(guest.ask(IN, 3, &[writable(DATA, 512)]), OK);
}

#[test]
fn a_queue_is_a_reason_to_look_from_its_first_request_to_the_reset() {
    let mut guest = Guest::new(false);
    assert_eq!(guest.read(0x60), 0);
    guest.start_driver();
    assert_eq!(guest.read(0x60), 1);
    assert_eq!(guest.ask(FLUSH, 0, &[]), OK);
    guest.write(0x64, 1);
    assert_eq!(guest.read(0x60), 1, "the next interrupt has no reason");
    guest.write(0x70, 0);
    assert_eq!(guest.read(0x60), 0);
}

#[test]
fn a_queue_that_is_switched_off_is_served_no_more() {
    let mut guest = Guest::driven(false);
    guest.write(0x44, 0);
    assert_eq!(guest.read(0x44), 0);
    guest.write_header(IN, 0);
    guest.offer(0, &[readable(HEADER, 16), writable(DATA, 512), writable(STATUS, 1)]);
    assert!(!guest.server.serve(|| ()));
    assert_eq!((guest.status(), guest.transfers()), (UNTOUCHED, 0));
}

#[test]
fn a_restart_of_the_guest_begins_as_at_power_on() {
    let mut guest = Guest::driven(false);
    assert_eq!(guest.ask(FLUSH, 0, &[]), OK);
    guest.shared.recall();
    let shape = Shape { sectors: SECTORS, read_only: false };
    let device = DiskDevice::new(shape, guest.shared.clone());
    guest.registers = Registers::new(device, guest.registers.page().clone());
    assert_eq!([0x44, 0x60, 0x70].map(|at| guest.read(at)), [0; 3]);
    assert!(!guest.server.serve(|| ()));
    guest.start_driver();
    assert_eq!(guest.ask(IN, 1, &[writable(DATA, 512)]), OK);
}
