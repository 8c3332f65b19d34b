//! The library against tables of expected values: the functions of the standard (`tests/standard`), and the
//! function blocks, whose tables are those of the crate `takt-blocks`.
//!
//! `language` has programs about the language itself. Each table becomes a program of ST with a task that makes the calls and compares. It runs on the
//! interpreter of the typed tree and as machine code.

mod blocks;
mod calls;
mod functions;
mod language;
#[path = "../machine/mod.rs"]
mod machine;
#[path = "../oracle/mod.rs"]
#[allow(dead_code, reason = "the interpreter is made for other tests too")]
mod oracle;
mod program;
mod widths;
