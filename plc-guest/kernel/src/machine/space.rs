//! The address space of a program.
//!
//! Each program has tables of its own, with its code, its data and nothing of its neighbours in them. The
//! kernel is in all of them, closed to ring 3, so that an entry into it needs no change of tables: it is a
//! part of the first GiB, the pages shared with the host, and all RAM in the upper half.
//!
//! No page is writable and executable, and none that ring 3 can execute is writable for it elsewhere. What
//! has no entry faults: address 0, the page below each stack, everything between the areas.
//!
//! The state has page tables of its own, and so has the state of another version, if the partition file gives it one. The
//! processor notes in them which pages a program has written to.
//!
//! Table formats: AMD64 Architecture Programmer's Manual, volume 2, section 5.3.

use super::memory::{Area, OutOfMemory, Pages, ROOT_ENTRY};
use core::arch::asm;
use takt_abi::memory::PAGE;
use takt_program::address::{CODE, INPUT, MARKER, OUTPUT, STACKS, STATE, TASK_INFORMATION};
use takt_program::limit;

const PRESENT: u64 = 1;
const WRITABLE: u64 = 1 << 1;
const USER: u64 = 1 << 2;
const WRITTEN: u64 = 1 << 6;
const NO_EXECUTE: u64 = 1 << 63;
const ADDRESS: u64 = 0x000f_ffff_ffff_f000;

// Inputs and outputs have a page table to themselves.
const _: () = assert!(INPUT.is_multiple_of(2 << 20) && INPUT >> 21 == OUTPUT >> 21);
const _: () = assert!(MARKER >> 21 != INPUT >> 21);
// The tables of the state have nothing else in them.
const _: () = assert!(STATE.is_multiple_of(2 << 20) && STACKS >> 21 != STATE_END >> 21);
const STATE_END: u64 = STATE + limit::STATE_BYTES as u64 - 1;

/// What ring 3 may do with a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rights {
    /// Read and execute.
    Code,
    /// Read.
    Constants,
    /// Read and write.
    Data,
}

impl Rights {
    const fn bits(self) -> u64 {
        match self {
            Self::Code => PRESENT | USER,
            Self::Constants => PRESENT | USER | NO_EXECUTE,
            Self::Data => PRESENT | USER | WRITABLE | NO_EXECUTE,
        }
    }
}

/// The tables of a program.
///
/// All areas of a program lie in one GiB, so one word leads to all of its pages. There are two tables below that
/// word, one for each bank. They differ in code and constants only, and in the state if each version has its own.
#[derive(Clone, Copy, Debug)]
pub struct Space {
    root: Area,
    /// Where that word is.
    pointers: Area,
    /// The table in use, and the one for the other bank.
    directories: [Area; 2],
    /// Page tables of the state in use, and of a second one.
    states: [Area; 2],
}

/// What of a program's address space each of its tasks sees differently: the part of 2 MiB that begins with the inputs.
#[derive(Clone, Copy, Debug)]
pub struct View(Area);

impl View {
    /// Nothing.
    pub const NONE: Self = Self(Area::NONE);

    /// Nothing yet, in a page of zeros.
    pub const fn new(page: Area) -> Self {
        Self(page)
    }

    /// Maps an area, which begins at a page, to addresses in it.
    pub fn map(self, address: u64, area: Area, rights: Rights) {
        for offset in (0..area.bytes()).step_by(PAGE as usize) {
            self.0.set_word(index(address + offset, 12), (area.start() + offset) | rights.bits());
        }
    }
}

/// Entries of a directory for code and constants: from the first of the GiB to the state.
const CODE_ENTRIES: u64 = (STATE - CODE) / LARGE_PAGE;
const LARGE_PAGE: u64 = 2 << 20;
/// The GiB in which a program lies, as an entry of `pointers`.
const PROGRAM: u64 = 8 * (CODE >> 30);
const ENTRIES: u64 = 512;
const _: () = assert!(CODE & ((1 << 30) - 1) == 0 && TASK_INFORMATION >> 30 == CODE >> 30);

