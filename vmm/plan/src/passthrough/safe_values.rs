//! What is written to the outputs of a partition when it ends.

use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::raw::{self, Keys};
use super::{DeviceMemory, PortIo, check_hex};

/// A value, and where it is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SafeValue {
    /// Where.
    pub place: SafePlace,
    /// With an access of so many bytes: 1, 2 or 4.
    pub width: u8,
    /// What; it fits the width.
    pub value: u32,
}

/// Where a safe value is written: wholly inside something that the partition has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SafePlace {
    /// To a port, by its number in the guest.
    Port(u16),
    /// To a register.
    Register {
        /// In which [`DeviceMemory`] of the partition, by its place in the list.
        memory: usize,
        /// At which byte of it, a multiple of the width.
        offset: u64,
    },
}

/// Checks the values of a partition that has these ports and this memory.
pub fn check(
    tables: &[Spanned<Keys<raw::SafeValue>>],
    ports: &[PortIo],
    memory: &[DeviceMemory],
) -> Result<Vec<SafeValue>, Diagnostic> {
    tables.iter().map(|table| check_one(table, ports, memory)).collect()
}

fn check_one(
    table: &Spanned<Keys<raw::SafeValue>>,
    ports: &[PortIo],
    memory: &[DeviceMemory],
) -> Result<SafeValue, Diagnostic> {
    let Keys(raw) = table.get_ref();
    let width = match *raw.width.get_ref() {
        1 => 1,
        2 => 2,
        4 => 4,
        other => {
            let found = format!("an access of {other} bytes is not possible");
            return Err(Diagnostic::new(raw.width.span(), found, "1, 2 or 4"));
        }
    };
    let place = match (&raw.port, &raw.mmio) {
        (Some(port), None) => {
            check_no_offset(raw)?;
            SafePlace::Port(check_port(port, width, ports)?)
        }
        (None, Some(name)) => {
            let offset = raw.offset.as_ref();
            let (memory, offset) = check_register(name, offset, &table.span(), width, memory)?;
            SafePlace::Register { memory, offset }
        }
        (Some(port), Some(mmio)) => {
            let found = "both `port` and `mmio` say where the value is written";
            return Err(Diagnostic::new(mmio.span(), found, "one of them")
                .and(port.span(), "the other one"));
        }
        (None, None) => {
            let found = "where the value is written is not said";
            let allowed = "`port = \"0x378\"`, or `mmio = \"a-name\"` with `offset = \"0x0\"`";
            return Err(Diagnostic::new(table.span(), found, allowed));
        }
    };
    let value = check_hex(&raw.value, "a value", "0x00")?;
    let largest = u64::from(u32::MAX) >> (32 - 8 * u32::from(width));
    if value > largest {
        let found = format!("{value:#x} does not fit an access of {}", bytes(width));
        return Err(Diagnostic::new(raw.value.span(), found, format!("at most {largest:#x}"))
            .and(raw.width.span(), "its width"));
    }
    Ok(SafeValue { place, width, value: value as u32 })
}

fn check_no_offset(raw: &raw::SafeValue) -> Result<(), Diagnostic> {
    let Some(offset) = &raw.offset else { return Ok(()) };
    let found = "`offset` is about a register, and there is no key `mmio`";
    let allowed = "`mmio = \"a-name\"` instead of `port`, or no `offset`";
    Err(Diagnostic::new(offset.span(), found, allowed))
}

/// A port that the partition has, for an access of so many bytes.
pub fn check_port(port: &Spanned<String>, width: u8, ports: &[PortIo]) -> Result<u16, Diagnostic> {
    let first = check_hex(port, "an I/O port", "0x378")?;
    let last = first.saturating_add(u64::from(width) - 1);
    let holds = |r: &&PortIo| u64::from(r.first) <= first && last <= u64::from(r.last);
    match (u16::try_from(first), ports.iter().find(holds)) {
        (Ok(first), Some(_)) => Ok(first),
        _ => {
            let found = format!(
                "an access of {} at port {first:#x} is not wholly the partition's",
                bytes(width)
            );
            let allowed = match ports {
                [] => "ports of a [[partition.port_io]] of the same partition".to_owned(),
                _ => {
                    let ranges = ports.iter().map(|r| format!("{:#x}-{:#x}", r.first, r.last));
                    format!("ports of {}", ranges.collect::<Vec<_>>().join(", "))
                }
            };
            Err(Diagnostic::new(port.span(), found, allowed))
        }
    }
}

/// A register in the memory of a device that the partition has, for an access of so many bytes: in which memory, and at
/// which byte of it.
pub fn check_register(
    name: &Spanned<String>,
    offset: Option<&Spanned<String>>,
    table: &Span,
    width: u8,
    memory: &[DeviceMemory],
) -> Result<(usize, u64), Diagnostic> {
    let Some(index) = memory.iter().position(|entry| entry.name == *name.get_ref()) else {
        let found = format!("the partition has no device memory {}", quote(name.get_ref()));
        let names: Vec<String> = memory.iter().map(|entry| quote(&entry.name)).collect();
        let allowed = match &names[..] {
            [] => "the name of a [[partition.mmio]] of the same partition".to_owned(),
            names => names.join(", "),
        };
        return Err(Diagnostic::new(name.span(), found, allowed));
    };
    let Some(text) = offset else {
        let found = format!("which register of {} is not said", quote(name.get_ref()));
        let allowed = "`offset = \"0x0\"`, counted from the start of that memory";
        return Err(Diagnostic::new(table.clone(), found, allowed));
    };
    let offset = check_hex(text, "an offset", "0x0")?;
    let last = memory[index].bytes - u64::from(width);
    if offset > last || !offset.is_multiple_of(width.into()) {
        let found = format!("there is no register of {} at {offset:#x}", bytes(width));
        let allowed = format!("a multiple of {width}, at most {last:#x}");
        return Err(Diagnostic::new(text.span(), found, allowed));
    }
    Ok((index, offset))
}

fn bytes(width: u8) -> String {
    format!("{width} byte{}", if width == 1 { "" } else { "s" })
}
