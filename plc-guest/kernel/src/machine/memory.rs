//! Guest memory beyond the kernel's own image: where it is, and the only accesses to it.
//!
//! Images, states, stacks and page tables lie anywhere in the partition's RAM, and the programs see them at
//! addresses of their own. The kernel sees all RAM at one fixed distance, in the upper half of every address
//! space, never executable and closed to ring 3. What it reads or writes there it names by an [`Area`]: a range
//! that was found to be inside of the RAM. No reference to such memory is made but to images, which only
//! the host writes, before the start.

use core::cell::UnsafeCell;
use core::ptr;
use takt_abi::memory::PAGE;

/// Where physical address 0 is seen.
const DISTANCE: u64 = 0xffff_8000_0000_0000;
/// Entry of the root table that maps it.
pub const ROOT_ENTRY: usize = 256;

const PRESENT: u64 = 1;
const WRITABLE: u64 = 1 << 1;
const LARGE: u64 = 1 << 7;
const NO_EXECUTE: u64 = 1 << 63;
const ADDRESS: u64 = 0x000f_ffff_ffff_f000;
const LARGE_PAGE: u64 = 2 << 20;
/// The kernel's image lies below: it is mapped with its own rights already.
const IMAGE_END: u64 = LARGE_PAGE;
/// 3 GiB of RAM at most.
const GIGABYTES: usize = 3;

/// Some memory of the partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    start: u64,
    bytes: u64,
}

impl Area {
    /// No memory.
    pub const NONE: Self = Self { start: 0, bytes: 0 };

    /// Where it begins, as page tables name it.
    pub const fn start(self) -> u64 {
        self.start
    }

    pub const fn bytes(self) -> u64 {
        self.bytes
    }

    /// A part of it; none if it does not lie inside.
    pub const fn part(self, offset: u64, bytes: u64) -> Option<Self> {
        match offset.checked_add(bytes) {
            Some(end) if end <= self.bytes => Some(Self { start: self.start + offset, bytes }),
            _ => None,
        }
    }

    /// Its first bytes, or all of it if there are not so many.
    pub const fn first(self, bytes: u64) -> Self {
        Self { start: self.start, bytes: if bytes < self.bytes { bytes } else { self.bytes } }
    }

    fn pointer(self) -> *mut u8 {
        (DISTANCE + self.start) as *mut u8
    }

    /// Fills it with zeros.
    pub fn clear(self) {
        // SAFETY: all of an area is mapped, writable and not the kernel's own (`Ram::area`).
        unsafe { ptr::write_bytes(self.pointer(), 0, self.bytes as usize) };
    }

    /// Copies what fits from another one, which may overlap.
    pub fn copy_from(self, from: Self) {
        let bytes = self.bytes.min(from.bytes) as usize;
        // SAFETY: as in `clear`, for both.
        unsafe { ptr::copy(from.pointer(), self.pointer(), bytes) };
    }

    /// Copies what fits out of it.
    pub fn read(self, to: &mut [u8]) {
        let bytes = to.len().min(self.bytes as usize);
        // SAFETY: as in `clear`; the kernel's own memory is no area, so they do not overlap.
        unsafe { ptr::copy_nonoverlapping(self.pointer(), to.as_mut_ptr(), bytes) };
    }

    /// Copies what fits into it.
    pub fn write(self, from: &[u8]) {
        let bytes = from.len().min(self.bytes as usize);
        // SAFETY: as in `read`.
        unsafe { ptr::copy_nonoverlapping(from.as_ptr(), self.pointer(), bytes) };
    }

    /// All of it, for a while.
    ///
    /// # Safety
    ///
    /// No program may see it, and until the end of the life of the result nothing else may read or write it.
    pub unsafe fn slice<'a>(self) -> &'a mut [u8] {
        if self.bytes == 0 {
            return &mut [];
        }
        // SAFETY: as in `clear`; the caller promises the rest.
        unsafe { core::slice::from_raw_parts_mut(self.pointer(), self.bytes as usize) }
    }

    /// The 64-bit number at an offset; 0 outside of the area.
    pub fn word(self, offset: u64) -> u64 {
        let mut bytes = [0; 8];
        if let Some(part) = self.part(offset, 8) {
            part.read(&mut bytes);
        }
        u64::from_le_bytes(bytes)
    }

    /// Writes a 64-bit number at an offset, if that is inside.
    pub fn set_word(self, offset: u64, value: u64) {
        self.set_words(offset, [value]);
    }

    /// Writes such numbers one after the other, if they are inside.
    pub fn set_words<const N: usize>(self, offset: u64, values: [u64; N]) {
        if let Some(part) = self.part(offset, 8 * N as u64) {
            let to = part.pointer().cast::<[u64; N]>();
            // SAFETY: as in `clear`; there is room for all.
            unsafe { to.write_unaligned(values.map(u64::to_le)) };
        }
    }

