//! Interrupts of devices.

use takt_abi::interrupt_controller::VECTORS;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::names::check_word;
use super::super::raw::{self, Keys};
use super::source::{PciFunction, check_function};
use super::{DeviceMemory, MemorySource, PortIo, Taken};

/// An interrupt of a device, and how a partition sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interrupt {
    /// What programs call it; unique in the partition. Without one, no program can wait for it.
    pub name: Option<String>,
    /// Unique in the partition, one of [`VECTORS`].
    pub vector: u8,
    /// Whose it is.
    pub source: InterruptSource,
}

/// A device that interrupts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InterruptSource {
    /// A PCI function, registers of which the partition has too.
    Pci(PciFunction),
    /// A device with a UIO driver, by its name in `/dev`.
    Uio(String),
}

impl InterruptSource {
    /// Whether it is this function.
    #[must_use]
    pub fn is_of(&self, function: &PciFunction) -> bool {
        matches!(self, InterruptSource::Pci(own) if own == function)
    }
}

/// Checks the entries of a partition that has these ports and this memory.
pub fn check(
    tables: &[Spanned<Keys<raw::Interrupt>>],
    partition: &str,
    ports: &[PortIo],
    memory: &[DeviceMemory],
    taken: &mut Taken,
) -> Result<Vec<Interrupt>, Diagnostic> {
    let mut entries: Vec<(Interrupt, [Span; 2])> = Vec::with_capacity(tables.len());
    for table in tables {
        let Keys(raw) = table.get_ref();
        let vector = check_vector(&raw.vector)?;
        let name = raw.name.as_ref().map(|name| check_word(name.get_ref(), name.span()));
        let name = name.transpose()?.map(str::to_owned);
        let (source, place) = check_source(raw, table, partition, taken)?;
        for (other, [other_vector, other_source]) in &entries {
            if let Some(name) = raw.name.as_ref().filter(|_| other.name == name) {
                let found = format!("two interrupts are named {}", quote(name.get_ref()));
                let allowed = "a name of its own for each in a partition";
                return Err(Diagnostic::new(name.span(), found, allowed)
                    .and(other_vector.clone(), "the other one"));
            }
            if other.vector == vector {
                let found = format!("the vector {vector} is given to two interrupts");
                let allowed = "a vector of its own for each in a partition";
                return Err(Diagnostic::new(raw.vector.span(), found, allowed)
                    .and(other_vector.clone(), "the other one"));
            }
            if other.source == source {
                let found = "the interrupt of this device has a vector already";
                let allowed = "one vector for each device";
                return Err(Diagnostic::new(place, found, allowed)
                    .and(other_source.clone(), "the other one"));
            }
        }
        if let InterruptSource::Pci(function) = &source {
            let of_memory = memory
                .iter()
                .any(|m| matches!(&m.source, MemorySource::Pci(bar) if bar.function == *function));
            let of_ports =
                ports.iter().filter_map(|p| p.bar.as_ref()).any(|bar| bar.function == *function);
            if !of_memory && !of_ports {
                let found = format!(
                    "{} has no register of {function}, and could not end its interrupt",
                    quote(partition)
                );
                let allowed = "a function of which a [[partition.mmio]] or [[partition.port_io]] of \
                               the same partition names a register";
                return Err(Diagnostic::new(place, found, allowed));
            }
        }
        entries.push((Interrupt { name, vector, source }, [raw.vector.span(), place]));
    }
    Ok(entries.into_iter().map(|(interrupt, _)| interrupt).collect())
}

fn check_vector(vector: &Spanned<i64>) -> Result<u8, Diagnostic> {
    let number = *vector.get_ref();
    u8::try_from(number).ok().filter(|vector| VECTORS.contains(vector)).ok_or_else(|| {
        let found = format!("{number} is not a vector for a device");
        let allowed = format!(
            "{} to {}: below are the processor's exceptions, and the last one is the controller's",
            VECTORS.start(),
            VECTORS.end()
        );
        Diagnostic::new(vector.span(), found, allowed)
    })
}

fn check_source(
    raw: &raw::Interrupt,
    table: &Spanned<Keys<raw::Interrupt>>,
    partition: &str,
    taken: &mut Taken,
) -> Result<(InterruptSource, Span), Diagnostic> {
    let allowed = "one of `pci` and `uio`";
    match (&raw.pci, &raw.uio) {
        (Some(pci), None) => {
            Ok((InterruptSource::Pci(check_function(pci, partition, taken)?), pci.span()))
        }
        (None, Some(uio)) => {
            let device = taken.uio(uio, partition)?;
            Ok((InterruptSource::Uio(device), uio.span()))
        }
        (None, None) => {
            Err(Diagnostic::new(table.span(), "which device it is is not said", allowed))
        }
        (Some(pci), Some(uio)) => {
            let found = "both `pci` and `uio` say which device it is";
            Err(Diagnostic::new(uio.span(), found, allowed).and(pci.span(), "the other one"))
        }
    }
}
