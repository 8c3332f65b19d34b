//! What happens to a variable, as engineers are told.

use std::string::String;

/// What happens to a variable, or to the parts of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name. The elements of an array that share their fate are `name[1..8]`.
    pub name: String,
    /// Its type in the new version; in the old one if it is dropped.
    pub ty: String,
    /// What happens.
    pub fate: Fate,
}

/// What happens to a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It stays where it is.
    Kept,
    /// It gets to another place.
    Moved,
    /// It gets to another type, without a loss.
    Converted {
        /// From this type.
        from: String,
    },
    /// It is new, and begins with its initial value.
    New,
    /// It begins with its initial value, because the type that it had does not widen to its type.
    Anew {
        /// The type that it had.
        from: String,
    },
    /// It is gone.
    Dropped,
}

impl Fate {
    /// One word for it.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::Moved => "moved",
            Self::Converted { .. } => "converted",
            Self::New => "new",
            Self::Anew { .. } => "starts anew",
            Self::Dropped => "dropped",
        }
    }
}
