//! Carries the control socket out of an emulated machine, and the files of a run into it. The scripts, the appliance and its
//! kernel start it; users do not.

use std::ffi::OsString;
use std::io;
use std::path::Path;
use std::process::ExitCode;

use takt_carry::{inside, outside, start};

const USAGE: &str = "usage: takt-carry make|outside|inside LINE SOCKET
       takt-carry start ADDRESS

  make     makes the file LINE, and fails if SOCKET cannot be a socket
  outside  carries connections to SOCKET over LINE, until its standard input ends
  inside   the other end, in the appliance: carries them to Takt at SOCKET, until Takt ends
  start    as the first process of an appliance: stops the machine for a snapshot, takes the files of a run from
           the PCI function at ADDRESS when it goes on, and becomes the ordinary first process";

/// The word for [`start`].
const START: &str = "start";
/// Exit status of wrong usage, and of a socket that cannot be.
const USAGE_STATUS: u8 = 2;

fn main() -> ExitCode {
    let words = words();
    let done = match &words[..] {
        [what, line, socket] => carry(what.to_str(), Path::new(line), Path::new(socket)),
        [what, address] if what == START => Some(match start::run(address) {
            Ok(never) => match never {},
            Err(error) => Err(error.to_string()),
        }),
        _ => None,
    };
    match done {
        Some(Ok(())) => return ExitCode::SUCCESS,
        Some(Err(text)) => eprintln!("takt-carry: {text}"),
        None => eprintln!("{USAGE}"),
    }
    ExitCode::from(USAGE_STATUS)
}

/// The words behind the program's name. The kernel gives its first process those too that it does not know itself, and the
/// program's own behind them.
fn words() -> Vec<OsString> {
    let is_first = std::process::id() == 1;
    std::env::args_os().skip(1).skip_while(|word| is_first && word != START).collect()
}

/// One of the three that have to do with the control socket; `None` if it is none of them.
fn carry(what: Option<&str>, line: &Path, socket: &Path) -> Option<Result<(), String>> {
    // SAFETY: takes an integer only. Who may open the socket may tell Takt what to do. What becomes the first process
    // must not have this: Takt's files would get other modes than in a machine that starts from nothing.
    unsafe { libc::umask(0o077) };
    Some(match what? {
        "make" => outside::prepare(line, socket).map_err(|error| error.to_string()),
        "outside" => {
            outside::run(line, socket, &mut io::stdin()).map_err(|error| error.to_string())
        }
        "inside" => inside::run(line, socket).map_err(|error| error.to_string()),
        _ => return None,
    })
}
