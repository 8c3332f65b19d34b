//! `takt plc sign`: puts a signature into an image.

use std::path::PathBuf;

use takt_program::signature;

use super::{PRIVATE, hex, key, read, write};
use crate::Failure;

/// Arguments of `sign`.
#[derive(clap::Args)]
pub struct Sign {
    /// The image. It is replaced by the signed one.
    image: PathBuf,
    /// The private key (NAME.key of `takt plc keygen`).
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
}

impl Sign {
    pub fn run(self) -> Result<(), Failure> {
        let key = key(&self.key, PRIVATE)?;
        let mut bytes = read(&self.image)?;
        signature::sign(&mut bytes, &key)
            .map_err(|error| Failure::input(format!("{}: {error}", self.image.display())))?;
        write(&self.image, &bytes)?;
        println!("{}: signed by {}", self.image.display(), hex(&signature::public(&key)));
        Ok(())
    }
}
