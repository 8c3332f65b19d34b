//! A guest that tries to forge its own schedule.
//!
//! Its page tables are its own, so it can make the information page writable in them. It shows
//! that the right that counts is the host's: the store must not reach the page, and the host must
//! survive it. If it is run on after the store, it says what it finds and ends with 0 if the page
//! is unchanged, else with 1.

#![no_std]
#![no_main]

use core::arch::asm;
use takt_abi::memory;
use takt_plc_guest::console::print;
use takt_plc_guest::{entry, pages, port};

const WRITABLE: u64 = 1 << 1;
const ADDRESS: u64 = !0xfff & !(1 << 63);

/// Sets the writable bit in the last-level entry of an address. Its tables are mapped writable,
/// each at its physical address.
fn make_writable(address: u64) {
    let mut table: u64;
    // SAFETY: reading CR3 has no effect, and this is ring 0.
    unsafe { asm!("mov {}, cr3", out(reg) table, options(nomem, nostack, preserves_flags)) };
    for shift in [39, 30, 21] {
        let entry = (table & ADDRESS) as *const u64;
        // SAFETY: `boot` built the tables for this address down to the last level.
        table = unsafe { entry.add((address >> shift) as usize % 512).read_volatile() };
    }
    let entry = ((table & ADDRESS) as *mut u64).wrapping_add((address >> 12) as usize % 512);
    // SAFETY: as above; the entry keeps its address, so what is mapped stays where it is.
    unsafe {
        entry.write_volatile(entry.read_volatile() | WRITABLE);
        asm!("invlpg [{}]", in(reg) address, options(nostack, preserves_flags));
    }
}

fn main() -> ! {
    print(format_args!("write-information, forging the schedule"));
    make_writable(memory::INFORMATION);
    let before = pages::information().major_frame_ns;
    // SAFETY: the page holds no Rust object of this guest, and is writable as far as this guest
    // can tell. `mov` and not a volatile write: the host may have to decode the instruction.
    unsafe {
        asm!(
            "mov qword ptr [{page} + {frame}], 1",
            page = in(reg) memory::INFORMATION,
            frame = const core::mem::offset_of!(takt_abi::Information, major_frame_ns),
            options(nostack),
        );
    }
    let changed = pages::information().major_frame_ns != before;
    print(format_args!(
        "write-information, page {}",
        if changed { "changed" } else { "unchanged" }
    ));
    port::exit(u32::from(changed))
}

entry!(main);
