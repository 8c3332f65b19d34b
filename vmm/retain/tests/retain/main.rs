//! Generations, their files, and what a start takes of them.

mod common;
mod hostile;
mod killed;
mod restore;
