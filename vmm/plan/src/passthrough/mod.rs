//! What a PLC gets of the host's devices: the rules for one partition, and among partitions.
//!
//! A device that two partitions can write belongs to neither: what one of them has set, the other
//! may have changed. So no port, no physical page and no PCI function may be named in two
//! partitions, and both places are shown if one is. What only the host knows (where the ports of a
//! PCI function lie, how long its memory is) is looked at again when the file is run.
//!
//! - [`ports`]: ranges of I/O ports;
//! - [`memory`]: memory of devices;
//! - [`interrupts`]: their interrupts;
//! - [`platform`]: what the host itself runs on;
//! - [`source`]: which device it is, for all of these;
//! - [`safe_values`]: what is written when the partition ends.

mod interrupts;
mod memory;
mod platform;
mod ports;
pub mod safe_values;
mod source;

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::partition::Checked;
use super::raw::{self, Keys};

pub use interrupts::{Interrupt, InterruptSource};
pub use memory::{DeviceMemory, MemorySource};
pub use ports::PortIo;
pub use safe_values::{SafePlace, SafeValue};
pub use source::{Bar, PciFunction};

/// Most tables of each of the four kinds in a partition.
const TABLES_MAX: usize = 32;

/// What a partition gets of the host's devices.
#[derive(Clone, Debug, Default)]
pub struct Passthrough {
    /// Ranges of ports, none of which overlap.
    pub ports: Vec<PortIo>,
    /// Memory of devices, none of which overlap.
    pub memory: Vec<DeviceMemory>,
    /// What is written when the partition ends, in this order.
    pub safe_values: Vec<SafeValue>,
    /// Interrupts, no two of a device or of a vector.
    pub interrupts: Vec<Interrupt>,
}

/// Checks what each partition asks for, in the order of the file.
pub fn check(
    raw: &[Spanned<Keys<raw::Partition>>],
    partitions: &[Checked],
) -> Result<Vec<Passthrough>, Diagnostic> {
    let mut taken = Taken::default();
    let mut checked = Vec::with_capacity(raw.len());
    for (owner, table) in partitions.iter().zip(raw) {
        let Keys(raw) = table.get_ref();
        let name = &owner.partition.name;
        check_number(&raw.port_io.0, "port_io")?;
        check_number(&raw.mmio.0, "mmio")?;
        check_number(&raw.safe_value.0, "safe_value")?;
        check_number(&raw.interrupt.0, "interrupt")?;
        let ports = ports::check(&raw.port_io.0, name, &mut taken)?;
        let memory = memory::check(&raw.mmio.0, name, &mut taken)?;
        let safe_values = safe_values::check(&raw.safe_value.0, &ports, &memory)?;
        let interrupts = interrupts::check(&raw.interrupt.0, name, &ports, &memory, &mut taken)?;
        checked.push(Passthrough { ports, memory, safe_values, interrupts });
    }
    Ok(checked)
}

fn check_number<T>(tables: &[Spanned<Keys<T>>], name: &str) -> Result<(), Diagnostic> {
    let Some(excess) = tables.get(TABLES_MAX) else { return Ok(()) };
    let found = format!("this is table {} of {}", TABLES_MAX + 1, tables.len());
    let allowed = format!("at most {TABLES_MAX} tables [[partition.{name}]] in a partition");
    Err(Diagnostic::new(excess.span(), found, allowed))
}

