//! Why a change cannot be made while the program runs.

use core::fmt;
use std::string::String;

use takt_program::Version;

use crate::cost::{COMMIT_NS, GATHER_BYTES, SAVED_BYTES};
use crate::large;
use crate::plan::{Defect, RECORDS};

/// A reason, for engineers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Something that must be the same is not.
    Different {
        /// What it is: the category, a task's period.
        what: String,
        /// As the old version has it.
        old: String,
        /// As the new version has it.
        new: String,
    },
    /// Something is there in one version only.
    Missing {
        /// What it is.
        what: String,
        /// True if it is the new version that has it.
        is_new: bool,
    },
    /// Bytes of the state that no variable names.
    Nameless {
        /// In which version.
        version: Version,
        /// Where they begin in the state.
        at: u32,
        /// How many there are.
        bytes: u32,
    },
    /// Two variables share bytes, and not both stay as they are.
    Shared {
        /// One.
        one: String,
        /// The other.
        other: String,
    },
    /// A reference whose target has another type now, or a type that is not told.
    Reference {
        /// The reference.
        name: String,
    },
    /// Something of a type that there are references to, whose length or elements change.
    Target {
        /// The variable, or a part of one.
        name: String,
    },
    /// An event task waits for the rise of a variable that does not stay where it is.
    Rise {
        /// The variable.
        name: String,
    },
    /// It takes too many steps, even with a second state.
    Steps,
    /// It takes too many steps for one state.
    Records,
    /// It moves, or puts aside, more bytes than there is room for.
    Room,
    /// It takes longer than a commit may.
    Cost {
        /// So long, in nanoseconds.
        nanoseconds: u64,
    },
    /// The partition in which the program runs does not allow it.
    Partition(String),
    /// The plan that was made is not valid: an error of this program.
    Plan(Defect),
}

impl Refusal {
    /// Whether it says only that too much moves between two cycles.
    pub(super) const fn is_of_size(&self) -> bool {
        matches!(self, Self::Records | Self::Room | Self::Cost { .. })
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Different { what, old, new } => {
                write!(f, "{what} is {new}, and {old} in the running version")
            }
            Self::Missing { what, is_new: true } => {
                write!(f, "{what} is not there in the running version")
            }
            Self::Missing { what, is_new: false } => {
                write!(f, "{what} is not there in the new version")
            }
            Self::Nameless { version, at, bytes } => write!(
                f,
                "version {version} has {bytes} bytes of state at offset {at} that no variable names, so \
                 that they cannot be carried over; declare them as variables"
            ),
            Self::Shared { one, other } => write!(
                f,
                "{one} and {other} share memory, and not both stay at their place with their type"
            ),
            Self::Reference { name } => write!(
                f,
                "{name} is a reference to something whose type changes, or is not told in the image"
            ),
            Self::Target { name } => write!(
                f,
                "{name} loses elements, or its rows get another length, in the new version or at a roll-back, and there are \
                 references to its type: one would lead behind its end"
            ),
            Self::Rise { name } => {
                write!(f, "an event task waits for the rise of {name}, which gets to another place")
            }
            Self::Steps => write!(f, "the change takes more than {} steps", large::RECORDS),
            Self::Records => write!(f, "the change takes more than {RECORDS} steps"),
            Self::Room => write!(
                f,
                "the change moves more than {GATHER_BYTES} bytes, or puts more than {SAVED_BYTES} aside for \
                 a roll-back"
            ),
            Self::Cost { nanoseconds } => write!(
                f,
                "moving the state would take {nanoseconds} ns by the model, and {COMMIT_NS} ns is the most \
                 between two cycles"
            ),
            Self::Partition(text) => f.write_str(text),
            Self::Plan(defect) => write!(f, "the plan is not valid: {defect}"),
        }
    }
}
