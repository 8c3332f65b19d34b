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
    /// Whether writes of this many bytes in all at `offset` would wait now.
    fn would_wait(&self, _offset: u16, _bytes: usize) -> bool {
        false
    }
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

    /// Whether [`write`](Self::write) would wait now: the caller can wait without what others need.
    #[must_use]
    pub fn would_wait(&self, port: u16, data: &[u8]) -> bool {
        let owner = self.devices.iter().find(|(range, _)| range.contains(&port));
        owner.is_some_and(|(range, device)| device.would_wait(port - range.start(), data.len()))
    }

    /// How many accesses no device claimed.
    #[must_use]
    pub fn unclaimed(&self) -> u64 {
        self.unclaimed
    }

    /// The device that owns all of the access; an access that leaves its range has no device.
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
#[path = "ports_tests.rs"]
mod tests;
