//! What is said of the consoles of partitions.

use serde::{Deserialize, Serialize};

/// Most bytes in one request to type.
pub const TYPED_MAX: usize = 4096;

/// A console, as a client that attaches to it finds it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConsoleStart {
    /// Whose.
    pub partition: String,
    /// True for that of a Linux: it is a terminal, and can be typed at. A PLC writes lines of text.
    pub terminal: bool,
    /// Bytes that the partition has written and Takt does not keep any more.
    pub before: u64,
    /// What it has written last, as hexadecimal digits.
    pub bytes: String,
}

/// Something that a partition has written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConsoleOutput {
    /// Whose.
    pub partition: String,
    /// Bytes before these that the client did not get, because it did not read fast enough.
    pub missed: u64,
    /// The bytes, as hexadecimal digits.
    pub bytes: String,
}
