//! A program keeps its blocks in statics, so each can be made without a call at run time. Nothing has been seen then.

use core::time::Duration;

use takt_blocks::timer::{Tof, Ton, Tp};
use takt_blocks::{
    Alarm, Condition, Ctd, Ctu, Ctud, FTrig, Multiplexer, Pid, RTrig, Rs, Sr, Tuning,
};

static TUNING: Tuning = Tuning::DEFAULT;
static PID: Pid = Pid::new(Tuning { proportional: 2.0, ..Tuning::DEFAULT });
static EDGES: (RTrig, FTrig) = (RTrig::new(), FTrig::new());
static BISTABLES: (Sr, Rs) = (Sr::new(), Rs::new());
static TIMERS: (Ton, Tof, Tp) = (Ton::new(), Tof::new(), Tp::new());
static COUNTERS: (Ctu<i16>, Ctd<u64>, Ctud<i64>) = (Ctu::new(), Ctd::new(), Ctud::new());
static MULTIPLEXER: Multiplexer = Multiplexer::new();
static ALARM: Alarm = Alarm::new(Condition::Above, 2.5)
    .with_dead_band(0.1)
    .with_delays(Duration::from_secs(1), Duration::MAX);

#[test]
fn blocks_in_statics_are_as_after_a_cold_start() {
    assert_eq!(TUNING, Tuning::default());
    assert_eq!(PID.output(), 0.0);
    assert_eq!(EDGES, Default::default());
    assert_eq!(BISTABLES, Default::default());
    assert_eq!(TIMERS, Default::default());
    assert_eq!(COUNTERS, Default::default());
    assert_eq!(MULTIPLEXER, Multiplexer::default());
    let alarm = Alarm::new(Condition::Above, 2.5).with_dead_band(0.1);
    assert_eq!(ALARM, alarm.with_delays(Duration::from_secs(1), Duration::MAX));
}
