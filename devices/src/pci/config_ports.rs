//! The two ports through which a guest reaches configuration space: "configuration mechanism #1"
//! (PCI 3.0, section 3.2.2.3.2).
//!
//! The guest writes bus, device, function and register to the address port, 32 bits at once, and
//! reads or writes the register, or some bytes of it, at the data port. Whatever is not there reads
//! as ones: that is how a guest finds out. So do accesses that the mechanism does not know, such as
//! bytes of the address port: Linux makes one of them, to find out what kind of mechanism this is.

use super::function::Function;
use super::host_bridge::HostBridge;
use super::{ConfigSpace, Register};
use crate::ports::PortDevice;

/// The address port, and the first of all that belong here.
pub const FIRST: u16 = 0xcf8;
/// The last of the four bytes of the data port.
pub const LAST: u16 = 0xcff;

const ADDRESS: u16 = 0;
const DATA: u16 = 4;

/// Device number of the function on the bus; the bridge is device 0.
pub const FUNCTION_DEVICE: u8 = 1;

/// The address port: what the next access to the data port is for.
#[derive(Clone, Copy, Default)]
struct Address(u32);

impl Address {
    /// Bits that a guest can set: enable, bus, device, function, register.
    const WRITABLE: u32 = 0x80ff_fffc;

    const fn is_enabled(self) -> bool {
        self.0 >> 31 != 0
    }

    const fn bus(self) -> u8 {
        (self.0 >> 16) as u8
    }

    const fn device(self) -> u8 {
        (self.0 >> 11) as u8 & 0x1f
    }

    const fn function(self) -> u8 {
        (self.0 >> 8) as u8 & 7
    }

    const fn register(self) -> Register {
        Register((self.0 >> 2) as u8 & 0x3f)
    }
}

/// The ports, and behind them the bus.
pub struct ConfigPorts {
    address: Address,
    bridge: HostBridge,
    function: Function,
}

impl ConfigPorts {
    /// A bus with this function and a host bridge.
    #[must_use]
    pub fn new(function: Function) -> Self {
        Self { address: Address::default(), bridge: HostBridge, function }
    }

    /// The function that is addressed, if there is one.
    fn target(&mut self) -> Option<&mut dyn ConfigSpace> {
        match (self.address.bus(), self.address.device(), self.address.function()) {
            (0, 0, 0) => Some(&mut self.bridge),
            (0, FUNCTION_DEVICE, 0) => Some(&mut self.function),
            _ => None,
        }
    }

    /// Checks an access to the data port. Returns by how many bits its bytes are shifted in the
    /// register; `None` if it has a width that no processor makes, leaves the register, or comes
    /// while no register is addressed.
    fn shift(&self, offset: u16, width: usize) -> Option<u32> {
        let byte = offset.checked_sub(DATA)?;
        let fits = matches!(width, 1 | 2 | 4) && usize::from(byte) + width <= 4;
        (fits && self.address.is_enabled()).then_some(u32::from(byte) * 8)
    }
}

impl PortDevice for ConfigPorts {
    fn read(&mut self, offset: u16, data: &mut [u8]) {
        let value = if offset == ADDRESS && data.len() == 4 {
            self.address.0
        } else if let Some(shift) = self.shift(offset, data.len()) {
            let register = self.address.register();
            self.target().map_or(u32::MAX, |target| target.read(register)) >> shift
        } else {
            u32::MAX
        };
        data.fill(0xff);
        for (to, from) in data.iter_mut().zip(value.to_le_bytes()) {
            *to = from;
        }
    }

