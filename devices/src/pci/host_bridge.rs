//! The host bridge, which has only an identity.
//!
//! Linux looks for a function of this class before it trusts the configuration ports
//! (`pci_sanity_check` in `arch/x86/pci/direct.c`). What a real bridge would have to configure, the
//! guest is told by ACPI.

use super::{ConfigSpace, HOST_BRIDGE_ID, Register};

/// Class code "bridge, host bridge", revision 0.
const CLASS: u32 = 0x06_00_00 << 8;

/// A host bridge without any register that could be written.
pub struct HostBridge;

impl ConfigSpace for HostBridge {
    fn read(&mut self, register: Register) -> u32 {
        match register {
            Register::IDENTITY | Register::SUBSYSTEM => HOST_BRIDGE_ID.word(),
            Register::CLASS => CLASS,
            _ => 0,
        }
    }

    fn write(&mut self, _: Register, _: u32, _: u32) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_can_be_written() {
        let mut bridge = HostBridge;
        let before: Vec<u32> = (0..64).map(|r| bridge.read(Register(r))).collect();
        for register in 0..64 {
            bridge.write(Register(register), u32::MAX, u32::MAX);
        }
        assert_eq!((0..64).map(|r| bridge.read(Register(r))).collect::<Vec<_>>(), before);
        assert_eq!(before[2] >> 16, 0x0600);
    }
}
