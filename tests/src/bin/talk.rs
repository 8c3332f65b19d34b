//! A client of Takt's control socket that knows nothing of Takt: what `docs/control.md` says is
//! enough.
//!
//!     talk SOCKET LINE|NUMBER|stay...
//!
//! Waits for the socket, sends each line, and prints what comes up to the line that answers it; to `trace`, that is the
//! last line of the trace. For a number it prints so many lines more; after `stay` it reads nothing any more, until it
//! is killed. Exit status: 0 if each was answered.

#![forbid(unsafe_code)]

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::Duration;

/// Between two attempts to connect.
const PAUSE: Duration = Duration::from_millis(20);
/// After these there will be no socket any more.
const ATTEMPTS: u32 = 500;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let socket = arguments.next().ok_or("no socket")?;
    let stream = connect(&socket)?;
    let mut answers = BufReader::new(stream.try_clone()?).lines();
    for line in arguments {
        if line == "stay" {
            loop {
                thread::park();
            }
        }
        if let Ok(count) = line.parse() {
            for answer in answers.by_ref().take(count) {
                println!("{}", answer?);
            }
            continue;
        }
        writeln!(&stream, "{line}")?;
        loop {
            let answer = answers.next().ok_or("the connection has ended")??;
            println!("{answer}");
            let parsed: serde_json::Value = serde_json::from_str(&answer)?;
            if !["event", "trace", "window", "switch", "values"]
                .iter()
                .any(|part| parsed["answer"] == *part)
            {
                break;
            }
        }
    }
    Ok(())
}

fn connect(socket: &str) -> std::io::Result<UnixStream> {
    for _ in 1..ATTEMPTS {
        if let Ok(stream) = UnixStream::connect(socket) {
            return Ok(stream);
        }
        thread::sleep(PAUSE);
    }
    UnixStream::connect(socket)
}
