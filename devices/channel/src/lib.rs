//! The channels between partitions: sampling and queuing, on pages that only one side can write.
//!
//! Partitions that do not trust each other exchange messages through shared memory. A lock there
//! would let one of them stop the other, and an index that both write would let one of them
//! corrupt the other. So there is neither. Every region has exactly one writer, the MMU makes it
//! read-only for everybody else, and whatever is read from the other end's region is a claim: it
//! is checked at each use, and one that cannot be true is counted and stepped over.
//!
//! | channel | region | written by |
//! | --- | --- | --- |
//! | sampling | messages | the source |
//! | queuing | messages | the source |
//! | queuing | acknowledgement | the destination |
//!
//! Both kinds of channel share one region of messages: a ring of slots, each guarded by a sequence
//! number. A sampling channel is such a ring whose destinations look at the newest message only,
//! and a queuing channel one whose destination goes through it in order. Every operation takes a
//! bounded number of steps whatever the other end does; waiting, time-outs and doorbells are built
//! on top.
//!
//! Nothing here maps memory, reads a clock or knows a port's name. Memory comes as [`OwnPages`] and
//! [`PeerPages`], or as anything else that implements [`Load`] and [`Store`], which is how the models
//! and the hostile peers of the tests get between any two accesses. Instants come as arguments.
//!
//! Return codes, and what they mean when, are those of ARINC 653 part 1; every error has a
//! `code()`. Calls in the wrong direction (its INVALID_MODE) do not exist: an end has only the
//! operations of its direction. `docs/ports.md` describes the layout for other languages.

#![no_std]
#![deny(unsafe_code)]

mod bystander;
mod code;
mod counters;
mod layout;
mod memory;
mod open;
mod order;
mod outgoing;
mod queuing;
mod sampling;
mod slots;
mod time;

pub use bystander::{Bystander, LookError, Sight};
pub use code::ReturnCode;
pub use counters::Counters;
pub use layout::{
    DEPTH_MAX, Geometry, GeometryError, Kind, MAGIC, MESSAGE_MAX, Policy, SPARE, VERSION, offset,
};
pub use memory::{Load, Misaligned, OwnPages, PeerPages, Store};
pub use open::{Field, OpenError};
pub use outgoing::LengthError;
pub use queuing::destination::{DestinationStatus, QueuingDestination, ReceiveError, Received};
pub use queuing::source::{QueuingSource, SendError, SourceStatus};
pub use sampling::{
    ReadError, Sample, SamplingDestination, SamplingSource, SamplingStatus, Validity,
};
pub use slots::Claim;
pub use time::{Ticks, Tsc};