impl Space {
    /// With only the kernel, and room for the code and constants of a bank of this size, twice, and for states of these sizes.
    pub fn new(
        pages: &mut Pages,
        bank_bytes: u64,
        state_bytes: [u64; 2],
    ) -> Result<Self, OutOfMemory> {
        let root = pages.take(PAGE)?;
        let pointers = pages.take(PAGE)?;
        let first = pages.take(PAGE)?;
        // The kernel's own tables lie in its image, which is seen at its physical address.
        let kernel_root = Kernel(current_root());
        let kernel_pointers = kernel_root.next(0);
        first.set_word(0, kernel_pointers.next(0).entry(0));
        pointers.set_word(0, first.start() | PRESENT | WRITABLE | USER);
        for gigabyte in 1..4 {
            pointers.set_word(8 * gigabyte, kernel_pointers.entry(gigabyte));
        }
        root.set_word(0, pointers.start() | PRESENT | WRITABLE | USER);
        root.set_word(8 * ROOT_ENTRY as u64, kernel_root.entry(ROOT_ENTRY as u64));
        let mut directory = || -> Result<Area, OutOfMemory> {
            let directory = pages.take(PAGE)?;
            for entry in 0..Self::code_tables(bank_bytes) {
                let table = pages.take(PAGE)?;
                directory.set_word(8 * entry, table.start() | PRESENT | WRITABLE | USER);
            }
            Ok(directory)
        };
        let directories = [directory()?, directory()?];
        let [first, second] = state_bytes.map(|bytes| bytes.min(limit::STATE_BYTES.into()));
        let mut tables = |bytes: u64| pages.take(bytes.div_ceil(LARGE_PAGE) * PAGE);
        let states = [tables(first)?, tables(second)?];
        let space = Self { root, pointers, directories, states };
        space.link_state(0, 0);
        space.link();
        Ok(space)
    }

    /// Exchanges the view. It holds when the tables are entered the next time.
    pub fn show(self, view: View) {
        let entry = view.0.start() | PRESENT | WRITABLE | USER;
        self.directories[0].set_word(index(INPUT, 21), entry);
    }

    /// Tables for the code and constants of a bank.
    fn code_tables(bank_bytes: u64) -> u64 {
        bank_bytes.div_ceil(LARGE_PAGE).min(CODE_ENTRIES)
    }

    fn link(&self) {
        let entry = self.directories[0].start() | PRESENT | WRITABLE | USER;
        self.pointers.set_word(PROGRAM, entry);
    }

    /// Makes a directory lead to the tables of a state.
    fn link_state(&self, directory: usize, state: usize) {
        let tables = self.states[state];
        for table in (0..tables.bytes()).step_by(PAGE as usize) {
            let entry = (tables.start() + table) | PRESENT | WRITABLE | USER;
            self.directories[directory].set_word(index(STATE, 21) + table / PAGE * 8, entry);
        }
    }

    /// Maps one page of the second state, or none.
    pub fn set_second(&self, page: u64, to: Option<u64>) {
        let entry = to.map_or(0, |address| address | Rights::Data.bits());
        self.states[1].set_word(8 * page, entry);
    }

    /// How many pages the tables of the second state have.
    pub fn second_pages(&self) -> u64 {
        self.states[1].bytes() / 8
    }

    /// The next of some pages of the state in use that has been written to, from `from` on and before `end`. It counts as not
    /// written to from then on, when the tables have been entered anew.
    pub fn take_written(&self, from: u64, end: u64) -> Option<u64> {
        let tables = self.states[0];
        let page = (from..end).find(|page| tables.word(8 * page) & WRITTEN != 0)?;
        tables.set_word(8 * page, tables.word(8 * page) & !WRITTEN);
        Some(page)
    }

    /// The kernel writes to these bytes of a state, where the processor does not note it.
    pub fn set_written(&self, second: bool, offset: u64, bytes: u64) {
        let tables = self.states[usize::from(second)];
        for page in offset / PAGE..(offset + bytes).div_ceil(PAGE) {
            tables.set_word(8 * page, tables.word(8 * page) | WRITTEN);
        }
    }

