//! Carries the control socket out of an emulated machine. `scripts/run` and the appliance start it; users do not.

use std::io;
use std::path::Path;
use std::process::ExitCode;

use takt_carry::{inside, outside};

const USAGE: &str = "usage: takt-carry make|outside|inside LINE SOCKET

  make     makes the file LINE, and fails if SOCKET cannot be a socket
  outside  carries connections to SOCKET over LINE, until its standard input ends
  inside   the other end, in the appliance: carries them to Takt at SOCKET, until Takt ends";

/// Exit status of wrong usage, and of a socket that cannot be.
const USAGE_STATUS: u8 = 2;

fn main() -> ExitCode {
    // SAFETY: takes an integer only. Who may open the socket may tell Takt what to do.
    unsafe { libc::umask(0o077) };
    let words: Vec<_> = std::env::args_os().skip(1).collect();
    let [what, line, socket] = &words[..] else {
        eprintln!("{USAGE}");
        return ExitCode::from(USAGE_STATUS);
    };
    let (line, socket) = (Path::new(line), Path::new(socket));
    let done = match what.to_str() {
        Some("make") => outside::prepare(line, socket).map_err(|error| error.to_string()),
        Some("outside") => {
            outside::run(line, socket, &mut io::stdin()).map_err(|error| error.to_string())
        }
        Some("inside") => inside::run(line, socket).map_err(|error| error.to_string()),
        _ => Err(USAGE.to_owned()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(text) => {
            eprintln!("takt-carry: {text}");
            ExitCode::from(USAGE_STATUS)
        }
    }
}
