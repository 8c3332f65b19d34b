//! The demonstration: a controller that holds the level of a simulated tank, and a blinking lamp.
//!
//! It is a whole control program in small: it computes from elapsed time, it keeps its promise of
//! one bounded scan per release, and now and then it says what it did. It uses these ports, if the
//! partition file gives them to it:
//!
//! | port | channel | what |
//! | --- | --- | --- |
//! | `level` | sampling, 8 bytes | publishes its level, an `f64` in metres |
//! | `other-level` | sampling, 8 bytes | says what it reads there |
//! | `setpoint` | sampling, 8 bytes | while valid, the level to hold instead of its own |
//! | `log` | queuing, 160 bytes | sends what it says on the console |

#![no_std]
#![no_main]

use core::time::Duration;
use takt_channel::{Tsc, Validity};
use takt_plc_guest::channel::{self, Input, Output, Sender};
use takt_plc_guest::console::{LINE, Line, print};
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
    setpoint: Option<Input>,
    log: Option<Sender>,
}

/// What the other end of a channel has published, if it is a number and still valid.
fn newest(port: &mut Option<Input>) -> Option<f64> {
    let mut buffer = [0; 8];
    let sample = port.as_mut()?.read(&mut buffer, Tsc(cycle::now())).ok()?;
    let bytes: [u8; 8] = sample.bytes.try_into().ok()?;
    let number = Some(f64::from_le_bytes(bytes)).filter(|number| number.is_finite());
    number.filter(|_| sample.validity == Validity::Valid)
}

impl Program for Demo {
    fn scan(&mut self, cycle: &Cycle) {
        self.missed = self.missed.saturating_add(cycle.missed);
        let step = cycle.time.as_secs() / STEP.as_secs();
        let own = if step.is_multiple_of(2) { SET[0] } else { SET[1] };
        let set = newest(&mut self.setpoint).unwrap_or(own);
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
            let line = Line::new(format_args!(
                "cycle {}, level {level:.3} m (set {set:.3}), valve {:.0} %, lamp {}, missed {}",
                cycle.release,
                self.valve * 100.0,
                if lamp { "on" } else { "off" },
                self.missed,
            ));
            line.print();
            if let Some(port) = &mut self.log {
                // If the port does not take them, the console has them all the same.
                let _ = port.send(line.text(), Tsc(cycle::now()));
            }
            if let Some(other) = newest(&mut self.other_level) {
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
        setpoint: channel::input("setpoint", 8).ok(),
        log: channel::sender("log", LINE as u32).ok(),
    })
}

entry!(main);
