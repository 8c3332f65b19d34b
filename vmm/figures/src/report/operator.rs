//! What a report tells of values that operators have written and forced.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What operators did with the values of a PLC.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Operator {
    /// Values that were written once.
    pub written: u64,
    /// Orders to force a value, also of one that was forced already.
    pub forced: u64,
    /// What was forced when the run ended.
    pub at_the_end: Vec<Forced>,
}

/// A forced value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Forced {
    /// As the client called it.
    pub name: String,
    /// The value, as the client called it.
    pub text: String,
    /// Since when, since the epoch.
    pub since_ns: u64,
}

impl fmt::Display for Operator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "values written {}, forced {}", self.written, self.forced)?;
        for (place, Forced { name, text, .. }) in self.at_the_end.iter().enumerate() {
            let before = if place == 0 { "; at the end were forced" } else { "," };
            write!(f, "{before} {name} := {text}")?;
        }
        Ok(())
    }
}
