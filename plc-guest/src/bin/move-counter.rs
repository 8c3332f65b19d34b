//! A guest whose time-stamp counter goes ahead of the host's by half a millisecond, as KVM would move it on a host whose own has
//! turned bad.

#![no_std]
#![no_main]

use core::arch::asm;
use core::arch::x86_64::_rdtsc;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

/// Cycles before that.
const GOOD_CYCLES: u32 = 20;

struct Mover {
    cycles: u32,
}

impl Program for Mover {
    fn scan(&mut self, _: &Cycle) {
        self.cycles += 1;
        if self.cycles != GOOD_CYCLES {
            return;
        }
        // SAFETY: `rdtsc` has no preconditions in ring 0.
        let value = unsafe { _rdtsc() } + pages::information().tsc_khz / 2;
        // SAFETY: the counter's own register is written, on which no memory depends.
        unsafe {
            asm!("wrmsr", in("ecx") 0x10, in("eax") value as u32, in("edx") (value >> 32) as u32)
        };
    }
}

fn main() -> ! {
    cycle::run(Mover { cycles: 0 })
}

entry!(main);