/// What of the host's has been given to a partition, by the place that asks for it.
#[derive(Default)]
struct Taken {
    ports: Vec<Owned>,
    /// Host-physical addresses.
    memory: Vec<Owned>,
    /// By name.
    devices: Vec<(String, String, Span)>,
    /// Functions that master the bus, and which key lets them.
    masters: Vec<(PciFunction, &'static str, Span)>,
}

/// A range of numbers, both ends included.
struct Owned {
    range: [u64; 2],
    partition: String,
    place: Span,
}

/// Adds a range, unless it meets one that is there.
fn take(
    taken: &mut Vec<Owned>,
    range: [u64; 2],
    partition: &str,
    place: Span,
    [one, several]: [&str; 2],
) -> Result<(), Diagnostic> {
    let meets = |other: &&Owned| range[0] <= other.range[1] && other.range[0] <= range[1];
    if let Some(other) = taken.iter().find(meets) {
        let (first, last) = (range[0].max(other.range[0]), range[1].min(other.range[1]));
        let what = if first == last {
            format!("the {one} {first:#x} is")
        } else {
            format!("the {several} {first:#x} to {last:#x} are")
        };
        let found = if other.partition == partition {
            format!("{what} given to {} twice", quote(partition))
        } else {
            let owners = [&other.partition, partition].map(quote);
            format!("{what} given to both {} and {}", owners[0], owners[1])
        };
        let allowed = "each part of the host in one place of one partition";
        return Err(
            Diagnostic::new(place, found, allowed).and(other.place.clone(), "the other place")
        );
    }
    taken.push(Owned { range, partition: partition.to_owned(), place });
    Ok(())
}

impl Taken {
    /// Gives a device to a partition, which may have it already.
    fn device(&mut self, name: &str, partition: &str, place: Span) -> Result<(), Diagnostic> {
        let other =
            self.devices.iter().find(|(device, owner, _)| device == name && owner != partition);
        if let Some((_, owner, there)) = other {
            let owners = [owner, partition].map(quote);
            let found = format!("{name} is given to both {} and {}", owners[0], owners[1]);
            let allowed = "a device in one partition only";
            return Err(
                Diagnostic::new(place, found, allowed).and(there.clone(), "the other place")
            );
        }
        self.devices.push((name.to_owned(), partition.to_owned(), place));
        Ok(())
    }

    /// Lets a function master the bus, by one key and no other.
    fn masters_bus(
        &mut self,
        function: &PciFunction,
        key: &'static str,
        place: Span,
    ) -> Result<(), Diagnostic> {
        let other = self.masters.iter().find(|(f, other, _)| f == function && *other != key);
        if let Some((_, other, there)) = other {
            let found = format!("{function} has both `{key}` and `{other}`");
            let allowed = "`vfio = true`, if it is to reach the memory of its partition, or \
                           `trusted_dma = true`, if it may reach all memory of the machine";
            return Err(Diagnostic::new(place, found, allowed).and(there.clone(), "the other one"));
        }
        self.masters.push((function.clone(), key, place));
        Ok(())
    }

    /// Gives a UIO device to a partition, which may have it already.
    fn uio(&mut self, uio: &Spanned<String>, partition: &str) -> Result<String, Diagnostic> {
        let device = uio.get_ref();
        let number = device.strip_prefix("uio").unwrap_or_default();
        if !(1..=4).contains(&number.len()) || !number.bytes().all(|d| d.is_ascii_digit()) {
            let found = format!("{} is not a UIO device", quote(device));
            return Err(Diagnostic::new(uio.span(), found, "a name in /dev, such as \"uio0\""));
        }
        self.device(&format!("the UIO device {device}"), partition, uio.span())?;
        Ok(device.clone())
    }
}

/// A number as it is written for addresses, ports and values: `0x` and hexadecimal digits, in
/// quotes.
fn hex(text: &str) -> Option<u64> {
    let digits = text.strip_prefix("0x")?;
    // Rust's own parser would take a sign.
    let good = (1..=16).contains(&digits.len()) && digits.bytes().all(|d| d.is_ascii_hexdigit());
    if good { u64::from_str_radix(digits, 16).ok() } else { None }
}

pub fn check_hex(text: &Spanned<String>, what: &str, example: &str) -> Result<u64, Diagnostic> {
    hex(text.get_ref()).ok_or_else(|| {
        let found = format!("{} is not {what}", quote(text.get_ref()));
        let allowed = format!("0x and at most 16 hexadecimal digits, such as {example:?}");
        Diagnostic::new(text.span(), found, allowed)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hexadecimal_number_has_its_prefix_and_digits_only() {
        assert_eq!(hex("0x378"), Some(0x378));
        assert_eq!(hex("0xFFFFffffFFFFffff"), Some(u64::MAX));
        for bad in ["", "0x", "378", "0X378", "0x+1", "0x-1", "0x 1", "0x1g", "0x00000000000000001"]
        {
            assert_eq!(hex(bad), None, "{bad}");
        }
    }
}
