//! The library and the tool on a folder of plain files.

#[path = "../loopback/mod.rs"]
mod loopback;

mod library;
mod tool;
