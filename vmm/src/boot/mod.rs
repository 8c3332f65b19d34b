//! How each kind of guest gets to its first instruction.

pub mod acpi;
pub mod elf;
pub mod linux;
pub mod long_mode;
pub mod plc;