    fn write(&mut self, offset: u16, data: &[u8]) {
        let mut value = [0; 4];
        let mut bytes = [0; 4];
        for ((value, bytes), from) in value.iter_mut().zip(&mut bytes).zip(data) {
            (*value, *bytes) = (*from, 0xff);
        }
        let (value, bytes) = (u32::from_le_bytes(value), u32::from_le_bytes(bytes));
        if offset == ADDRESS && data.len() == 4 {
            self.address = Address(value & Address::WRITABLE);
        } else if let Some(shift) = self.shift(offset, data.len()) {
            let register = self.address.register();
            if let Some(target) = self.target() {
                target.write(register, value << shift, bytes << shift);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::function::tests::function;
    use super::super::{FUNCTION_ID, HOST_BRIDGE_ID};
    use super::*;

    /// A guest at the ports.
    struct Guest(ConfigPorts);

    impl Guest {
        fn select(&mut self, bus: u32, device: u32, function: u32, offset: u32) {
            let address = 1 << 31 | bus << 16 | device << 11 | function << 8 | offset & !3;
            self.0.write(ADDRESS, &address.to_le_bytes());
        }

        fn read<const N: usize>(&mut self, device: u32, offset: u32) -> [u8; N] {
            let mut data = [0; N];
            self.select(0, device, 0, offset);
            self.0.read(DATA + (offset & 3) as u16, &mut data);
            data
        }

        fn write(&mut self, device: u32, offset: u32, data: &[u8]) {
            self.select(0, device, 0, offset);
            self.0.write(DATA + (offset & 3) as u16, data);
        }
    }

    fn guest() -> Guest {
        Guest(ConfigPorts::new(function()))
    }

    /// A linear congruential generator: a fixed sequence for each seed.
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> u32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(0x14057b7e);
            (self.0 >> 32) as u32
        }
    }

    #[test]
    fn linux_recognises_the_mechanism() {
        let mut guest = guest();
        // What pci_check_type1 does.
        guest.0.write(3, &[1]);
        guest.0.write(ADDRESS, &0x8000_0000u32.to_le_bytes());
        let mut data = [0; 4];
        guest.0.read(ADDRESS, &mut data);
        assert_eq!(u32::from_le_bytes(data), 0x8000_0000);
        assert_eq!(guest.read(0, 0x0a), 0x0600u16.to_le_bytes());
    }

    #[test]
    fn there_are_two_functions_and_no_more() {
        let mut guest = guest();
        let mut found = Vec::new();
        for (bus, device, number) in
            (0..256).flat_map(|b| (0..32).flat_map(move |d| (0..8).map(move |f| (b, d, f))))
        {
            guest.select(bus, device, number, 0);
            let mut data = [0; 4];
            guest.0.read(DATA, &mut data);
            if data != [0xff; 4] {
                found.push((bus, device, number, u32::from_le_bytes(data)));
            }
        }
        let (bridge, own) = (HOST_BRIDGE_ID.word(), FUNCTION_ID.word());
        assert_eq!(found, [(0, 0, 0, bridge), (0, 1, 0, own)]);
    }

    #[test]
    fn every_width_sees_its_own_bytes() {
        let mut guest = guest();
        for device in [0, 1] {
            for register in (0..256).step_by(4) {
                let whole: [u8; 4] = guest.read(device, register);
                for byte in 0..4 {
                    let at = register + byte;
                    let own = &whole[byte as usize..];
                    assert_eq!(guest.read::<1>(device, at), own[..1]);
                    if byte % 2 == 0 {
                        assert_eq!(guest.read::<2>(device, at), own[..2]);
                    }
                }
            }
        }
    }

    #[test]
    fn a_byte_is_written_without_its_neighbours() {
        let mut guest = guest();
        guest.write(1, 0x04, &[2]);
        guest.write(1, 0x05, &[4]);
        guest.write(1, 0x3c, &[9]);
        assert_eq!(guest.read(1, 0x04), [2, 4]);
        assert_eq!(guest.read(1, 0x3c), [9, 1, 0, 0]);
    }

    #[test]
    fn what_the_mechanism_does_not_know_reads_as_ones_and_changes_nothing() {
        let mut guest = guest();
        guest.select(0, 1, 0, 4);
        for offset in 0..8 {
            for width in [1, 2, 4] {
                let known = offset == 0 && width == 4 || offset >= 4 && offset + width <= 8;
                if known {
                    continue;
                }
                let mut data = [0; 4];
                guest.0.read(offset as u16, &mut data[..width]);
                assert_eq!(data[..width], [0xff; 4][..width], "{offset} {width}");
                guest.0.write(offset as u16, &data[..width]);
            }
        }
        // Still the same register, and its content.
        let mut data = [0; 4];
        guest.0.read(DATA, &mut data);
        assert_eq!(data, [0, 0, 8, 0]);
        guest.0.write(ADDRESS, &[4, 8, 0, 0]);
        guest.0.write(DATA, &[2, 0, 0, 0]);
        guest.0.read(DATA, &mut data);
        assert_eq!(data, [0xff; 4], "no register is enabled");
        assert_eq!(guest.read(1, 4), [0, 0, 8, 0]);
    }

    #[test]
    fn no_sequence_of_accesses_changes_what_must_not_change() {
        for seed in 1..=20 {
            let mut numbers = Numbers(seed);
            let mut guest = guest();
            let fixed = [(0, 0x00), (0, 0x08), (1, 0x00), (1, 0x08), (1, 0x2c)];
            let before = fixed.map(|(device, offset)| guest.read::<4>(device, offset));
            for _ in 0..20_000 {
                let (what, value) = (numbers.next(), numbers.next());
                let width = [0, 1, 2, 3, 4, 8][(what >> 4) as usize % 6];
                // Beyond the eight ports too, and often at an address that exists.
                let offset = (what >> 8) as u16 % 10;
                let value = if what & 1 == 0 { value } else { value & 0x8000_09ff | 0x8000_0000 };
                let mut data = [value.to_le_bytes(), value.to_le_bytes()].concat();
                if what & 2 == 0 {
                    guest.0.write(offset, &data[..width]);
                } else {
                    guest.0.read(offset, &mut data[..width]);
                }
            }
            assert_eq!(before, fixed.map(|(device, offset)| guest.read::<4>(device, offset)));
            for (bar, address) in [(0x10, 0), (0x14, 0xd000_4008), (0x18, 0xd000_0008)] {
                guest.write(1, bar, &[0; 4]);
                assert_eq!(u32::from_le_bytes(guest.read(1, bar)), address, "seed {seed}");
            }
        }
    }
}
