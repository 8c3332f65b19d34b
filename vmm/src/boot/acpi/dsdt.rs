//! The devices of the machine, in ACPI's own byte code.

use std::ops::RangeInclusive;

use acpi_tables::aml::{
    AddressSpace as Range, AddressSpaceCacheable, Device, EISAName, IO, Interrupt, Memory32Fixed,
    Method, Name, Notify, Package, Path, ResourceTemplate, Scope,
};
use acpi_tables::sdt::Sdt;
use acpi_tables::{Aml, AmlSink, aml};
use takt_devices::pci::config_ports;
use takt_devices::power::AcpiPower;
use takt_devices::serial;
use takt_devices::virtio::page;

use super::{
    AcpiConfig, MACHINE, OEM, PCI_GSI, POWER_BUTTON_GSI, REVISION, SERIAL_IRQ, SERIAL_PORT,
};
use crate::virtio::Slot;

/// How to switch off, the serial port, and the PCI bus and the virtio devices, if there are any.
pub(super) fn table(AcpiConfig { pci, virtio, power_button, .. }: AcpiConfig) -> Sdt {
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
        let registers = Memory32Fixed::new(true, slot.registers(), page::BYTES as u32);
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
    use takt_plan::linux_map::{PCI_WINDOW, VIRTIO_MAX, VIRTIO_REGISTERS};

    use super::*;

    fn dsdt_bytes(pci: Option<RangeInclusive<u32>>, virtio: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        table(AcpiConfig { pci, virtio, ..AcpiConfig::default() }).to_aml_bytes(&mut bytes);
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
        // The last of as many as there can be has the last pin.
        let last = dsdt_bytes(None, VIRTIO_MAX as u32);
        assert!(contains(&last, &[0x89, 6, 0, 0b0011, 1, 23, 0, 0, 0]));
    }

    #[test]
    fn the_power_button_is_notified_by_an_interrupt_of_its_own() {
        let mut bytes = Vec::new();
        table(AcpiConfig { power_button: true, ..AcpiConfig::default() }).to_aml_bytes(&mut bytes);
        for name in [&b"PWRB"[..], b"ACPI0013", b"_EVT", &[0x89, 6, 0, 0b0011, 1, 5, 0, 0, 0]] {
            assert!(contains(&bytes, name), "{name:?}");
            assert!(!contains(&dsdt_bytes(None, 4), name), "{name:?}");
        }
        // Notify, the button by its path, pressed.
        assert!(contains(&bytes, b"\x86\\._SB_PWRB\x0a\x80"));
    }
}
