//! How the host's tick lay to the windows.

use std::fmt;

use serde::{Deserialize, Serialize};
use takt_scheduler::quiet;

/// How the host's tick lay to the windows.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Tick {
    /// From one to the next.
    pub period_ns: u64,
    /// What is clear of it, from the epoch on; `null` if it meets releases wherever it lies.
    pub clear: Option<Clear>,
    /// How far it may creep in either direction until that is clear no more.
    pub margin_ns: u64,
    /// How far it has crept: the host's clock against the TSC, from the start to the end.
    pub crept_ns: u64,
}

/// What is clear of the host's tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clear {
    /// All windows, from their guards to their ends.
    Windows,
    /// The releases, from their guards on.
    Releases,
}

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |ns: u64| ns as f64 / 1e3;
        write!(f, "host's tick: every {:.0} us, ", us(self.period_ns))?;
        match self.clear {
            None => f.write_str("wherever it lies it meets releases")?,
            Some(Clear::Windows) => write!(f, "{:.0} us off all windows", us(self.margin_ns))?,
            Some(Clear::Releases) => {
                write!(f, "in windows, {:.0} us off all releases", us(self.margin_ns))?;
            }
        }
        write!(f, " at the start, crept by {:.3} us", us(self.crept_ns))?;
        if self.clear.is_some() && self.crept_ns > self.margin_ns {
            f.write_str(", further than that")?;
        }
        Ok(())
    }
}

impl From<quiet::Clear> for Clear {
    fn from(clear: quiet::Clear) -> Self {
        match clear {
            quiet::Clear::Windows => Clear::Windows,
            quiet::Clear::Releases => Clear::Releases,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_that_has_come_to_the_windows_is_told() {
        let tick = |crept_ns| Tick {
            period_ns: 4_000_000,
            clear: Some(Clear::Windows),
            margin_ns: 337_000,
            crept_ns,
        };
        let told = "host's tick: every 4000 us, 337 us off all windows at the start, crept by ";
        assert_eq!(tick(337_000).to_string(), format!("{told}337.000 us"));
        assert_eq!(tick(337_001).to_string(), format!("{told}337.001 us, further than that"));
    }
}
