//! The answers to questions about a text: one file for each kind.

pub mod complete;
pub mod diagnostics;
pub mod format;
pub mod hover;
pub mod outline;
pub mod places;
pub mod rename;
