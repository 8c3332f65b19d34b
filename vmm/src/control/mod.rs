//! The control socket: how an operator's program asks a running Takt, and tells it what to do.
//!
//! A plant is not run from a keyboard alone: another program wants to see whether the PLC keeps its
//! time, and to stop a partition or switch the schedule. It does so through a Unix socket, one line
//! of JSON for each request and each answer ([`protocol`]; `docs/control.md` is its reference).
//!
//! ```text
//!  client --connect, lines--> Door, Client (bounded) --Request--> Operator
//!         <--lines----------- Server, Journal            <--Answer---
//! ```
//!
//! Who may do that is a matter of the file's permissions: the socket belongs to the user who started
//! Takt, and other users cannot open it (mode 0600), or only see ([`Door`]). A client is not trusted beyond that. It may hang,
//! flood or send garbage, and none of it may delay a partition. So:
//!
//! * The supervisor thread serves all clients on its tick and is never woken by one. However often a
//!   client writes, it is looked at fifty times a second, for a bounded number of requests.
//! * Every buffer has an end. A client that sends a line that is too long, or does not read what it asked
//!   for, is let go of.
//! * vCPU threads take no part in it. An order to one is a flag and a kick, as at the run's end.

mod channels;
mod client;
mod consoles;
mod door;
mod facts;
mod mode;
mod operated;
mod operator;
mod operators;
mod orders;
mod programs;
mod server;
#[cfg(test)]
mod tests;
mod tracing;

pub use channels::ViewError;
pub use consoles::KEPT_BYTES;
pub use door::{Door, DoorError};
pub use operator::Operator;
pub use operators::Operators;
pub use orders::Outcome;
pub use server::Server;
pub use takt_protocol as protocol;
