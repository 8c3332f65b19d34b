//! The guest's own page tables: each part of the image with the rights it needs and no more.
//!
//! The VMM starts a guest with everything writable and executable, which is enough to run but
//! turns every programming error into silent damage. Here only a few things are mapped: the image
//! (code read-execute, constants read-only, the rest read-write), the pages shared with
//! the host, those of the channels, of which only its own are writable, and the area in which the
//! memory of devices lies. Everything else faults, above all address 0, the VMM's start-up
//! structures, and the page below each stack.
//!
//! The tables are identity maps of the first 2 MiB and of the first 2 MiB at
//! [`memory::INFORMATION`], in 4 KiB pages: six tables, filled once, static. Larger pages would
//! save nothing, since an image is well below 1 MiB and protection needs the fine grain.
//!
//! The devices' area is mapped whole, in pages of 2 MiB, and uncached: the processor may neither
//! keep a register's value nor read one ahead of the program. What in it is a device only the
//! partition file says, and the host keeps to that: an access elsewhere is refused there and
//! counted. A list of devices in the interface would turn it into an exception, which is not worth
//! a list.
//!
//! Table formats: AMD64 Architecture Programmer's Manual, volume 2, section 5.3.

use core::ops::Range;
use takt_abi::{Port, memory};

const PRESENT: u64 = 1;
const WRITABLE: u64 = 1 << 1;
/// "Cache disable" and "write-through": entry 3 of the page attribute table, which is "uncached"
/// after a reset (AMD64 volume 2, section 7.8).
const UNCACHED: u64 = 1 << 4 | 1 << 3;
/// In a directory: the entry is a page of 2 MiB.
const LARGE: u64 = 1 << 7;
const LARGE_PAGE: usize = 2 << 20;
const NO_EXECUTE: u64 = 1 << 63;
const ENTRIES: usize = 512;

const _: () = {
    assert!(size_of::<Tables>() == 6 * memory::PAGE as usize);
    // All shared pages are in one page table.
    assert!(memory::INFORMATION >> 21 == (memory::CHANNELS_END - 1) >> 21);
    assert!(memory::INFORMATION >> 39 == 0);
    // The devices are in the same directory as those.
    assert!(memory::INFORMATION >> 30 == (memory::DEVICES_END - 1) >> 30);
    assert!(
        memory::DEVICES.is_multiple_of(LARGE_PAGE as u64)
            && memory::CHANNELS_END <= memory::DEVICES
    );
};

/// Where the parts of an image lie. All addresses are multiples of [`memory::PAGE`], and all of
/// the image is in the first 2 MiB (checked by the linker script).
#[derive(Debug)]
pub struct Layout<'a> {
    /// Code: read and execute.
    pub text: Range<u64>,
    /// Constants: read only.
    pub rodata: Range<u64>,
    /// Variables and stacks: read and write.
    pub data: Range<u64>,
    /// Pages within `data` that must not be mapped: one below each stack.
    pub guards: &'a [u64],
    /// The ends of channels that the guest has. What does not lie in the area for channels is not
    /// mapped.
    pub ports: &'a [Port],
}

type Table = [u64; ENTRIES];

/// The tables. They must lie in memory whose virtual and physical addresses are the same.
#[repr(C, align(4096))]
pub struct Tables {
    root: Table,
    pointers: Table,
    image_directory: Table,
    image: Table,
    shared_directory: Table,
    shared: Table,
}

impl Tables {
    /// Tables that map nothing.
    #[must_use]
    pub const fn empty() -> Self {
        Self {
            root: [0; ENTRIES],
            pointers: [0; ENTRIES],
            image_directory: [0; ENTRIES],
            image: [0; ENTRIES],
            shared_directory: [0; ENTRIES],
            shared: [0; ENTRIES],
        }
    }

    /// Fills the tables for an image. Returns the physical address of the root, for CR3.
    pub fn build(&mut self, layout: &Layout) -> u64 {
        let inner = PRESENT | WRITABLE;
        let shared = memory::INFORMATION;
        self.root[0] = address(&self.pointers) | inner;
        self.pointers[0] = address(&self.image_directory) | inner;
        self.pointers[index(shared, 30)] = address(&self.shared_directory) | inner;
        self.image_directory[0] = address(&self.image) | inner;
        self.shared_directory[index(shared, 21)] = address(&self.shared) | inner;

        self.map_image(&layout.text, PRESENT);
        self.map_image(&layout.rodata, PRESENT | NO_EXECUTE);
        self.map_image(&layout.data, PRESENT | WRITABLE | NO_EXECUTE);
        for guard in layout.guards {
            self.image[index(*guard, 12)] = 0;
        }
        self.shared[index(memory::INFORMATION, 12)] = memory::INFORMATION | PRESENT | NO_EXECUTE;
        self.shared[index(memory::STATUS, 12)] = memory::STATUS | PRESENT | WRITABLE | NO_EXECUTE;
        self.map_shared(memory::PORT_TABLE, 1, 0);
        self.map_shared(memory::PROGRAM_TABLE, 1, 0);
        self.map_shared(memory::IO_TABLE, memory::IO_TABLE_PAGES as u32, 0);
        for port in layout.ports {
            self.map_shared(port.own, port.own_pages, WRITABLE);
            self.map_shared(port.peer, port.peer_pages, 0);
        }
        for page in (memory::DEVICES..memory::DEVICES_END).step_by(LARGE_PAGE) {
            self.shared_directory[index(page, 21)] =
                page | PRESENT | WRITABLE | UNCACHED | LARGE | NO_EXECUTE;
        }
        address(&self.root)
    }

