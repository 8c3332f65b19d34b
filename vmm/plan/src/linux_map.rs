//! Where everything lies in the address space of a Linux guest.
//!
//! | address | what |
//! | --- | --- |
//! | `0x0000_0000` | RAM; at the start of Linux, its first tables and stack, below `0x1_0000` |
//! | `0x0002_0000` | command line |
//! | `0x0007_0000` | boot parameters |
//! | `0x0009_fc00` | end of conventional memory; a PC has its extended BIOS data and video here |
//! | `0x000e_0000` | ACPI tables |
//! | `0x000f_fff0` | all the firmware there is: a restart |
//! | `0x0010_0000` | RAM: the kernel here or where it prefers, the initial RAM disk at the end of low memory |
//! | `0xc000_0000` | end of RAM below 4 GiB; devices |
//! | `0xd000_0000` | memory of PCI functions |
//! | `0xe000_0000` | registers of disks, network interfaces and the socket device |
//! | `0xfec0_0000` | I/O APIC, of KVM |
//! | `0xfee0_0000` | local APIC, of KVM |
//! | `0xfffb_d000` | three pages that KVM needs on Intel processors |
//! | `0x1_0000_0000` | RAM goes on |
//!
//! No device lies where a PLC guest has its channels, so the address of a port tells of which kind of guest
//! it is.

use std::ops::RangeInclusive;

use crate::{DISKS_MAX, NETS_MAX};

/// The command line of the kernel.
pub const COMMAND_LINE: u64 = 0x2_0000;
/// The boot parameters (`Documentation/arch/x86/boot.rst`).
pub const BOOT_PARAMETERS: u64 = 0x7_0000;
/// End of conventional memory: above it lie what a PC calls the extended BIOS data and video.
pub const LOW_RAM_END: u64 = 0x9_fc00;
/// The ACPI tables, in the area in which a PC's firmware keeps them.
pub const ACPI_TABLES: u64 = 0xe_0000;
/// Where a PC's processor starts, and where a Linux on hardware-reduced ACPI jumps in real mode to
/// restart: it tries neither the reset register nor the keyboard controller before
/// (`arch/x86/kernel/reboot.c`, `efi_reboot_required`).
pub const RESTART_VECTOR: u64 = 0xf_fff0;
/// RAM above what a PC keeps for its firmware and video. A kernel lies here or above.
pub const HIGH_RAM_START: u64 = 0x10_0000;
/// End of the RAM below 4 GiB: from here to [`HOLE_END`] lie devices.
pub const HOLE_START: u64 = 0xc000_0000;
/// Memory of PCI functions.
pub const PCI_WINDOW: RangeInclusive<u32> = 0xd000_0000..=0xdfff_ffff;
/// Registers of the first virtio device; those of the others follow: first the disks, then the network
/// interfaces, then the socket device.
pub const VIRTIO_REGISTERS: u32 = 0xe000_0000;
/// Most virtio devices: disks, network interfaces and a socket device.
pub const VIRTIO_MAX: usize = DISKS_MAX + NETS_MAX + 1;
/// Where KVM's I/O APIC answers.
pub const IO_APIC: u32 = 0xfec0_0000;
/// Where KVM's local APIC answers.
pub const LOCAL_APIC: u32 = 0xfee0_0000;
/// Three pages that KVM needs on Intel processors (`KVM_SET_TSS_ADDR`).
pub const TASK_STATE_SEGMENT: u64 = 0xfffb_d000;
/// Where RAM goes on, above the devices.
pub const HOLE_END: u64 = 1 << 32;

#[cfg(test)]
mod tests {
    use takt_abi::memory::{CHANNELS, CHANNELS_END, PAGE};

    use super::*;
    use crate::values::CMDLINE_MAX;

    /// Whatever has a place, in the order of the table.
    fn areas() -> Vec<(u64, u64)> {
        let virtio = VIRTIO_MAX as u64 * PAGE;
        let registers = u64::from(VIRTIO_REGISTERS);
        vec![
            (0, 0x1_0000),
            (COMMAND_LINE, COMMAND_LINE + CMDLINE_MAX as u64 + 1),
            (BOOT_PARAMETERS, BOOT_PARAMETERS + PAGE),
            (ACPI_TABLES, RESTART_VECTOR),
            (RESTART_VECTOR, HIGH_RAM_START),
            (HIGH_RAM_START, HOLE_START),
            ((*PCI_WINDOW.start()).into(), u64::from(*PCI_WINDOW.end()) + 1),
            (registers, registers + virtio),
            (IO_APIC.into(), u64::from(IO_APIC) + PAGE),
            (LOCAL_APIC.into(), u64::from(LOCAL_APIC) + PAGE),
            (TASK_STATE_SEGMENT, TASK_STATE_SEGMENT + 3 * PAGE),
            (HOLE_END, u64::MAX),
        ]
    }

    #[test]
    fn nothing_overlaps() {
        let areas = areas();
        for pair in areas.windows(2) {
            assert!(pair[0].1 <= pair[1].0, "{:#x?}", pair);
        }
        assert!(areas.iter().all(|(start, end)| start < end));
        const { assert!(BOOT_PARAMETERS + PAGE <= LOW_RAM_END) };
    }

    #[test]
    fn no_device_lies_where_a_plc_has_its_channels() {
        let devices =
            areas().into_iter().filter(|(start, _)| (HOLE_START..HOLE_END).contains(start));
        for (start, end) in devices {
            assert!(end <= CHANNELS || CHANNELS_END <= start, "{start:#x}");
        }
    }
}
