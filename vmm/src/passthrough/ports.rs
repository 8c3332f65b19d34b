//! Accesses to the ports that a partition has been given.
//!
//! Each one is made with the width that the guest used and as often as it asked: a 16-bit access
//! is not two of 8 bits to a device, and reading a status register twice may lose an event. An
//! access belongs to the partition only if all of its bytes do; of one that reaches beyond its
//! range nothing is done.

use crate::vcpu::port_access::{Direction, PortAccess};

use crate::vcpu::port_access::Width;

/// I/O ports, those of the host or others in their place.
pub trait Ports {
    /// One access that reads; bits above the width are zero.
    fn read(&mut self, port: u16, width: Width) -> u32;
    /// One access that writes the lower bits of `value`.
    fn write(&mut self, port: u16, width: Width, value: u32);
}

/// A range of ports in a partition, and the range of the host's that it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortRange {
    /// First one, for the guest.
    pub first: u16,
    /// Last one, for the guest.
    pub last: u16,
    /// First one, for the host. The range does not pass the last port there either.
    pub host: u16,
}

impl PortRange {
    /// The last one, for the host.
    #[must_use]
    pub const fn host_last(&self) -> u16 {
        self.host.saturating_add(self.last - self.first)
    }

    /// Where on the host an access of this width lies; `None` unless it is wholly inside.
    #[must_use]
    pub fn translate(&self, port: u16, width: Width) -> Option<u16> {
        let end = usize::from(port) + width.bytes() - 1;
        let inside = self.first <= port && end <= self.last.into();
        inside.then(|| self.host.wrapping_add(port - self.first))
    }
}

/// The ports of a partition.
#[derive(Clone, Debug)]
pub struct PortMap<P> {
    ranges: Box<[PortRange]>,
    ports: P,
}

impl<P: Ports> PortMap<P> {
    /// These ranges, which do not overlap, of these ports.
    #[must_use]
    pub fn new(ranges: &[PortRange], ports: P) -> Self {
        Self { ranges: ranges.into(), ports }
    }

    /// The ranges.
    #[must_use]
    pub fn ranges(&self) -> &[PortRange] {
        &self.ranges
    }

    /// Whether this port is the partition's.
    #[must_use]
    #[inline]
    pub fn has(&self, port: u16) -> bool {
        self.ranges.iter().any(|range| (range.first..=range.last).contains(&port))
    }

    /// Makes an access. One that is not wholly the partition's reads as all ones, writes nothing,
    /// and gives false.
    #[must_use]
    pub fn perform(&mut self, access: &mut PortAccess<'_>) -> bool {
        let PortAccess { port, width, direction, .. } = *access;
        let host = self.ranges.iter().find_map(|range| range.translate(port, width));
        let whole = access.data.len().is_multiple_of(width.bytes());
        let Some(host) = host.filter(|_| whole) else {
            if direction == Direction::In {
                access.data.fill(0xff);
            }
            return false;
        };
        for chunk in access.data.chunks_exact_mut(width.bytes()) {
            match direction {
                Direction::In => {
                    let value = self.ports.read(host, width).to_le_bytes();
                    chunk.copy_from_slice(&value[..width.bytes()]);
                }
                Direction::Out => {
                    let mut value = [0; 4];
                    value[..width.bytes()].copy_from_slice(chunk);
                    self.ports.write(host, width, u32::from_le_bytes(value));
                }
            }
        }
        true
    }
}

#[cfg(test)]
#[path = "ports_tests.rs"]
mod tests;
