//! A driver for the SJA1000 CAN controller in PeliCAN mode.
//!
//! A control program reaches a CAN bus in the middle of its scan, where nothing may wait for a
//! bus, a card or an interrupt. So this driver only polls: each operation is a fixed number of
//! register accesses at most, whatever the controller answers, and says at once that there is
//! nothing to receive or that the transmit buffer is still busy. On port I/O each access can be an
//! exit from the guest, so accesses are what the operations are documented in.
//!
//! The controller is not trusted. A register that reads as something impossible, a card that was
//! never there (all ones) and one that answers at random lead to an error or to a frame that is
//! wrong, never to a longer loop or a longer frame.
//!
//! How a register is reached, by ports or by memory, and how far apart registers lie is the
//! business of [`Registers`]; [`cards`] says what is known of some cards.
//!
//! Registers and their meaning: Philips Semiconductors, SJA1000 product specification, 4 January
//! 2000, "the data sheet" in this crate.

#![no_std]
#![forbid(unsafe_code)]

mod buffer;
pub mod cards;
mod controller;
mod error;
mod filter;
mod frame;
mod registers;
mod state;
mod timing;

pub use controller::{Controller, MODE_ATTEMPTS, RECEIVE_BUFFER_FRAMES};
pub use error::{ModeError, ReceiveError, StartError, TransmitError};
pub use filter::Filter;
pub use frame::{ExtendedId, Frame, Id, IdError, LengthError, StandardId};
pub use registers::Registers;
pub use state::{BusState, ErrorCounters};
pub use timing::BitRate;
