//! A guest that tries every I/O port and every large page of the devices' area, and counts what
//! answers.
//!
//! What it has been given answers; all else must read as all ones and be counted by the host. Only
//! the ports that are its calls to Takt are left out.

#![no_std]
#![no_main]

use takt_abi::{memory, port::RESERVED};
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{entry, io, pages};

const PAGE: u64 = 2 << 20;

/// What is tried next, and what came of the rest.
#[derive(Default)]
struct Sweep {
    port: u32,
    page: u64,
    answers: u32,
    tried: u32,
    told: bool,
}

impl Sweep {
    /// Tries one thing; false when there is nothing left.
    fn step(&mut self) -> bool {
        if let Ok(port) = u16::try_from(self.port) {
            self.port += 1;
            if !RESERVED.contains(&port) {
                self.tried += 1;
                self.answers += u32::from(io::inb(port) != u8::MAX);
            }
            return true;
        }
        let Some(register) = Register::<u32>::at(memory::DEVICES + self.page * PAGE) else {
            return false;
        };
        self.page += 1;
        self.tried += 1;
        self.answers += u32::from(register.read() != u32::MAX);
        true
    }
}

impl Program for Sweep {
    fn scan(&mut self, _: &Cycle) {
        let information = pages::information();
        let window = information.window_end_tsc.saturating_sub(information.release_tsc);
        let until = information.release_tsc + window / 2;
        while cycle::now() < until {
            if !self.step() {
                if !self.told {
                    let Self { tried, answers, .. } = self;
                    print(format_args!("sweep: {tried} places tried, {answers} answered"));
                    self.told = true;
                }
                return;
            }
        }
    }
}

fn main() -> ! {
    cycle::run(Sweep::default())
}

entry!(main);
