//! What there is to tell when a run is over, in the terminal and in the folder.

use takt_figures::load::Course;
use takt_scheduler::time::Nanos;

use crate::figures::Figures;
use crate::gate::{Breach, Limits};
use crate::load::Load;
use crate::proof::Proof;

/// How a measurement was made.
pub struct Manner {
    /// The command that has measured.
    pub command: String,
    /// What Linux was to do.
    pub load: Load,
    /// How long it was to last, if that is known.
    pub asked: Option<Nanos>,
}

/// A measurement, and how it was made.
pub struct Measurement {
    /// What Takt has measured.
    pub figures: Figures,
    /// How it was measured.
    pub manner: Manner,
    /// Whether Linux has made the load; `None` if it was to make none.
    pub proof: Option<Proof>,
    /// What was asked for.
    pub limits: Limits,
    /// Why it was not kept.
    pub breaches: Vec<Breach>,
}

impl Measurement {
    /// A measurement of these figures, with what follows from the limits.
    pub fn new(figures: Figures, manner: Manner, limits: Limits) -> Self {
        let proof = Proof::of(manner.load, &figures);
        let mut breaches = limits.breaches(&figures.partitions, proof.as_ref());
        let duration = Nanos(figures.duration_ns);
        breaches.extend(limits.cut_short(&figures.partitions, duration, manner.asked));
        breaches.extend(limits.schedule_changed(figures.last_switch_ns));
        Self { figures, manner, proof, limits, breaches }
    }

    /// What Linux says that it has done, over time: the one that the proof is about.
    pub fn progress(&self) -> Option<&Course> {
        match &self.proof {
            Some(proof) => self.figures.load(&proof.partition),
            None => self.figures.loads.first(),
        }
    }

    /// The same in words.
    pub fn meanwhile(&self) -> Option<String> {
        let Course { partition, load, unit, points, began_ns, .. } = self.progress()?;
        let done = points.last().map_or(0, |point| point.1);
        let began = *began_ns as f64 / 1e9;
        Some(format!("{partition}: {load}, {done} {unit} from {began:.3} s on"))
    }

    /// Why the load is not proved, if that is no breach because there are no limits.
    pub fn warning(&self) -> Option<&str> {
        let proof = self.proof.as_ref().filter(|_| self.limits.none())?;
        proof.reason.as_deref()
    }
}
