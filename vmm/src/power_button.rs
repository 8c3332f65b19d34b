//! The power button of a Linux: how Takt asks it to switch itself off at the end of a run.
//!
//! The tables have a button and what brings word of it, a *generic event device* (ACPI 6.5, section 5.6.9): an
//! interrupt whose method notifies the button. That is all that a machine without fixed hardware needs. The
//! kernel makes a key of it, which systemd-logind or acpid take for the wish that it is.

use std::sync::Arc;

use takt_scheduler::time::Nanos;
use vmm_sys_util::eventfd::EventFd;

use crate::vcpu::guest::End;

/// What the supervisor knows of it.
#[derive(Debug)]
pub struct PowerButton {
    wire: Arc<EventFd>,
    patience: Nanos,
    pressed: Option<Nanos>,
}

impl PowerButton {
    /// A button on this wire, whose guest has so long to switch itself off.
    #[must_use]
    pub fn new(wire: Arc<EventFd>, patience: Nanos) -> Self {
        Self { wire, patience, pressed: None }
    }

    /// How long the guest has.
    #[must_use]
    pub fn patience(&self) -> Nanos {
        self.patience
    }

    /// Presses it.
    pub fn press(&mut self, now: Nanos) {
        self.pressed = Some(now);
        // Fails only if 2^64 presses wait, and then there is one.
        let _ = self.wire.write(1);
    }

    /// Whether it has been pressed.
    #[must_use]
    pub fn is_pressed(&self) -> bool {
        self.pressed.is_some()
    }

    /// What came of it; `None` if it was never pressed. `end` is how and when the guest ended.
    #[must_use]
    pub fn report(&self, end: Option<(End, Nanos)>) -> Option<crate::report::PowerOff> {
        let asked = self.pressed?;
        let off = end.filter(|(end, _)| *end == End::PoweredOff).map(|(_, at)| at.less(asked).0);
        Some(crate::report::PowerOff { asked_ns: asked.0, took_ns: off })
    }
}
