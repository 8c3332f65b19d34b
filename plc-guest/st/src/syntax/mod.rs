//! From text to a syntax tree.
//!
//! [`token`] says what the words are, [`ast`] what the tree is.

pub mod ast;
pub mod token;
