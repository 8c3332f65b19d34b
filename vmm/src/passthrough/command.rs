//! The command register of a PCI function: what it decodes, whether it masters the bus and uses its
//! interrupt line (PCI Local Bus 3.0, 6.2.2).

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

/// Decodes ports.
pub const PORTS: u16 = 1;
/// Decodes memory.
pub const MEMORY: u16 = 1 << 1;
/// Masters the bus.
pub const MASTER: u16 = 1 << 2;
/// Does not use its interrupt line.
pub const NO_INTERRUPT: u16 = 1 << 10;

/// Where the register lies in the configuration space.
const OFFSET: u64 = 4;

/// Reads it, in a file that has the configuration space at `start`.
///
/// # Errors
/// What the host says.
pub fn read(config: &File, start: u64) -> io::Result<u16> {
    let mut bytes = [0; 2];
    config.read_exact_at(&mut bytes, start + OFFSET)?;
    Ok(u16::from_le_bytes(bytes))
}

/// Writes it.
///
/// # Errors
/// What the host says.
pub fn write(config: &File, start: u64, command: u16) -> io::Result<()> {
    config.write_all_at(&command.to_le_bytes(), start + OFFSET)
}
