//! How large a source may be: the compiler refuses more by name instead of running out of something.

/// The bytes of one file.
pub const FILE_BYTES: usize = 8 << 20;

/// The files of one project.
pub const FILES: usize = 4096;

/// How deep statements, types, initial values and parts of expressions may be within each other. All
/// stages walk trees by recursion; on this bound and the next rests that none exhausts its stack.
pub const DEPTH: u32 = 100;

/// The height of an expression's tree. `a + b + c` is a tree as high as it has operators, and `ADD(a, b, c)` one as high as
/// it has arguments.
pub const HEIGHT: u32 = 250;

/// The stack that any stage takes at most, in bytes; see [`crate::stack`].
pub const STACK: usize = 64 << 20;

/// The errors that are kept for one file. A file that is no Structured Text at all would have one
/// error a token.
pub const ERRORS_PER_FILE: usize = 100;
