//! `takt plc lsp`: the language server, which an editor starts.

use std::io::{BufReader, stdin, stdout};

use takt_lsp::End;

use crate::{Failure, status};

/// Arguments of `lsp`.
#[derive(clap::Args)]
pub struct Lsp {
    /// The standard input and output are the connection. There is no other; editors like to say so.
    #[arg(long)]
    stdio: bool,
}

impl Lsp {
    pub fn run(self) -> Result<(), Failure> {
        // Either way: see the argument.
        let _ = self.stdio;
        match takt_lsp::run(BufReader::new(stdin()), stdout()) {
            Ok(End::Asked) => Ok(()),
            Ok(End::Abrupt) => Err(Failure {
                status: status::NOT_AS_EXPECTED,
                message: "the editor ended the session without `shutdown`".to_owned(),
            }),
            Err(error) => Err(Failure::input(error)),
        }
    }
}
