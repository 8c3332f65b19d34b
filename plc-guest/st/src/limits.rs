//! How large a source may be: the compiler refuses more by name instead of running out of something.

/// The bytes of one file.
pub const FILE_BYTES: usize = 8 << 20;

/// The files of one project.
pub const FILES: usize = 4096;

/// The height of an expression, and the depth of statements, types and initial values within each
/// other. All stages walk trees by recursion; on this bound rests that none exhausts its stack.
pub const DEPTH: u32 = 200;

/// The errors that are kept for one file. A file that is no Structured Text at all would have one
/// error a token.
pub const ERRORS_PER_FILE: usize = 100;