    fn map_shared(&mut self, start: u64, pages: u32, rights: u64) {
        let area = memory::PORT_TABLE..memory::CHANNELS_END;
        let all = (start..).step_by(memory::PAGE as usize).take(pages as usize);
        for page in all.filter(|page| area.contains(page)) {
            self.shared[index(page, 12)] = page | rights | PRESENT | NO_EXECUTE;
        }
    }

    fn map_image(&mut self, range: &Range<u64>, rights: u64) {
        for page in range.clone().step_by(memory::PAGE as usize) {
            self.image[index(page, 12)] = page | rights;
        }
    }
}

fn address(table: &Table) -> u64 {
    table.as_ptr() as u64
}

/// Index of an address in the table whose entries each cover `1 << shift` bytes.
const fn index(address: u64, shift: u32) -> usize {
    (address >> shift) as usize % ENTRIES
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the processor would find for an address: its page table entry, or `None`.
    fn walk(tables: &Tables, virtual_address: u64) -> Option<u64> {
        let all = [
            &tables.root,
            &tables.pointers,
            &tables.image_directory,
            &tables.image,
            &tables.shared_directory,
            &tables.shared,
        ];
        let mut table = &tables.root;
        for shift in [39, 30, 21] {
            let entry = table[index(virtual_address, shift)];
            if entry & PRESENT == 0 {
                return None;
            }
            if entry & LARGE != 0 {
                return Some(entry);
            }
            table = all.iter().find(|t| address(t) == entry & !0xfff)?;
        }
        Some(table[index(virtual_address, 12)]).filter(|entry| entry & PRESENT != 0)
    }

    /// With two pages of its own, one of its peer's, and one that lies elsewhere.
    fn port() -> Port {
        Port {
            own: memory::CHANNELS,
            own_pages: 2,
            peer: memory::CHANNELS_END - memory::PAGE,
            peer_pages: 2,
            ..Port::NONE
        }
    }

    fn tables() -> Box<Tables> {
        let mut tables = Box::new(Tables::empty());
        let root = tables.build(&Layout {
            text: 0x10_0000..0x10_3000,
            rodata: 0x10_3000..0x10_4000,
            data: 0x10_4000..0x10_8000,
            guards: &[0x10_5000],
            ports: &[port()],
        });
        assert_eq!(root, address(&tables.root));
        tables
    }

    #[test]
    fn each_part_has_its_rights_and_maps_to_itself() {
        let tables = tables();
        let expected = [
            (0x10_0000, PRESENT),
            (0x10_2000, PRESENT),
            (0x10_3000, PRESENT | NO_EXECUTE),
            (0x10_4000, PRESENT | WRITABLE | NO_EXECUTE),
            (0x10_7000, PRESENT | WRITABLE | NO_EXECUTE),
            (memory::INFORMATION, PRESENT | NO_EXECUTE),
            (memory::STATUS, PRESENT | WRITABLE | NO_EXECUTE),
            (memory::PORT_TABLE, PRESENT | NO_EXECUTE),
            (memory::PROGRAM_TABLE, PRESENT | NO_EXECUTE),
            (memory::IO_TABLE, PRESENT | NO_EXECUTE),
            (memory::IO_TABLE + 3 * memory::PAGE, PRESENT | NO_EXECUTE),
            (memory::CHANNELS, PRESENT | WRITABLE | NO_EXECUTE),
            (memory::CHANNELS + memory::PAGE, PRESENT | WRITABLE | NO_EXECUTE),
            (memory::CHANNELS_END - memory::PAGE, PRESENT | NO_EXECUTE),
        ];
        for (page, rights) in expected {
            assert_eq!(walk(&tables, page), Some(page | rights), "{page:#x}");
        }
    }

    #[test]
    fn the_area_of_devices_is_mapped_to_itself_and_uncached() {
        let tables = tables();
        let rights = PRESENT | WRITABLE | UNCACHED | LARGE | NO_EXECUTE;
        let last = memory::DEVICES_END - LARGE_PAGE as u64;
        for page in [memory::DEVICES, memory::DEVICES + LARGE_PAGE as u64, last] {
            assert_eq!(walk(&tables, page), Some(page | rights), "{page:#x}");
        }
    }

    #[test]
    fn everything_else_is_unmapped() {
        let tables = tables();
        let unmapped = [
            0,
            0x1000,
            memory::IMAGE_BASE - memory::PAGE,
            0x10_5000,
            0x10_8000,
            0x20_0000,
            memory::RAM_MAX - memory::PAGE,
            memory::CHANNELS + 2 * memory::PAGE,
            memory::CHANNELS_END,
            memory::DEVICES - memory::PAGE,
            memory::DEVICES_END,
            0xffff_8000_0000_0000,
        ];
        for page in unmapped {
            assert_eq!(walk(&tables, page), None, "{page:#x}");
        }
    }
}
