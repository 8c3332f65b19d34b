//! What there is to tell when a run is over, in the terminal and in the folder.

use takt_figures::load::Course;
use takt_scheduler::time::Nanos;

use crate::figures::Figures;
use crate::gate::{Breach, Limits};
use crate::load::Load;
use crate::proof::Proof;

/// A measurement, and how it was made.
pub struct Measurement {
    /// What Takt has measured.
    pub figures: Figures,
    /// The command that has measured.
    pub command: String,
    /// What Linux was to do.
    pub load: Load,
    /// Whether it has; `None` if it was to do nothing.
    pub proof: Option<Proof>,
    /// What was asked for.
    pub limits: Limits,
    /// Why it was not kept.
    pub breaches: Vec<Breach>,
}

impl Measurement {
    /// A measurement of these figures, with what follows from the limits. `asked` is how long it was to last, if that
    /// is known.
    pub fn new(
        figures: Figures,
        command: String,
        load: Load,
        limits: Limits,
        asked: Option<Nanos>,
    ) -> Self {
        let proof = Proof::of(load, &figures);
        let mut breaches = limits.breaches(&figures.partitions, proof.as_ref());
        let duration = Nanos(figures.duration_ns);
        breaches.extend(limits.cut_short(&figures.partitions, duration, asked));
        Self { figures, command, load, proof, limits, breaches }
    }

    /// What Linux says that it has done, over time.
    pub fn progress(&self) -> Option<&Course> {
        self.figures.loads.first()
    }

    /// The same in words.
    pub fn meanwhile(&self) -> Option<String> {
        let Course { load, unit, points, began_ns, .. } = self.progress()?;
        let done = points.last().map_or(0, |point| point.1);
        Some(format!("{load}: {done} {unit} from {:.3} s on", *began_ns as f64 / 1e9))
    }

    /// Why the load is not proved, if that is no breach because there are no limits.
    pub fn warning(&self) -> Option<&str> {
        let proof = self.proof.as_ref().filter(|_| self.limits.none())?;
        proof.reason.as_deref()
    }
}
