//! `takt-ctl`: asks a running Takt, and tells it what to do. All of it is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    takt_ctl::takt_ctl()
}
