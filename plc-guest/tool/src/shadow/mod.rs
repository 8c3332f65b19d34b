//! A second version of a program beside the one that runs in a PLC: it computes here, from what is watched.
//!
//! The running version's state, inputs, outputs and markers are watched in each cycle. The new version begins with the
//! state, carried over as a commit would, and has the same inputs in each cycle since. Its outputs go nowhere and are compared
//! with those of the PLC ([`Comparison`]).
//!
//! A job that runs here could be another than the PLC's: time of execution, preemption, messages and an operator's
//! writes are not here. So the running version is run here as well, for each cycle from the state that was seen, and what it comes to
//! is compared with what was seen. Cycles in which they differ are counted.

mod carry;
mod comparison;
#[cfg(test)]
mod tests;
mod twin;

pub use comparison::{Comparison, Output, Tolerance};
pub use twin::{Twin, Watched};

use takt_change::make::Change;
use takt_program::Image;

use crate::run::{Failed, HostError};

/// Two versions side by side.
pub struct Versions<'a> {
    running: Twin<'a>,
    new: Twin<'a>,
    plan: Vec<u8>,
    images: [Image<'a>; 2],
    times: Times,
    last: Option<Line>,
    /// The cycle of the last line.
    seen: Option<u64>,
    pub extent: Extent,
}

/// Of the PLC's schedule, in nanoseconds.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// Jobs that are released so long behind a window's release belong to it.
    pub window_ns: u64,
    /// Two windows are at most so far apart.
    pub frame_ns: u64,
}

/// What was watched after a window's work.
#[derive(Clone, Debug)]
pub struct Line {
    pub cycle: u64,
    /// The window's release as the program sees it.
    pub time_ns: u64,
    /// The program was in the middle of something.
    pub unsettled: bool,
    pub watched: Watched,
}

/// How much was compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Cycles that both versions computed.
    pub cycles: u64,
    /// Cycles that were not seen, or in which the program was in the middle of something. Behind each stretch of them the new
    /// version begins anew with the state of the running one.
    pub missing: u64,
    /// How often it began.
    pub begun: u64,
    /// Cycles of the longest stretch.
    pub longest: u64,
    /// Cycles of this stretch.
    stretch: u64,
    /// Cycles in which the running version came to something else here than in the PLC, and the first of them.
    pub strayed: u64,
    pub first_strayed: Option<u64>,
}

/// The outputs of both versions after a cycle.
pub struct Outputs {
    pub cycle: u64,
    pub running: Vec<u8>,
    pub new: Vec<u8>,
}

impl<'a> Versions<'a> {
    /// Of a running version and a new one, between which a change can be made.
    pub fn new(
        images: [Image<'a>; 2],
        change: &Change,
        times: Times,
        limit: std::time::Duration,
    ) -> Result<Self, HostError> {
        let [running, new] = images;
        let plan = change.plans.as_ref().map(|plans| &plans.forward);
        let plan = plan.or(change.large.as_ref().map(|large| &large.forward));
        Ok(Self {
            running: Twin::new(running, limit)?,
            new: Twin::new(new, limit)?,
            plan: plan.cloned().unwrap_or_default(),
            images,
            times,
            last: None,
            seen: None,
            extent: Extent::default(),
        })
    }

    /// Takes what was watched next. Gives the outputs of a cycle that both have computed.
    ///
    /// # Errors
    /// If the new version cannot go on.
    pub fn take(&mut self, line: Line) -> Result<Option<Outputs>, Failed> {
        let gap = self.seen.map_or(0, |seen| line.cycle.saturating_sub(seen).saturating_sub(1));
        self.seen = Some(line.cycle);
        self.extent.missing = self.extent.missing.saturating_add(gap + u64::from(line.unsettled));
        let last = self.last.take().filter(|last| {
            let apart = line.time_ns.checked_sub(last.time_ns);
            gap == 0 && apart.is_some_and(|apart| (1..=self.times.frame_ns).contains(&apart))
        });
        let outputs = match last {
            _ if line.unsettled => None,
            Some(last) => Some(self.compute(&last, &line)?),
            None => {
                self.begin(&line);
                None
            }
        };
        let extent = &mut self.extent;
        extent.stretch = if outputs.is_some() { extent.stretch + 1 } else { 0 };
        extent.cycles += u64::from(outputs.is_some());
        extent.longest = extent.longest.max(extent.stretch);
        self.last = (!line.unsettled).then_some(line);
        Ok(outputs)
    }

    /// The new version begins where the running one is.
    fn begin(&mut self, line: &Line) {
        let [running, new] = &self.images;
        let state = carry::carried(&self.plan, running, new, &line.watched.state);
        self.new.set(&Watched { state, ..line.watched.clone() });
        self.new.begin(line.time_ns.saturating_add(self.times.window_ns));
        self.extent.begun += 1;
    }

    fn compute(&mut self, last: &Line, line: &Line) -> Result<Outputs, Failed> {
        let nanoseconds = line.time_ns - last.time_ns;
        self.running.set(&last.watched);
        self.running.begin(last.time_ns.saturating_add(self.times.window_ns));
        let inputs = &line.watched.inputs;
        // It may even fail here, after what an operator wrote in between.
        if self.running.run(inputs, nanoseconds).is_err() || self.running.watched() != line.watched
        {
            self.extent.strayed += 1;
            self.extent.first_strayed.get_or_insert(line.cycle);
        }
        self.new.run(inputs, nanoseconds)?;
        let (running, new) = (line.watched.outputs.clone(), self.new.outputs());
        Ok(Outputs { cycle: line.cycle, running, new })
    }
}
