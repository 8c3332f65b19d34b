//! `takt-top`: a screen that shows what a running Takt does. All of it is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    takt_ctl::takt_top()
}
