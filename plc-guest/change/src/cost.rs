//! How long a commit takes.
//!
//! A commit happens between two cycles, and may take 10 us of that time. What it takes is known beforehand, from the
//! plan alone: a time for each step and one for each byte. The figures are those of the deterministic lab, where an
//! instruction is a nanosecond, with a third to spare; `docs/online-change.md` has what was measured.

use crate::plan::Step;

/// The most that a plan may take by this model, in nanoseconds. The rest of the 10 us is for
/// the switch itself.
pub const COMMIT_NS: u64 = 8_000;
/// Most bytes that are read before any is written.
pub const GATHER_BYTES: u32 = 16 << 10;
/// Most bytes that are put aside for a roll-back.
pub const SAVED_BYTES: u32 = 16 << 10;

const STEP_NS: u64 = 250;
const CONVERSION_NS: u64 = 200;
const REFERENCE_NS: u64 = 100;
/// For each range that a reference is compared with, and each time that a record is read for nothing.
const RANGE_NS: u64 = 40;
/// What eight bytes take that are copied once.
const WORD_NS: u64 = 2;

/// What a plan does at the commit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// Steps of the commit.
    pub steps: u64,
    /// Bytes that move, each of which is copied twice.
    pub moved: u64,
    /// Values that are converted.
    pub converted: u64,
    /// Bytes that get their initial values.
    pub initialised: u64,
    /// Bytes that are put aside, or come back.
    pub saved: u64,
    /// References that are looked up.
    pub references: u64,
    /// Records among which they are looked up: all that write the state or say what stays in it. What leads to something that
    /// is gone is compared with each of them.
    pub ranges: u64,
    /// Records that are read twice at the commit and do nothing then.
    pub passed: u64,
    /// Bytes that get their initial values before the commit, where the old version has no state.
    pub early: u64,
}

impl Cost {
    /// Adds a step of a plan for an old state of this size.
    pub(crate) fn add(&mut self, step: &Step, old_bytes: u32) {
        if step.writes_state() {
            self.ranges += 1;
        }
        if step.is_early(old_bytes) {
            self.early += u64::from(step.bytes());
            self.passed += 1;
            return;
        }
        match *step {
            Step::Keep { .. } => {
                self.passed += 1;
                return;
            }
            Step::Copy { bytes, .. } => self.moved += u64::from(bytes),
            Step::Convert { count, .. } => self.converted += u64::from(count),
            Step::Initial { bytes, .. } => self.initialised += u64::from(bytes),
            Step::Save { bytes, .. } | Step::Restore { bytes, .. } => {
                self.saved += u64::from(bytes)
            }
            Step::Reference { .. } => self.references += 1,
        }
        self.steps += 1;
    }

    /// Bytes that are written to the state at the commit.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.moved + 8 * self.converted + self.initialised + self.saved + 8 * self.references
    }

    /// The time of the commit by this model.
    #[must_use]
    pub const fn nanoseconds(&self) -> u64 {
        let words = (2 * self.moved + self.initialised + self.saved).div_ceil(8);
        let one = REFERENCE_NS + RANGE_NS * self.ranges;
        self.steps * STEP_NS
            + self.passed * 2 * RANGE_NS
            + words * WORD_NS
            + self.converted * CONVERSION_NS
            + self.references * one
    }
}
