//! The channels by their public interface: rules, model, restarts, interleavings, hostile peers,
//! and the layout that other languages see.

// Models replace the ring's dimensions, and `tests/loom.rs` is what runs then.
#![cfg(not(loom))]

mod attach;
mod bystander;
mod claims;
mod header;
mod hostile;
mod memory;
mod model;
mod pages;
mod queuing_rules;
mod restart;
mod sampling_rules;
mod tearing;
