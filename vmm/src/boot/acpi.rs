//! What the Linux guest is told of its machine.
//!
//! Debian's cloud kernel has no support for the older multiprocessor table; without ACPI it would
//! run on the legacy interrupt controller and timer. The "hardware-reduced" form of ACPI
//! (specification 6.5, section 4.1) is the smallest that gives a Linux everything it needs here:
//! its processor and interrupt controllers, its serial port, and registers to switch off and
//! restart. It needs no system control interrupt, no fixed hardware and no firmware behind it.

use std::ops::RangeInclusive;

use acpi_tables::aml::{
    AddressSpace as Range, AddressSpaceCacheable, Device, EISAName, IO, Interrupt, Memory32Fixed,
    Method, Name, Notify, Package, Path, ResourceTemplate, Scope,
};
use acpi_tables::fadt::{FADTBuilder, Flags};
use acpi_tables::gas::{AccessSize, AddressSpace, GAS};
use acpi_tables::madt::{
    EnabledStatus, IoApic, LocalInterruptController, MADT, ProcessorLocalApic,
};
use acpi_tables::rsdp::Rsdp;
use acpi_tables::sdt::Sdt;
use acpi_tables::xsdt::XSDT;
use acpi_tables::{Aml, AmlSink, aml};
use takt_devices::pci::config_ports;
use takt_devices::power::AcpiPower;
use takt_devices::serial;
use takt_devices::virtio::registers;
use takt_devices::watchdog;
use takt_plan::linux_map::{ACPI_TABLES, IO_APIC, LOCAL_APIC};
use takt_plan::{DISKS_MAX, NETS_MAX};
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
/// That of the power button, the last pin: those between belong to virtio devices.
pub const POWER_BUTTON_GSI: u32 = 23;
const _: () = assert!(Slot((DISKS_MAX + NETS_MAX) as u32 - 1).gsi() < POWER_BUTTON_GSI);

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

