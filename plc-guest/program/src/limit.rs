//! The largest program. The limits hold for each image; a partition file may set lower ones.

/// Most tasks of a program.
pub const TASKS: u32 = 16;
/// Most kernel objects of a program.
pub const OBJECTS: u32 = 64;
/// Most channel ports of a program.
pub const PORTS: u32 = 64;
/// Most variables in the table. An array is one variable.
pub const VARIABLES: u32 = 65_536;
/// Most types, fields of structures, and values of enumerations: this many of each.
pub const TYPES: u32 = 65_536;
/// How deep types may be nested, so that a reader of them can recurse.
pub const TYPE_DEPTH: u16 = 32;
/// Most entries of the trap map and of the line map, each.
pub const PLACES: u32 = 1 << 20;
/// Largest code segment, in bytes.
pub const CODE_BYTES: u32 = 16 << 20;
/// Largest constant segment, in bytes.
pub const CONSTANT_BYTES: u32 = 16 << 20;
/// Largest state, in bytes.
pub const STATE_BYTES: u32 = 64 << 20;
/// Largest of each: input image, output image, markers. In bytes.
pub const PROCESS_IMAGE_BYTES: u32 = 64 << 10;
/// Largest section of strings, in bytes.
pub const STRING_BYTES: u32 = 8 << 20;
/// Largest stack of a task, in bytes: its slot without the guard page.
pub const STACK_BYTES: u32 = 0xf_f000;
/// Longest name, in bytes.
pub const NAME_BYTES: u32 = 255;
/// Longest path of a source file, in bytes.
pub const PATH_BYTES: u32 = 1024;
/// Longest message in a queue or mailbox, in bytes.
pub const MESSAGE_BYTES: u32 = 4096;
/// Most messages in a queue.
pub const QUEUE_DEPTH: u32 = 1024;
/// Longest period, and longest time between two events: one hour, in nanoseconds.
pub const PERIOD_NS: u64 = 3_600_000_000_000;
/// Longest line that a program may log at once, in bytes.
pub const LOG_BYTES: u32 = 120;
/// Lines that a program may log one after the other.
pub const LOG_LINES: u32 = 32;
/// Time after which a program may log one line more, in nanoseconds.
pub const LOG_STEP_NS: u64 = 20_000_000;
/// Longest wait of a call: one hour, in nanoseconds.
pub const WAIT_NS: u64 = 3_600_000_000_000;
