//! The demonstration: a controller that holds the level of a simulated tank, and a blinking lamp.
//!
//! It is a whole control program in small: it computes from elapsed time, it keeps its promise of
//! one bounded scan per release, and now and then it says what it did. If the partition file gives
//! it a port `level`, it publishes its level there, and if it has a port `other-level`, it says
//! what it reads from it; both are of 8 bytes, of sampling channels.

#![no_std]
#![no_main]

use core::time::Duration;
use takt_channel::{Tsc, Validity};
use takt_plc_guest::channel::{self, Input, Output};
use takt_plc_guest::console::print;
use takt_plc_guest::control::blinker::Blinker;
use takt_plc_guest::control::pid::{Gains, Pid};
use takt_plc_guest::control::tank::Tank;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

/// Time between two lines: not a multiple of the lamp's period, or it would always look the same.
const REPORT: Duration = Duration::from_millis(2500);
/// The level to hold changes this often, between these two heights in metres.
const STEP: Duration = Duration::from_secs(20);
const SET: [f64; 2] = [1.2, 0.8];
const BLINK: Duration = Duration::from_millis(500);
const GAINS: Gains = Gains { proportional: 4.0, integral: 0.5, derivative: 0.2 };

struct Demo {
    tank: Tank,
    controller: Pid,
    blinker: Blinker,
    valve: f64,
    next_report: Duration,
    missed: u64,
    level: Option<Output>,
    other_level: Option<Input>,
}

impl Demo {
    /// What the other end of the channel has published, if it is still valid.
    fn other_level(&mut self) -> Option<f64> {
        let mut buffer = [0; 8];
        let sample = self.other_level.as_mut()?.read(&mut buffer, Tsc(cycle::now())).ok()?;
        let bytes: [u8; 8] = sample.bytes.try_into().ok()?;
        (sample.validity == Validity::Valid).then_some(f64::from_le_bytes(bytes))
    }
}

impl Program for Demo {
    fn scan(&mut self, cycle: &Cycle) {
        self.missed = self.missed.saturating_add(cycle.missed);
        let step = cycle.time.as_secs() / STEP.as_secs();
        let set = if step.is_multiple_of(2) { SET[0] } else { SET[1] };
        self.tank.update(self.valve, cycle.elapsed);
        let level = self.tank.level();
        self.valve = self.controller.update(set, level, cycle.elapsed);
        let lamp = self.blinker.update(cycle.elapsed);
        if let Some(port) = &mut self.level {
            // Eight bytes are what the port is for.
            let _ = port.write(&level.to_le_bytes(), Tsc(cycle::now()));
        }
        if cycle.time >= self.next_report {
            self.next_report = cycle.time + REPORT;
            print(format_args!(
                "cycle {}, level {level:.3} m (set {set:.3}), valve {:.0} %, lamp {}, missed {}",
                cycle.release,
                self.valve * 100.0,
                if lamp { "on" } else { "off" },
                self.missed,
            ));
            if let Some(other) = self.other_level() {
                print(format_args!("the other level is {other:.3} m"));
            }
        }
    }
}

fn main() -> ! {
    let information = pages::information();
    print(format_args!(
        "Takt PLC guest, frame {} us, TSC {}.{:03} MHz",
        information.major_frame_ns / 1000,
        information.tsc_khz / 1000,
        information.tsc_khz % 1000,
    ));
    cycle::run(Demo {
        tank: Tank::default(),
        controller: Pid::new(GAINS),
        blinker: Blinker::new(BLINK),
        valve: 0.0,
        next_report: REPORT,
        missed: 0,
        level: channel::output("level", 8).ok(),
        other_level: channel::input("other-level", 8).ok(),
    })
}

entry!(main);
