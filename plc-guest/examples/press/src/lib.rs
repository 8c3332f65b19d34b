//! A press: its ram is held in position each ms, its pump switched each 10 ms, and figures are made each 100 ms, which
//! takes several windows of a partition. The ram is simulated, so the program needs no plant.

#![no_std]

use core::time::Duration;

use takt_blocks::timer::Ton;
use takt_blocks::{Ctu, Pid, Tuning};
use takt_sdk::{Cyclic, Job, Local, ms};

takt_sdk::program!("press", 0, 1, 0);

takt_sdk::point!(POSITION: f64 = 0.0, "position"); // in metres
takt_sdk::point!(STROKES: i32 = 0, "strokes");
takt_sdk::point!(SPREAD: i32 = 0, "spread");

takt_sdk::task!("fast", hold, Cyclic { period: ms(1), priority: 0, ..Cyclic::DEFAULT });
takt_sdk::task!("middle", pump, Cyclic { period: ms(10), priority: 5, ..Cyclic::DEFAULT });
takt_sdk::task!("slow", figures, Cyclic { period: ms(100), priority: 9, ..Cyclic::DEFAULT });

takt_sdk::writes!("fast", "position");
takt_sdk::writes!("middle", "strokes");
takt_sdk::writes!("slow", "spread");

const TUNING: Tuning =
    Tuning { proportional: 4.0, integral: 1.0, low: -10.0, high: 10.0, ..Tuning::DEFAULT };

/// A controller for each corner of the ram.
static CORNERS: Local<[Pid; 4]> = Local::new([const { Pid::new(TUNING) }; 4]);

fn hold(job: &Job) {
    let elapsed = Duration::from_nanos(job.period_ns);
    let position = POSITION.get();
    let speed = CORNERS.with(|corners| {
        corners.iter_mut().map(|corner| corner.update(1.0, position, elapsed)).sum::<f64>() / 4.0
    });
    POSITION.set(position + speed * 0.001);
    if job.cycle == 3_000 {
        let settled = (position - 1.0).abs() < 0.05;
        takt_sdk::call::log(if settled { "position settled" } else { "position is wrong" });
    }
}

/// On for 50 ms, off for 50 ms: ten strokes each second.
struct Pump {
    on: Ton,
    off: Ton,
    strokes: Ctu<i32>,
    running: bool,
}

static PUMP: Local<Pump> =
    Local::new(Pump { on: Ton::new(), off: Ton::new(), strokes: Ctu::new(), running: false });

fn pump(job: &Job) {
    const HALF: Duration = Duration::from_millis(50);
    let elapsed = Duration::from_nanos(job.period_ns);
    PUMP.with(|pump| {
        if pump.off.update(!pump.running, HALF, elapsed) {
            pump.running = true;
        } else if pump.on.update(pump.running, HALF, elapsed) {
            pump.running = false;
        }
        pump.strokes.update(pump.running, false, 20);
        STROKES.set(pump.strokes.cv());
    });
}

static ROW: Local<[i32; 1000]> = Local::new([0; 1000]);

fn figures(_job: &Job) {
    let spread = ROW.with(|row| {
        let mut sum = 0;
        for _ in 0..150 {
            sum = 0;
            for (cell, more) in row.iter_mut().zip(0..) {
                *cell = cell.wrapping_add(more);
                sum += *cell % 7;
            }
        }
        sum
    });
    SPREAD.set(spread);
}
