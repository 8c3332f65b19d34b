//! What the Linux guest does while the releases are measured.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// The kernel parameter that tells the guest.
const PARAMETER: &str = "takt.load";

/// A load. The guest's `/init` makes it; see `docs/jitter.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Load {
    /// Compile C sources, in parallel.
    Compile,
    /// Compute.
    Cpu,
    /// Start processes.
    Fork,
    /// Map and fill memory.
    Memory,
    /// Read and write files.
    Io,
    /// Run stress-ng: timers at 20 kHz, page faults, forks, system calls.
    Stress,
    /// Only what the partition file says.
    None,
}

impl Load {
    /// The name, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Load::Compile => "compile",
            Load::Cpu => "cpu",
            Load::Fork => "fork",
            Load::Memory => "memory",
            Load::Io => "io",
            Load::Stress => "stress",
            Load::None => "none",
        }
    }

    /// The word for the guest's command line.
    pub fn parameter(self) -> Option<String> {
        (self != Load::None).then(|| format!("{PARAMETER}={}", self.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_guest_is_told_by_the_name_of_the_command_line() {
        for load in Load::value_variants() {
            let value = load.to_possible_value().unwrap();
            assert_eq!(value.get_name(), load.name());
        }
        assert_eq!(Load::Compile.parameter().as_deref(), Some("takt.load=compile"));
        assert_eq!(Load::None.parameter(), None);
    }
}
