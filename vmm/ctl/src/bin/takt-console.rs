//! `takt-console`: the console of one partition of a running Takt. All of it is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    takt_ctl::takt_console()
}
