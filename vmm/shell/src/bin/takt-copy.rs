//! `takt-copy`: copies files to and from a Linux partition. All of it is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    takt_shell::takt_copy()
}
