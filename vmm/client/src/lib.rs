//! What all clients of Takt's control socket have in common: where the socket is, the connection, what can go wrong.
//!
//! Clients are `takt ctl`, `takt top` and the commands of `takt plc` that look at a PLC while it runs. They link this
//! and no hypervisor.

mod connection;
pub mod error;
mod place;
pub mod versions;

pub use connection::{Connection, PATIENCE, RequestSender};
pub use error::ClientError;
pub use place::{given, socket};

/// A text that cannot play with the terminal.
#[must_use]
pub fn plain(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_control() {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown
}