/// What a machine has beyond what all have.
#[derive(Clone, Debug, Default)]
pub struct AcpiConfig {
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
    let watchdog = fittings.watchdog;
    let dsdt = put(&dsdt(fittings))?;
    let fadt = put(&fadt(dsdt))?;
    let madt = put(&madt())?;
    let mut xsdt = XSDT::new(OEM, MACHINE, REVISION);
    xsdt.add_entry(fadt);
    xsdt.add_entry(madt);
    if let Some(counts) = watchdog {
        xsdt.add_entry(put(&watchdog_table(counts))?);
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

fn madt() -> impl Aml {
    let mut madt = MADT::new(OEM, MACHINE, REVISION, LocalInterruptController::Address(LOCAL_APIC));
    madt.add_structure(ProcessorLocalApic::new(0, 0, EnabledStatus::Enabled));
    madt.add_structure(IoApic::new(0, IO_APIC, 0));
    madt
}

/// The watchdog, for the driver `wdat_wdt`: which registers do what ("Hardware Watchdog Timers
/// Design Specification", Microsoft 2006; numbers as in the kernel's `include/acpi/actbl3.h`).
fn watchdog_table(counts: u32) -> Sdt {
    const ENABLED: u32 = 1;
    /// In the place of a PCI function, segment first: the watchdog is none.
    const NO_FUNCTION: [u8; 8] = [0xff, 0, 0xff, 0xff, 0xff, 0, 0, 0];
    const READ: u8 = 0;
    const READ_COUNT: u8 = 1;
    const WRITE: u8 = 2;
    const WRITE_COUNT: u8 = 3;
    // Action, instruction, register, value.
    let entries = [
        // A heartbeat.
        (1, WRITE, watchdog::CONTROL, watchdog::SET),
        // What is left, what the time is, and another time.
        (4, READ_COUNT, watchdog::LEFT, 0),
        (5, READ_COUNT, watchdog::COUNT, 0),
        (6, WRITE_COUNT, watchdog::COUNT, 0),
        // Whether it runs, and to start it.
        (8, READ, watchdog::CONTROL, watchdog::SET),
        (9, WRITE, watchdog::CONTROL, watchdog::SET),
        // To stop it. It cannot be stopped, and a driver that fails to would keep others from
        // hearing of a restart; so what it gets is all the time once more.
        (11, WRITE, watchdog::CONTROL, watchdog::SET),
        // Whether the machine was restarted for its silence, and to forget it.
        (32, READ, watchdog::STATUS, watchdog::SET),
        (33, WRITE, watchdog::STATUS, 0),
    ];
    let header = 32_u32;
    let count = entries.len() as u32;
    let shortest = 1_u32;
    let mut table = Sdt::new(*b"WDAT", 36, 1, OEM, MACHINE, REVISION);
    table.append_slice(&header.to_le_bytes());
    table.append_slice(&NO_FUNCTION);
    for field in [watchdog::PERIOD_MS, counts, shortest, ENABLED, count] {
        table.append_slice(&field.to_le_bytes());
    }
    for (action, instruction, offset, value) in entries {
        let port = u64::from(WATCHDOG_PORT + offset);
        let register = GAS::new(AddressSpace::SystemIo, 32, 0, AccessSize::DwordAccess, port);
        let mut place = Vec::new();
        register.to_aml_bytes(&mut place);
        let mask = u32::MAX;
        table.append_slice(&[action, instruction, 0, 0]);
        table.append_slice(&place);
        table.append_slice(&value.to_le_bytes());
        table.append_slice(&mask.to_le_bytes());
    }
    table
}

/// The machine's description in ACPI's own byte code: how to switch off, the serial port, and the
/// PCI bus and the virtio devices, if there are any.
fn dsdt(AcpiConfig { pci, virtio, power_button, .. }: AcpiConfig) -> Sdt {
    let mut body = Vec::new();
    let off = AcpiPower::SOFT_OFF;
    Name::new(Path::new("_S5_"), &Package::new(vec![&off, &aml::ZERO, &aml::ZERO, &aml::ZERO]))
        .to_aml_bytes(&mut body);
    let hid = Name::new(Path::new("_HID"), &EISAName::new("PNP0501"));
    let uid = Name::new(Path::new("_UID"), &aml::ZERO);
    let interrupt = Interrupt::new(true, true, false, false, SERIAL_IRQ);
    let ports = IO::new(SERIAL_PORT, SERIAL_PORT, 0, serial::PORTS as u8);
    let resources = ResourceTemplate::new(vec![&interrupt, &ports]);
    let crs = Name::new(Path::new("_CRS"), &resources);
    let serial = Device::new(Path::new("COM1"), vec![&hid, &uid, &crs]);
    let bus = pci.map(PciBus);
    let virtio: Vec<Virtio> = (0..virtio).map(|slot| Virtio(Slot(slot))).collect();
    let mut devices: Vec<&dyn Aml> = vec![&serial];
    if let Some(bus) = &bus {
        devices.extend([&InterruptLink as &dyn Aml, bus]);
    }
    devices.extend(virtio.iter().map(|device| device as &dyn Aml));
    if power_button {
        devices.push(&PowerButton);
    }
    Scope::new(Path::new("_SB_"), devices).to_aml_bytes(&mut body);
    let mut table = Sdt::new(*b"DSDT", 36, 2, OEM, MACHINE, REVISION);
    table.append_slice(&body);
    table
}

/// What the PCI function's pin is wired to (ACPI 6.5, section 6.2.13).
///
/// A pin that is routed without a link is triggered by its level to Linux. This one is not, and only
/// a link can say so. It has one setting; Linux wants to have asked for it even so
/// (`drivers/acpi/pci_link.c`).
struct InterruptLink;

impl Aml for InterruptLink {
    fn to_aml_bytes(&self, sink: &mut dyn AmlSink) {
        let hid = Name::new(Path::new("_HID"), &EISAName::new("PNP0C0F"));
        let uid = Name::new(Path::new("_UID"), &aml::ZERO);
        let (edge, active_low, shared) = (true, false, false);
        let interrupt = Interrupt::new(true, edge, active_low, shared, PCI_GSI);
        let setting = ResourceTemplate::new(vec![&interrupt]);
        let [possible, current] = ["_PRS", "_CRS"].map(|name| Name::new(Path::new(name), &setting));
        let set = Method::new(Path::new("_SRS"), 1, false, Vec::new());
        let disable = Method::new(Path::new("_DIS"), 0, false, Vec::new());
        Device::new(Path::new("LNKA"), vec![&hid, &uid, &possible, &current, &set, &disable])
            .to_aml_bytes(sink);
    }
}

/// The root of the PCI bus (PCI Firmware Specification 3.3, section 4.1.3; ACPI 6.5, sections
/// 6.2.13 and 19.6.1), with the addresses that functions' memory may have. Linux takes what a
/// function already has if it lies in there.
struct PciBus(RangeInclusive<u32>);

impl Aml for PciBus {
    fn to_aml_bytes(&self, sink: &mut dyn AmlSink) {
        let hid = Name::new(Path::new("_HID"), &EISAName::new("PNP0A03"));
        let uid = Name::new(Path::new("_UID"), &aml::ZERO);
        let buses = Range::new_bus_number(0u16, 0);
        let ports = config_ports::LAST - config_ports::FIRST + 1;
        let ports = IO::new(config_ports::FIRST, config_ports::FIRST, 1, ports as u8);
        let Self(window) = self;
        let kind = AddressSpaceCacheable::NotCacheable;
        let memory = Range::new_memory(kind, true, *window.start(), *window.end(), None);
        let resources = ResourceTemplate::new(vec![&buses, &ports, &memory]);
        let crs = Name::new(Path::new("_CRS"), &resources);
        // Any function of the device (the low word), pin A, and the link that its interrupt comes by.
        let device = u32::from(config_ports::FUNCTION_DEVICE) << 16 | 0xffff;
        let link = Path::new("\\_SB_.LNKA");
        let pin_a = Package::new(vec![&device, &aml::ZERO, &link, &aml::ZERO]);
        let prt = Name::new(Path::new("_PRT"), &Package::new(vec![&pin_a]));
        Device::new(Path::new("PCI0"), vec![&hid, &uid, &crs, &prt]).to_aml_bytes(sink);
    }
}

/// A virtio device, whatever its kind: memory-mapped registers, for which ACPI has this name (kernel,
/// `drivers/virtio/virtio_mmio.c`), and an interrupt. It is an edge for each time that something was
/// added, as Linux takes it: its driver looks at all that is there.
struct Virtio(Slot);

impl Aml for Virtio {
    fn to_aml_bytes(&self, sink: &mut dyn AmlSink) {
        let Self(slot @ Slot(number)) = *self;
        let hid = Name::new(Path::new("_HID"), &"LNRO0005");
        let uid = Name::new(Path::new("_UID"), &number);
        let registers = Memory32Fixed::new(true, slot.registers(), registers::BYTES as u32);
        let interrupt = Interrupt::new(true, true, false, false, slot.gsi());
        let resources = ResourceTemplate::new(vec![&registers, &interrupt]);
        let crs = Name::new(Path::new("_CRS"), &resources);
        let name = format!("VIO{number:X}");
        Device::new(Path::new(&name), vec![&hid, &uid, &crs]).to_aml_bytes(sink);
    }
}

/// The power button, and the device that brings word of it: its interrupt has the button notified (ACPI 6.5,
/// sections 4.8.3.1.1 and 5.6.9).
struct PowerButton;

impl Aml for PowerButton {
    fn to_aml_bytes(&self, sink: &mut dyn AmlSink) {
        /// "S0 Power Button Pressed".
        const PRESSED: u8 = 0x80;
        let hid = Name::new(Path::new("_HID"), &EISAName::new("PNP0C0C"));
        Device::new(Path::new("PWRB"), vec![&hid]).to_aml_bytes(sink);
        let hid = Name::new(Path::new("_HID"), &"ACPI0013");
        let interrupt = Interrupt::new(true, true, false, false, POWER_BUTTON_GSI);
        let resources = ResourceTemplate::new(vec![&interrupt]);
        let crs = Name::new(Path::new("_CRS"), &resources);
        let button = Path::new("\\_SB_.PWRB");
        let notify = Notify::new(&button, &PRESSED);
        let event = Method::new(Path::new("_EVT"), 1, true, vec![&notify]);
        Device::new(Path::new("GED0"), vec![&hid, &crs, &event]).to_aml_bytes(sink);
    }
}

#[cfg(test)]
mod tests {
    use takt_plan::linux_map::{PCI_WINDOW, VIRTIO_REGISTERS};

    use super::*;

    fn dsdt_bytes(pci: Option<RangeInclusive<u32>>, virtio: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        dsdt(AcpiConfig { pci, virtio, ..AcpiConfig::default() }).to_aml_bytes(&mut bytes);
        bytes
    }

    fn contains(bytes: &[u8], part: &[u8]) -> bool {
        bytes.windows(part.len()).any(|window| window == part)
    }

    #[test]
    fn only_a_machine_with_a_function_has_a_pci_bus() {
        let without = dsdt_bytes(None, 0);
        let with = dsdt_bytes(Some(PCI_WINDOW), 0);
        for name in [b"PCI0", b"_PRT", b"LNKA"] {
            assert!(!contains(&without, name));
            assert!(contains(&with, name));
        }
        // Minimum and maximum of the memory descriptor.
        assert!(contains(&with, &[0, 0, 0, 0xd0, 0xff, 0xff, 0xff, 0xdf]));
        // The routing entry: device 1, pin A, the link.
        let mut entry = vec![4, 0x0c, 0xff, 0xff, 1, 0, 0];
        entry.extend_from_slice(b"\\._SB_LNKA\0");
        assert!(contains(&with, &entry));
        // Extended interrupt: consumer, edge, active high, exclusive, one of them, 16.
        assert!(contains(&with, &[0x89, 6, 0, 0b0011, 1, 16, 0, 0, 0]));
    }

    #[test]
    fn each_virtio_device_has_registers_and_an_interrupt_of_its_own() {
        let bytes = dsdt_bytes(None, 2);
        assert!(!contains(&dsdt_bytes(None, 0), b"LNRO0005"));
        for (name, registers, gsi) in [(b"VIO0", 0, 17), (b"VIO1", 0x1000, 18)] {
            assert!(contains(&bytes, name));
            let address = VIRTIO_REGISTERS + registers;
            let mut memory = vec![0x86, 9, 0, 1];
            memory.extend([address.to_le_bytes(), 0x1000u32.to_le_bytes()].concat());
            // Extended interrupt: consumer, edge, active high, exclusive.
            memory.extend([0x89, 6, 0, 0b0011, 1, gsi, 0, 0, 0]);
            assert!(contains(&bytes, &memory));
        }
        assert!(!contains(&bytes, b"VIO2"));
    }

    #[test]
    fn the_power_button_is_notified_by_an_interrupt_of_its_own() {
        let mut bytes = Vec::new();
        dsdt(AcpiConfig { power_button: true, ..AcpiConfig::default() }).to_aml_bytes(&mut bytes);
        for name in [&b"PWRB"[..], b"ACPI0013", b"_EVT", &[0x89, 6, 0, 0b0011, 1, 23, 0, 0, 0]] {
            assert!(contains(&bytes, name), "{name:?}");
            assert!(!contains(&dsdt_bytes(None, 4), name), "{name:?}");
        }
        // Notify, the button by its path, pressed.
        assert!(contains(&bytes, b"\x86\\._SB_PWRB\x0a\x80"));
    }

    #[test]
    fn the_watchdog_is_described_as_its_driver_reads_it() {
        let mut bytes = Vec::new();
        watchdog_table(500).to_aml_bytes(&mut bytes);
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        // Length of the header, no PCI function; period, most, least, flags, entries.
        assert_eq!((word(36), &bytes[40..45]), (32, &[0xff, 0, 0xff, 0xff, 0xff][..]));
        assert_eq!([48, 52, 56, 60, 64].map(word), [10, 500, 1, 1, 9]);
        assert_eq!(bytes.len(), 68 + 9 * 24);
        // The first: reset; by a write of a value to 32 bits of ports.
        assert_eq!(bytes[68..76], [1, 2, 0, 0, 1, 32, 0, 3]);
        assert_eq!([76, 80, 84, 88].map(word), [0x618, 0, 1, u32::MAX]);
    }

    #[test]
    fn every_table_has_its_signature_and_a_good_checksum() {
        let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), 1 << 20)]).unwrap();
        let fittings = AcpiConfig {
            pci: Some(PCI_WINDOW),
            virtio: 4,
            watchdog: Some(500),
            power_button: true,
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
        assert_eq!(check(long(fadt + 140)), b"DSDT");
        assert_eq!(check(long(xsdt + 52)), b"WDAT");
    }
}
