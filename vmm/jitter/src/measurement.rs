//! What there is to tell when a run is over, in the terminal and in the folder.

use crate::figures::Figures;
use crate::gate::{Breach, Limits};
use crate::load::{Load, Progress};

/// A measurement, and how it was made.
pub struct Measurement {
    /// What Takt has measured.
    pub figures: Figures,
    /// The command that has measured.
    pub command: String,
    /// What Linux was to do.
    pub load: Load,
    /// What Linux says that it has done.
    pub progress: Option<Progress>,
    /// What was asked for.
    pub limits: Limits,
    /// Where it was not kept.
    pub breaches: Vec<Breach>,
}

impl Measurement {
    /// What Linux says that it has done, in words.
    pub fn meanwhile(&self) -> Option<String> {
        let Progress { load, count, unit } = self.progress.as_ref()?;
        Some(format!("{load}: {count} {unit}"))
    }
}
