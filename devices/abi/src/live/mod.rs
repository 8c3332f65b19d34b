//! What Takt and the kernel of a PLC with programs say to each other while the PLC runs.
//!
//! Two queues of the channel crate, reserved ports at the end of the port table: [`ORDERS`], which Takt
//! sends and the guest receives, and [`ANSWERS`] the other way round. Both are bounded and refuse what has
//! no room, and neither side waits for the other. Takt believes nothing that it reads in an answer, and the kernel
//! checks each order as it checks a program's call.
//!
//! The kernel takes orders only when no task is ready or will be in this window. So an order costs a program
//! nothing, and a guest that has no time to spare answers late or never.
//!
//! A message is a kind (u16), zero (u16), a number of the sender's choice (u32) and a body; numbers are
//! little-endian. The number of an answer is that of its order, and 0 if it answers none. What does not
//! have exactly the form of its kind is no message.

mod answer;
mod bytes;
mod change;
mod order;
mod place;
mod sample;

pub use answer::{
    Answer, ProgramRecord, ProgramState, Refusal, TASKS_EACH, TaskRecord, TaskState, decode_answer,
};
pub use change::{ChangePhase, ChangeReason, ChangeRecord};
pub use order::{ChangeStep, Order, RANGES_EACH, Ranges, decode_order};
pub use place::{Area, Point, Range};
pub use sample::{PAYLOAD_BYTES, RANGES_EACH_PART, STEP_TICKS, SampleHead};

/// Name of the port at which the guest receives orders. No port of a partition file has a space in its name.
pub const ORDERS: &str = "takt orders";
/// Name of the port at which the guest sends answers.
pub const ANSWERS: &str = "takt answers";
/// Longest message of both: what makes a slot of a queue 1 KiB.
pub const MESSAGE_BYTES: usize = 1000;
/// Orders that can wait.
pub const ORDERS_DEPTH: u32 = 32;
/// How many ports are reserved in the port table of a PLC with programs.
pub const RESERVED_PORTS: usize = 2;

/// Most ranges that the kernel watches at a time.
pub const WATCHED_RANGES: usize = 1024;
/// Most bytes of a sample.
pub const SAMPLE_BYTES: usize = 60 << 10;
/// Most values that the kernel keeps forced.
pub const FORCES: usize = 256;

/// A message that is being made.
pub type Buffer = [u8; MESSAGE_BYTES];
