//! The ports of a Linux partition, for programs that run in it.
//!
//! Takt gives a Linux guest its ends of channels as a PCI function: memory that it can read, and
//! memory that it can write. No driver is needed for them, since sysfs lets root map both; so this
//! is a library of user space, and the guest's kernel stays as its distribution built it. Messages
//! never pass through that kernel: writing and reading are loads and stores (`takt-channel`), and
//! only waiting is a system call.
//!
//! [`Ports::discover`] finds the function, and [`Ports::output`], [`Ports::input`],
//! [`Ports::sender`] and [`Ports::receiver`] take an end for this process. An end has one owner at
//! a time; a lock on the function's file sees to that, and goes with the process. What happens to
//! the messages between two owners is [`Start`].
//!
//! What the channel crate leaves out is added here: time. Calls with a [`Timeout`] wait for the
//! doorbell if the channel has one, by way of `uio_pci_generic`, and look again every
//! [`POLL_INTERVAL`] if it has none. A doorbell says only that it is worth looking: every wait is
//! between two looks at the channel, and begins to listen before the first of them, so that a
//! ring is never slept through and a needless one does no harm.
//!
//! The table that describes the ports is Takt's own and cannot be changed by anybody. It is checked
//! all the same, because everything that follows computes addresses with it.

#![deny(unsafe_code)]

mod claim;
mod clock;
mod error;
mod function;
mod map;
mod ports;
mod queuing;
mod sampling;
mod status;
mod table;
mod wait;

pub use clock::Clock;
pub use error::{CallError, PortError, PortsError};
pub use function::{DEVICE, VENDOR};
pub use ports::{Ports, Start};
pub use queuing::{Receiver, Sender};
pub use sampling::{Input, Output};
pub use status::{Newest, Status};
pub use table::{Direction, Kind, Port, Region, TableError};
pub use takt_channel as channel;
pub use wait::{POLL_INTERVAL, Timeout};
