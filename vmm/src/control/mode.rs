//! How the start of a partition is called on the control socket.

use super::protocol::Mode;
use crate::boot::StartMode;

impl From<Mode> for StartMode {
    fn from(mode: Mode) -> StartMode {
        match mode {
            Mode::Cold => StartMode::Cold,
            Mode::Warm => StartMode::Warm,
        }
    }
}

impl From<StartMode> for Mode {
    fn from(mode: StartMode) -> Mode {
        match mode {
            StartMode::Cold => Mode::Cold,
            StartMode::Warm => Mode::Warm,
        }
    }
}
