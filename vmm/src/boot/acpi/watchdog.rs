//! The table by which the driver `wdat_wdt` finds the watchdog.

use acpi_tables::Aml;
use acpi_tables::gas::{AccessSize, AddressSpace, GAS};
use acpi_tables::sdt::Sdt;
use takt_devices::watchdog;

use super::{MACHINE, OEM, REVISION, WATCHDOG_PORT};

/// Which registers do what ("Hardware Watchdog Timers
/// Design Specification", Microsoft 2006; numbers as in the kernel's `include/acpi/actbl3.h`).
pub(super) fn table(counts: u32) -> Sdt {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_is_described_as_its_driver_reads_it() {
        let mut bytes = Vec::new();
        table(500).to_aml_bytes(&mut bytes);
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        // Length of the header, no PCI function; period, most, least, flags, entries.
        assert_eq!((word(36), &bytes[40..45]), (32, &[0xff, 0, 0xff, 0xff, 0xff][..]));
        assert_eq!([48, 52, 56, 60, 64].map(word), [10, 500, 1, 1, 9]);
        assert_eq!(bytes.len(), 68 + 9 * 24);
        // The first: reset; by a write of a value to 32 bits of ports.
        assert_eq!(bytes[68..76], [1, 2, 0, 0, 1, 32, 0, 3]);
        assert_eq!([76, 80, 84, 88].map(word), [0x618, 0, 1, u32::MAX]);
    }
}
