//! What a driver does with the registers, for the tests of each device: right, or not.

use vm_memory::{GuestAddress, GuestMemoryMmap};

use super::page::{BYTES, RegisterPage};
use super::registers::Registers;

/// RAM of a guest: from 0, and behind a hole from [`HIGH`].
pub const RAM: u64 = 1 << 20;
/// Where the second half of it begins.
pub const HIGH: u64 = 1 << 32;

/// That memory.
pub fn memory() -> GuestMemoryMmap {
    let ranges = [(GuestAddress(0), RAM as usize), (GuestAddress(HIGH), RAM as usize)];
    GuestMemoryMmap::from_ranges(&ranges).unwrap()
}

/// The page on which it sees a device's registers.
pub fn page() -> RegisterPage {
    let start = 0xe000_0000;
    let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(start), BYTES as usize)]).unwrap();
    RegisterPage::new(&memory, start).unwrap()
}

impl Registers {
    /// A register.
    pub fn read_word(&self, offset: u64) -> u32 {
        self.page().get(offset as u32)
    }

    /// Writes a register.
    pub fn write_word(&mut self, offset: u64, value: u32) {
        self.write(offset, &value.to_le_bytes());
    }

    /// The features of the device.
    pub fn offered(&mut self) -> u64 {
        let halves = [0, 1].map(|half| {
            self.write_word(0x14, half);
            u64::from(self.read_word(0x10))
        });
        halves[0] | halves[1] << 32
    }

    /// The first steps, up to `FEATURES_OK`.
    pub fn accept(&mut self, features: u64) {
        for status in [0, 1, 3] {
            self.write_word(0x70, status);
        }
        for half in [0, 1] {
            self.write_word(0x24, half);
            self.write_word(0x20, (features >> (32 * half)) as u32);
        }
        self.write_word(0x70, 0xb);
    }

    /// Makes a queue ready: its entries, and where table, available and used ring are.
    pub fn set_up_queue(&mut self, number: u32, size: u32, parts: [u64; 3]) {
        self.write_word(0x30, number);
        self.write_word(0x38, size);
        for (register, address) in [0x80, 0x90, 0xa0].into_iter().zip(parts) {
            self.write_word(register, address as u32);
            self.write_word(register + 4, (address >> 32) as u32);
        }
        self.write_word(0x44, 1);
    }

    /// The last step.
    pub fn set_running(&mut self) {
        self.write_word(0x70, 0xf);
    }
}
