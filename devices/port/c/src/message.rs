//! What is known of a message beside its bytes.

/// A message that was read or received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Message {
    /// Bytes of the message, which are in the buffer.
    pub length: usize,
    /// When it was written, by the time-stamp counter.
    pub stamp: u64,
    /// Nanoseconds since then. 0 for a queuing port.
    pub age_ns: u64,
    /// 1 if the age is within the refresh period of the partition file. 1 for a queuing port.
    pub valid: i32,
    /// 1 if messages before this one were overwritten. 0 for a sampling port.
    pub overflowed: i32,
}
