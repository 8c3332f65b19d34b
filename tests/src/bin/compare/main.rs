//! What a message costs within one Linux: through a port channel, and through what Linux offers for
//! the same.
//!
//!     compare [COUNT]
//!
//! Every transport carries COUNT messages of 512 bytes, twice. With one thread, that sends and then
//! receives each: the time from the one to the other, and CPU time, without any switch of
//! threads. With two threads, of which one waits for the message: in a socket's `read`, or
//! for a channel, which has no doorbell within a process, by looking and yielding. Needs the
//! loopback interface up, and `vsock_loopback` loaded; what is not there is left out and said so.

#![deny(unsafe_code)]

mod channels;
mod measure;
mod sockets;

use std::io;
use std::process::ExitCode;

use measure::{Measured, measure};

/// Sends messages.
trait Sending: Send {
    /// Sends one; the other end must have room for it.
    fn send(&mut self, message: &[u8; BYTES]) -> io::Result<()>;
}

/// Receives messages.
trait Receiving: Send {
    /// Waits for one.
    fn receive(&mut self, message: &mut [u8; BYTES]) -> io::Result<()>;
}

type Ends = (Box<dyn Sending>, Box<dyn Receiving>);
type Connect = fn() -> io::Result<Ends>;

/// Bytes of a message.
const BYTES: usize = takt_tests::record::BYTES;
const TRANSPORTS: [(&str, Connect); 5] = [
    ("queuing channel", channels::queuing),
    ("sampling channel", channels::sampling),
    ("socket pair", sockets::pair),
    ("TCP loopback", sockets::tcp),
    ("vsock loopback", sockets::vsock),
];

fn main() -> ExitCode {
    let argument = std::env::args().nth(1);
    let Ok(count) = argument.as_deref().unwrap_or("2000").parse::<usize>() else {
        eprintln!("usage: compare [COUNT]");
        return ExitCode::from(64);
    };
    println!("compare: {count} messages of {BYTES} bytes, one way, in ns");
    println!(
        "{:18}{:>10}{:>10}{:>10}{:>14}{:>10}",
        "", "1 thread", "p99", "CPU", "2 threads", "p99"
    );
    let mut status = ExitCode::SUCCESS;
    for (name, connect) in TRANSPORTS {
        match connect().and_then(|ends| measure(ends, count.max(1))) {
            Ok(Measured { alone, cpu, two }) => println!(
                "{name:18}{:>10}{:>10}{cpu:>10}{:>14}{:>10}",
                alone.median, alone.p99, two.median, two.p99
            ),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                println!("{name:18}{error}");
                status = ExitCode::FAILURE;
            }
            Err(error) => println!("{name:18}not measured: {error}"),
        }
    }
    status
}
