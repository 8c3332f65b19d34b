//! Carries the control socket out of an emulated machine, and the files of a run into it.
//!
//! Files go in where a machine goes on from a snapshot ([`start`]). The rest is about the control socket.
//!
//! `scripts/run` runs Takt in an appliance inside of QEMU where this machine has no KVM. Takt's control socket is
//! then a file of the appliance, and the user's terminal is outside. Two ends of this crate make it look as if the
//! socket were here: clients connect to a socket at the path that the partition file names, and each connection
//! goes on in the appliance as one of Takt's own.
//!
//! ```text
//!  client -- socket -- outside end == line: memory of the emulated machine == inside end -- socket -- Takt
//! ```
//!
//! The [`line`](Line) is a device of the emulated machine that is only memory. It causes no interrupt, and no exit.
//! The inside end has no timer: it waits for Takt's answer to a `ping`, which comes with the turn in which Takt
//! looks at its clients, and that turn lies outside of all windows. So a client wakes neither the appliance's
//! kernel nor any thread there, however much it sends (`docs/decisions/0019-control-socket-carried-out.md`).
//!
//! Neither end trusts the other: frames that make no sense have no effect, and what one end holds for a connection is
//! bounded by [`WINDOW`], whatever the other end claims.

mod connection;
mod connections;
mod frame;
pub mod inside;
mod line;
pub mod outside;
pub mod start;

pub use connection::WINDOW;
pub use connections::{CONNECTIONS_MAX, Connections};
pub use frame::{Frame, PAYLOAD_MAX};
pub use line::{BYTES, Line, LineError, Side};
