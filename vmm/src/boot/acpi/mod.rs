//! What the Linux guest is told of its machine.
//!
//! Debian's cloud kernel has no support for the older multiprocessor table; without ACPI it would
//! run on the legacy interrupt controller and timer. The "hardware-reduced" form of ACPI
//! (specification 6.5, section 4.1) is the smallest that gives a Linux everything it needs here:
//! its processor and interrupt controllers, its serial port, and registers to switch off and
//! restart. It needs no system control interrupt, no fixed hardware and no firmware behind it.

mod dsdt;
mod watchdog;

use std::ops::RangeInclusive;

use acpi_tables::Aml;
use acpi_tables::fadt::{FADTBuilder, Flags};
use acpi_tables::gas::{AccessSize, AddressSpace, GAS};
use acpi_tables::madt::{
    EnabledStatus, IoApic, LocalInterruptController, MADT, ProcessorLocalApic,
};
use acpi_tables::rsdp::Rsdp;
use acpi_tables::xsdt::XSDT;
use takt_devices::power::AcpiPower;
use takt_plan::linux_map::{ACPI_TABLES, IO_APIC, LOCAL_APIC, VIRTIO_MAX};
use vm_memory::{Bytes, GuestAddress, GuestMemoryError, GuestMemoryMmap};

use crate::virtio::Slot;

/// First port of the ACPI power registers.
pub const POWER_PORT: u16 = 0x600;
/// First port of the watchdog, if there is one.
pub const WATCHDOG_PORT: u16 = 0x610;
/// First port of the serial console, a PC's COM1.
pub const SERIAL_PORT: u16 = 0x3f8;
/// Its interrupt.
pub const SERIAL_IRQ: u32 = 4;
/// The interrupt of the PCI function: the first pin of the I/O APIC beyond those of the ISA bus.
pub const PCI_GSI: u32 = 16;
/// The last pin: those behind that of the PCI function belong to virtio devices.
const LAST_GSI: u32 = 23;
const _: () = assert!(Slot(VIRTIO_MAX as u32 - 1).gsi() <= LAST_GSI);
/// That of the power button, of the ISA bus.
pub const POWER_BUTTON_GSI: u32 = 5;

const OEM: [u8; 6] = *b"TAKT  ";
const MACHINE: [u8; 8] = *b"TAKTLINX";
const REVISION: u32 = 1;

/// Boot architecture flags of the FADT: what a PC would have and this machine does not.
mod absent {
    pub const VGA: u16 = 1 << 2;
    pub const MSI: u16 = 1 << 3;
    pub const ASPM: u16 = 1 << 4;
    pub const CMOS_CLOCK: u16 = 1 << 5;
}

/// What machines differ in.
#[derive(Clone, Debug, Default)]
pub struct AcpiConfig {
    /// How many processors there are.
    pub processors: usize,
    /// Where the memory of PCI functions may lie, if there is a PCI bus.
    pub pci: Option<RangeInclusive<u32>>,
    /// How many virtio devices there are.
    pub virtio: u32,
    /// Whether there is a power button.
    pub power_button: bool,
    /// The longest time of the watchdog, in counts, if there is one.
    pub watchdog: Option<u32>,
}

/// Writes the tables to guest memory; returns the address of the first, for the boot parameters.
///
/// # Errors
/// If the guest has no memory there.
pub fn write(memory: &GuestMemoryMmap, fittings: AcpiConfig) -> Result<u64, GuestMemoryError> {
    let mut next = ACPI_TABLES + 64;
    let mut put = |table: &dyn Aml| {
        let mut bytes = Vec::new();
        table.to_aml_bytes(&mut bytes);
        let at = next;
        memory.write_slice(&bytes, GuestAddress(at))?;
        next = (at + bytes.len() as u64).next_multiple_of(64);
        Ok::<u64, GuestMemoryError>(at)
    };
    let AcpiConfig { watchdog, processors, .. } = fittings;
    let dsdt = put(&dsdt::table(fittings))?;
    let fadt = put(&fadt(dsdt))?;
    let madt = put(&madt(processors))?;
    let mut xsdt = XSDT::new(OEM, MACHINE, REVISION);
    xsdt.add_entry(fadt);
    xsdt.add_entry(madt);
    if let Some(counts) = watchdog {
        xsdt.add_entry(put(&watchdog::table(counts))?);
    }
    let xsdt = put(&xsdt)?;
    let mut rsdp = Vec::new();
    Rsdp::new(OEM, xsdt).to_aml_bytes(&mut rsdp);
    memory.write_slice(&rsdp, GuestAddress(ACPI_TABLES))?;
    Ok(ACPI_TABLES)
}

