//! The ports of a Linux partition for programs that are not written in Rust.
//!
//! A plain C interface over [`takt_port`], which `include/takt_port.h` declares and documents for its users. Its
//! rules are few, so that other languages can bind to it: handles are opaque, each function returns a code,
//! texts end with a zero, and no function keeps a pointer that it was given. `devices/port/python` is a
//! package over the same functions.
//!
//! A handle belongs to one thread at a time. Two handles may be used by two threads. A port's handle is of no use in a
//! process that is forked.
//!
//! What a caller can get wrong is checked as far as C lets it be: null pointers, texts that are not UTF-8, and
//! calls that do not fit the kind or the direction of a port are refused. A handle that was closed, and a buffer that
//! is shorter than its caller says, cannot be told from good ones.

mod code;
mod message;
mod port;
mod ports;

pub use code::{Code, takt_port_last_error};
pub use message::Message;
pub use port::{
    PortHandle, takt_port_close, takt_port_open, takt_port_read, takt_port_receive, takt_port_send,
    takt_port_write,
};
pub use ports::{
    Description, PortsHandle, takt_ports_close, takt_ports_count, takt_ports_describe,
    takt_ports_discover, takt_ports_open,
};
