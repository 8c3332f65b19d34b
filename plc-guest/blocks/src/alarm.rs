//! Alarm with delay and acknowledgement.
//!
//! ```text
//!            condition for on_delay                acknowledge
//!  Normal ---------------------> Unacknowledged ----------------> Acknowledged
//!    ^                            |          ^                         |
//!    |               gone for     |          | condition               | gone for
//!    |               off_delay    v          | for on_delay            | off_delay
//!    +---- acknowledge ---- ReturnedUnacknowledged                     |
//!    +-----------------------------------------------------------------+
//! ```
//!
//! Reference: ANSI/ISA-18.2-2016 and IEC 62682:2014, alarm state transition diagram (the states Normal,
//! Unacknowledged, Acknowledged, Returned to normal unacknowledged), and their on-delay, off-delay and
//! alarm deadband.

use crate::time::nanoseconds;
use core::time::Duration;

/// What a value is compared for.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Condition {
    /// Above the limit; over when at or below the limit less the dead band.
    #[default]
    Above,
    /// Below the limit; over when at or above the limit plus the dead band.
    Below,
    /// Not farther from the limit than the dead band.
    Equal,
    /// Farther from the limit than the dead band.
    Different,
}

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AlarmState {
    /// No alarm.
    #[default]
    Normal,
    /// The condition holds and no operator has seen it.
    Unacknowledged,
    /// The condition holds and an operator has seen it.
    Acknowledged,
    /// The condition is gone and no operator has seen it.
    ReturnedUnacknowledged,
}

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Alarm {
    /// What raises the alarm.
    pub condition: Condition,
    /// What the value is compared with.
    pub limit: f64,
    /// See [`Condition`]; at least 0.
    pub dead_band: f64,
    on_delay: u64,
    off_delay: u64,
    waited: u64,
    state: AlarmState,
    raw: bool,
    /// Whether the last number fulfilled the condition.
    held: bool,
    last_acknowledge: bool,
}

impl Alarm {
    /// An alarm without dead band and delays, in state Normal.
    #[must_use]
    pub const fn new(condition: Condition, limit: f64) -> Self {
        Self {
            condition,
            limit,
            dead_band: 0.0,
            on_delay: 0,
            off_delay: 0,
            waited: 0,
            state: AlarmState::Normal,
            raw: false,
            held: false,
            last_acknowledge: false,
        }
    }

    /// The same with a dead band.
    #[must_use]
    pub const fn with_dead_band(self, dead_band: f64) -> Self {
        Self { dead_band, ..self }
    }

    /// The same with delays: how long the condition must hold to raise the alarm, and must be gone to
    /// end it.
    #[must_use]
    pub const fn with_delays(self, on_delay: Duration, off_delay: Duration) -> Self {
        let (on_delay, off_delay) = (nanoseconds(on_delay), nanoseconds(off_delay));
        Self { on_delay, off_delay, ..self }
    }

    /// Looks at a value. `acknowledge` counts when it rises, so a button that sticks hides no alarm.
    ///
    /// A value that is NaN fulfils every condition: a measurement that fails is a reason for an alarm. It leaves the
    /// dead band as it was, or one failure would hold the condition for all values in the band.
    pub fn update(&mut self, value: f64, acknowledge: bool, elapsed: Duration) -> AlarmState {
        if !value.is_nan() {
            self.held = self.holds(value);
        }
        let raw = value.is_nan() || self.held;
        let active = matches!(self.state, AlarmState::Unacknowledged | AlarmState::Acknowledged);
        // The delay runs from the call that saw the change, as with a timer.
        let waited =
            if raw == self.raw { self.waited.saturating_add(nanoseconds(elapsed)) } else { 0 };
        let delay = if raw { self.on_delay } else { self.off_delay };
        let active = if waited >= delay { raw } else { active };
        let seen = acknowledge && !self.last_acknowledge;
        self.state = match (active, self.state) {
            (true, AlarmState::Acknowledged) => AlarmState::Acknowledged,
            (true, AlarmState::Unacknowledged) if seen => AlarmState::Acknowledged,
            (true, _) => AlarmState::Unacknowledged,
            (false, AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged) if !seen => {
                AlarmState::ReturnedUnacknowledged
            }
            (false, _) => AlarmState::Normal,
        };
        (self.raw, self.waited, self.last_acknowledge) = (raw, waited, acknowledge);
        self.state
    }

    /// The state after the last update.
    #[must_use]
    pub const fn state(&self) -> AlarmState {
        self.state
    }

    fn holds(&self, value: f64) -> bool {
        let back = if self.held { self.dead_band } else { 0.0 };
        let distance = (value - self.limit).abs();
        match self.condition {
            Condition::Above => value > self.limit - back,
            Condition::Below => value < self.limit + back,
            Condition::Equal => distance <= self.dead_band,
            Condition::Different => distance > self.dead_band,
        }
    }
}