fn fadt(dsdt: u64) -> impl Aml {
    let register = |offset: u16| {
        let port = u64::from(POWER_PORT + offset);
        GAS::new(AddressSpace::SystemIo, 8, 0, AccessSize::ByteAccess, port)
    };
    let mut fadt = FADTBuilder::new(OEM, MACHINE, REVISION)
        .dsdt_64(dsdt)
        .flag(Flags::HwReducedAcpi)
        .flag(Flags::ResetRegSup);
    // The flag for a keyboard controller is not set: Linux would look half a second for one. Its
    // reset line is used without it.
    fadt.iapc_boot_arch = (absent::VGA | absent::MSI | absent::ASPM | absent::CMOS_CLOCK).into();
    fadt.sleep_control_reg = register(AcpiPower::SLEEP_CONTROL);
    fadt.sleep_status_reg = register(AcpiPower::SLEEP_STATUS);
    fadt.reset_reg = register(AcpiPower::RESET);
    fadt.reset_value = AcpiPower::RESET_VALUE;
    fadt.finalize()
}

/// All processors are there from the start. None can be added: none is described that is not enabled, and no device that
/// would tell of one.
fn madt(processors: usize) -> impl Aml {
    let mut madt = MADT::new(OEM, MACHINE, REVISION, LocalInterruptController::Address(LOCAL_APIC));
    for number in 0..processors as u8 {
        madt.add_structure(ProcessorLocalApic::new(number, number, EnabledStatus::Enabled));
    }
    madt.add_structure(IoApic::new(0, IO_APIC, 0));
    madt
}

#[cfg(test)]
mod tests {
    use takt_plan::linux_map::PCI_WINDOW;

    use super::*;

    #[test]
    fn every_table_has_its_signature_and_a_good_checksum() {
        let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), 1 << 20)]).unwrap();
        let fittings = AcpiConfig {
            pci: Some(PCI_WINDOW),
            virtio: 4,
            watchdog: Some(500),
            power_button: true,
            processors: 3,
        };
        let rsdp = write(&memory, fittings).unwrap();
        let word = |at| memory.read_obj::<u32>(GuestAddress(at)).unwrap();
        let long = |at| memory.read_obj::<u64>(GuestAddress(at)).unwrap();
        let check = |at: u64| {
            let mut bytes = vec![0; word(at + 4) as usize];
            memory.read_slice(&mut bytes, GuestAddress(at)).unwrap();
            assert_eq!(bytes.iter().fold(0u8, |sum, b| sum.wrapping_add(*b)), 0);
            bytes[..4].to_vec()
        };
        let xsdt = long(rsdp + 24);
        assert_eq!(check(xsdt), b"XSDT");
        let (fadt, madt) = (long(xsdt + 36), long(xsdt + 44));
        assert_eq!(check(fadt), b"FACP");
        assert_eq!(check(madt), b"APIC");
        // Each is one of 8 bytes: its number in ACPI, that of its controller, enabled and not only to be enabled.
        for number in 0..3 {
            let mut entry = [0; 8];
            memory.read_slice(&mut entry, GuestAddress(madt + 44 + 8 * number)).unwrap();
            assert_eq!(entry, [0, 8, number as u8, number as u8, 1, 0, 0, 0]);
        }
        assert_eq!(word(madt + 44 + 24) & 0xffff, 0x0c01, "the I/O APIC");
        assert_eq!(check(long(fadt + 140)), b"DSDT");
        assert_eq!(check(long(xsdt + 52)), b"WDAT");
    }
}