    /// All of it, for an image.
    ///
    /// # Safety
    ///
    /// Nothing may ever write it again.
    pub unsafe fn bytes_for_ever(self) -> &'static [u8] {
        // SAFETY: it is mapped for ever, and the caller promises the rest.
        unsafe { core::slice::from_raw_parts(self.pointer(), self.bytes as usize) }
    }
}

/// All RAM above the kernel's image.
#[derive(Clone, Copy, Debug)]
pub struct Ram {
    bytes: u64,
}

#[repr(C, align(4096))]
struct Table(UnsafeCell<[u64; 512]>);

// SAFETY: the tables are filled by `Ram::map`, before a second user of them can be.
unsafe impl Sync for Table {}

static POINTERS: Table = Table(UnsafeCell::new([0; 512]));
static DIRECTORIES: [Table; GIGABYTES] = [const { Table(UnsafeCell::new([0; 512])) }; GIGABYTES];

impl Ram {
    /// Makes the RAM visible, in the tables with this root.
    ///
    /// # Safety
    ///
    /// To be called once, with the root in use, which must be writable at its physical address.
    pub unsafe fn map(root: u64, bytes: u64) -> Self {
        let entries = bytes.div_ceil(LARGE_PAGE).min(512 * GIGABYTES as u64);
        // SAFETY: the caller promises the only call, and a root that can be written. Static tables
        // are seen at their physical addresses.
        unsafe {
            for page in IMAGE_END / LARGE_PAGE..entries {
                let rights = PRESENT | WRITABLE | LARGE | NO_EXECUTE;
                let directory = &DIRECTORIES[(page / 512) as usize];
                (&mut (*directory.0.get()))[(page % 512) as usize] = (page * LARGE_PAGE) | rights;
            }
            for (index, directory) in DIRECTORIES.iter().enumerate() {
                let address = directory.0.get() as u64;
                (&mut (*POINTERS.0.get()))[index] = address | PRESENT | WRITABLE;
            }
            let entry = (root as *mut u64).add(ROOT_ENTRY);
            entry.write_volatile(POINTERS.0.get() as u64 | PRESENT | WRITABLE);
        }
        Self { bytes }
    }

    /// Takes from the kernel the right to write whole pages: those that ring 3 executes.
    ///
    /// It holds when tables are entered the next time.
    pub fn write_protect(self, pages: &mut Pages, area: Area) -> Result<(), OutOfMemory> {
        for page in (area.start..area.start + area.bytes).step_by(PAGE as usize) {
            let large = page / LARGE_PAGE;
            let directory = DIRECTORIES[(large / 512) as usize].0.get();
            // SAFETY: one thread, and the processor sees the new entry as it saw the old one.
            let entry = unsafe { &mut (&mut (*directory))[(large % 512) as usize] };
            let table = if *entry & LARGE == 0 {
                pages.at(*entry & ADDRESS).ok_or(OutOfMemory)?
            } else {
                let table = pages.take(PAGE)?;
                for small in 0..512 {
                    let address = large * LARGE_PAGE + small * PAGE;
                    table.set_word(8 * small, address | PRESENT | WRITABLE | NO_EXECUTE);
                }
                *entry = table.start | PRESENT | WRITABLE;
                table
            };
            table.set_word(8 * (page / PAGE % 512), page | PRESENT | NO_EXECUTE);
        }
        Ok(())
    }

    /// Some of it; none if it is not RAM, or the kernel's own.
    pub fn area(self, start: u64, bytes: u64) -> Option<Area> {
        let end = start.checked_add(bytes)?;
        (start >= IMAGE_END && end <= self.bytes).then_some(Area { start, bytes })
    }
}

/// Whole pages out of the memory that the host sets aside for the kernel: taken at the start, never given
/// back.
#[derive(Debug)]
pub struct Pages {
    all: Area,
    rest: Area,
}

/// The host has set aside too little.
#[derive(Clone, Copy, Debug)]
pub struct OutOfMemory;

impl Pages {
    /// Those of this area, without the parts of pages at its ends.
    pub const fn new(area: Area) -> Self {
        let start = area.start.next_multiple_of(PAGE);
        let end = (area.start + area.bytes) & !(PAGE - 1);
        let all = Area { start, bytes: end.saturating_sub(start) };
        Self { all, rest: all }
    }

    /// The page at this address, which was taken before.
    pub fn at(&self, address: u64) -> Option<Area> {
        self.all.part(address.checked_sub(self.all.start)?, PAGE)
    }

    /// The next ones, filled with zeros.
    pub fn take(&mut self, bytes: u64) -> Result<Area, OutOfMemory> {
        let bytes = bytes.next_multiple_of(PAGE);
        let taken = self.rest.part(0, bytes).ok_or(OutOfMemory)?;
        self.rest = Area { start: self.rest.start + bytes, bytes: self.rest.bytes - bytes };
        taken.clear();
        Ok(taken)
    }
}
