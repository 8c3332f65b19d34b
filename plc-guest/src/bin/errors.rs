//! A guest that makes one error of the health monitor's list, after some good cycles of each start.
//!
//! Which one, the name of its port says: nothing else that a partition file can tell a guest has room
//! for a word. It says how it was started, and how many starts a warm one has kept; after an error
//! that it survives it goes on without another.

#![no_std]
#![no_main]

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering};
use takt_abi::start::WARM;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{channel, entry, health, pages, port};

const GOOD_CYCLES: u32 = 10;
/// A port that no machine has.
const FOREIGN_PORT: u16 = 0x2000;

#[unsafe(link_section = ".retain")]
static STARTS: AtomicU32 = AtomicU32::new(0);

struct Errors {
    cycles: u32,
    error: &'static str,
}

impl Program for Errors {
    fn scan(&mut self, _: &Cycle) {
        if self.cycles == GOOD_CYCLES {
            make(self.error);
        }
        self.cycles = self.cycles.saturating_add(1);
    }
}

fn make(error: &str) {
    match error {
        "deadline-missed" => {
            // Until the host tells of another release: the window's end alone may come before the kick.
            let release = pages::information().release;
            while pages::information().release == release {}
        }
        "application-error" => health::raise(7, "valve 3 does not follow"),
        "illegal-request" => {
            let _ = port::read(FOREIGN_PORT);
        }
        "partition-ended" => port::exit(0),
        // SAFETY: each of these raises an exception, from which the handler does not return, or ends
        // the virtual processor. Assembly, because all of it would be undefined or a panic in Rust.
        _ => unsafe {
            match error {
                "numeric-error" => {
                    asm!("div {:e}", in(reg) 0_u32, inout("eax") 1_u32 => _, inout("edx") 0_u32 => _);
                }
                "stack-overflow" => asm!("2: push 0", "jmp 2b"),
                // Page 0 is not mapped.
                "memory-violation" => asm!("mov qword ptr [{}], 0", in(reg) 0_u64),
                // The vector of a machine check.
                "hardware-fault" => asm!("int 18"),
                // A table with no room for a handler.
                "processor-shutdown" => {
                    asm!("lidt [{}]", "ud2", in(reg) &raw const NO_HANDLERS);
                }
                _ => port::exit(1),
            }
        },
    }
}

/// The operand of `lidt`: limit and address.
static NO_HANDLERS: [u16; 5] = [0; 5];

/// The name of the first port, up to its first zero.
fn error() -> &'static str {
    let name = channel::ports().first().map_or(&[][..], |port| &port.name);
    let name = name.split(|byte| *byte == 0).next().unwrap_or(&[]);
    core::str::from_utf8(name).unwrap_or("")
}

fn main() -> ! {
    let information = pages::information();
    print(format_args!(
        "{} start, condition {}, retained {}",
        if information.start_mode == WARM { "warm" } else { "cold" },
        information.start_condition,
        STARTS.fetch_add(1, Ordering::Relaxed),
    ));
    cycle::run(Errors { cycles: 0, error: error() })
}

entry!(main);
