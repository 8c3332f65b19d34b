//! The driver by its public interface, against a model of the controller and against nonsense.

mod chip;
mod filter;
mod frames;
mod hostile;
mod start;
mod state;
