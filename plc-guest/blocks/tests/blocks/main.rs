//! The blocks against tables of expected values (`tests/tables`), in Rust and in C.

mod in_c;
mod in_rust;
mod table;