    /// How many pages [`set_other`](Self::set_other) knows.
    pub fn other_pages(bank_bytes: u64) -> u64 {
        Self::code_tables(bank_bytes) * ENTRIES
    }

    /// Maps one page of code or constants for the other bank, or none.
    pub fn set_other(&self, pages: &Pages, page: u64, to: Option<(u64, Rights)>) {
        let entry = self.directories[1].word(8 * (page / ENTRIES));
        if let Some(table) = pages.at(entry & ADDRESS) {
            let entry = to.map_or(0, |(address, rights)| address | rights.bits());
            table.set_word(8 * (page % ENTRIES), entry);
        }
    }

    /// What is not code or constants is the same for both banks, but for the state of a version that has its own.
    pub fn complete_other(&self, second_state: bool) {
        let [current, other] = self.directories;
        let rest = (8 * CODE_ENTRIES, PAGE - 8 * CODE_ENTRIES);
        if let (Some(from), Some(to)) = (current.part(rest.0, rest.1), other.part(rest.0, rest.1)) {
            to.copy_from(from);
        }
        if second_state {
            self.link_state(1, 1);
        }
    }

    /// The other bank's code and constants take the place of those in use, and so does the second state if it is the other
    /// version's, from the next [`enter`](Self::enter) on.
    pub fn exchange(&mut self, second_state: bool) {
        self.directories.swap(0, 1);
        if second_state {
            self.states.swap(0, 1);
        }
        self.link();
    }

    /// Maps an area, which begins at a page, to addresses of the program.
    pub fn map(
        self,
        pages: &mut Pages,
        address: u64,
        area: Area,
        rights: Rights,
    ) -> Result<(), OutOfMemory> {
        for offset in (0..area.bytes()).step_by(PAGE as usize) {
            let mut table = self.root;
            for shift in [39, 30, 21] {
                table = Self::table(table, index(address + offset, shift), pages)?;
            }
            table.set_word(index(address + offset, 12), (area.start() + offset) | rights.bits());
        }
        Ok(())
    }

    /// The table below an entry; a new one if there is none.
    fn table(table: Area, entry: u64, pages: &mut Pages) -> Result<Area, OutOfMemory> {
        let found = table.word(entry);
        if found & PRESENT != 0 {
            return pages.at(found & ADDRESS).ok_or(OutOfMemory);
        }
        let new = pages.take(PAGE)?;
        table.set_word(entry, new.start() | PRESENT | WRITABLE | USER);
        Ok(new)
    }

    /// Makes the processor use them, and forget the selectors that another program has loaded.
    pub fn enter(self) {
        super::processor::forget_selectors();
        // SAFETY: the kernel is in all spaces at the same addresses.
        unsafe {
            asm!("mov cr3, {}", in(reg) self.root.start(), options(nostack, preserves_flags));
        };
    }
}

/// Byte offset of an address's entry, in the table whose entries each cover `1 << shift` bytes.
const fn index(address: u64, shift: u32) -> u64 {
    (address >> shift & 0x1ff) * 8
}

fn current_root() -> u64 {
    let root: u64;
    // SAFETY: reading it has no effect, and this is ring 0.
    unsafe { asm!("mov {}, cr3", out(reg) root, options(nomem, nostack, preserves_flags)) };
    root & ADDRESS
}

/// A table of the kernel's own.
struct Kernel(u64);

impl Kernel {
    fn entry(&self, number: u64) -> u64 {
        // SAFETY: the tables lie in the kernel's image, at the addresses where they are seen.
        unsafe { ((self.0 + 8 * number) as *const u64).read_volatile() }
    }

    fn next(&self, number: u64) -> Self {
        Self(self.entry(number) & ADDRESS)
    }
}

/// The root of the tables that the kernel was started with.
pub fn boot_root() -> u64 {
    current_root()
}
