//! From text to a syntax tree.
//!
//! [`token`] says what the words are, [`ast`] what the tree is; [`lexer`] and [`parser`] make them.

pub mod ast;
pub mod lexer;
pub mod literal;
pub mod parser;
pub mod token;
