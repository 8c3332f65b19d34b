//! Accesses at, across and beyond the bounds of a range.

use std::sync::mpsc::{Sender, channel};

use super::*;

/// Answers each read with its offset and reports each write.
struct Probe(Sender<(u16, Vec<u8>)>);

impl PortDevice for Probe {
    fn read(&mut self, offset: u16, data: &mut [u8]) {
        data.fill(offset as u8);
    }
    fn write(&mut self, offset: u16, data: &[u8]) {
        self.0.send((offset, data.to_vec())).unwrap();
    }
}

#[test]
fn an_access_reaches_its_device_as_an_offset() {
    let (tx, rx) = channel();
    let mut bus = PortBus::default();
    bus.attach(0x3f8..=0x3ff, Box::new(Probe(tx))).unwrap();
    bus.write(0x3fb, 1, &[7]);
    assert_eq!(rx.try_recv().unwrap(), (3, vec![7]));
    let mut data = [0; 2];
    bus.read(0x3fc, 2, &mut data);
    assert_eq!(data, [4, 4]);
    assert_eq!(bus.unclaimed(), 0);
}

#[test]
fn a_string_write_is_one_access_per_item() {
    let (tx, rx) = channel();
    let mut bus = PortBus::default();
    bus.attach(0x10..=0x13, Box::new(Probe(tx))).unwrap();
    bus.write(0x10, 2, &[1, 2, 3, 4]);
    assert_eq!(rx.try_iter().collect::<Vec<_>>(), [(0, vec![1, 2]), (0, vec![3, 4])]);
}

#[test]
fn unclaimed_reads_are_all_ones_and_counted() {
    let mut bus = PortBus::default();
    let mut data = [0; 4];
    bus.read(0xffff, 4, &mut data);
    bus.write(0xffff, 4, &data);
    assert_eq!((data, bus.unclaimed()), ([0xff; 4], 2));
}

#[test]
fn an_access_that_leaves_the_range_reaches_no_device() {
    let (tx, rx) = channel();
    let mut bus = PortBus::default();
    bus.attach(0xfffc..=0xffff, Box::new(Probe(tx))).unwrap();
    bus.write(0xfffe, 4, &[0; 4]);
    assert_eq!((rx.try_recv().ok(), bus.unclaimed()), (None, 1));
}

#[test]
fn two_devices_cannot_share_a_port() {
    let (tx, _rx) = channel();
    let mut bus = PortBus::default();
    bus.attach(0x60..=0x64, Box::new(Probe(tx.clone()))).unwrap();
    assert!(bus.attach(0x64..=0x64, Box::new(Probe(tx.clone()))).is_err());
    assert!(bus.attach(0x65..=0x65, Box::new(Probe(tx))).is_ok());
}
