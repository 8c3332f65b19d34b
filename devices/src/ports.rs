//! The I/O port space of one guest.
//!
//! Ports that no device claims behave as on a PC without a card in the slot: reads give all ones,
//! writes vanish. Both are counted, so that a guest that pokes about does not go unseen.

use std::ops::RangeInclusive;

use thiserror::Error;

/// A device behind a range of I/O ports.
pub trait PortDevice: Send {
    /// Fills `data` (1, 2 or 4 bytes) from `offset`, counted from the start of the range.
    fn read(&mut self, offset: u16, data: &mut [u8]);
    /// Takes `data` (1, 2 or 4 bytes) written at `offset`.
    fn write(&mut self, offset: u16, data: &[u8]);
}

/// Two devices claim the same port.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("ports {new:#x?} overlap with {old:#x?}")]
pub struct Overlap {
    /// Range of the device that was there first.
    pub old: RangeInclusive<u16>,
    /// Range of the device that was refused.
    pub new: RangeInclusive<u16>,
}

/// All ports of one guest.
#[derive(Default)]
pub struct PortBus {
    devices: Vec<(RangeInclusive<u16>, Box<dyn PortDevice>)>,
    unclaimed: u64,
}

impl PortBus {
    /// Attaches `device` to a range of ports.
    ///
    /// # Errors
    /// [`Overlap`] if another device already claims one of them.
    pub fn attach(
        &mut self,
        range: RangeInclusive<u16>,
        device: Box<dyn PortDevice>,
    ) -> Result<(), Overlap> {
        let meets = |(r, _): &&(RangeInclusive<u16>, _)| {
            r.start() <= range.end() && range.start() <= r.end()
        };
        if let Some((old, _)) = self.devices.iter().find(meets) {
            return Err(Overlap { old: old.clone(), new: range });
        }
        self.devices.push((range, device));
        Ok(())
    }

    /// A read by the guest. `data` may hold several accesses of a string instruction, each
    /// `width` bytes wide; a width of 0 is treated as 1.
    pub fn read(&mut self, port: u16, width: usize, data: &mut [u8]) {
        for item in data.chunks_mut(width.max(1)) {
            match self.find(port, item.len()) {
                Some((offset, device)) => device.read(offset, item),
                None => item.fill(0xff),
            }
        }
    }

    /// A write by the guest; see [`read`](Self::read).
    pub fn write(&mut self, port: u16, width: usize, data: &[u8]) {
        for item in data.chunks(width.max(1)) {
            if let Some((offset, device)) = self.find(port, item.len()) {
                device.write(offset, item);
            }
        }
    }

    /// How many accesses no device claimed.
    #[must_use]
    pub fn unclaimed(&self) -> u64 {
        self.unclaimed
    }

    /// The device that owns all of the access; an access that leaves its range is nobody's.
    fn find(&mut self, port: u16, width: usize) -> Option<(u16, &mut dyn PortDevice)> {
        let last = usize::from(port) + width.max(1) - 1;
        let owns = |r: &RangeInclusive<u16>| r.contains(&port) && last <= usize::from(*r.end());
        match self.devices.iter_mut().find(|(r, _)| owns(r)) {
            Some((range, device)) => Some((port - range.start(), device.as_mut())),
            None => {
                self.unclaimed += 1;
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Sender, channel};

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
    fn an_access_that_leaves_the_range_is_nobodys() {
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
}
