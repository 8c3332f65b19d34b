//! `takt plc sign`: puts a signature into an image.

use std::path::PathBuf;

use takt_program::signature;

use super::{from_hex, hex, read, write};
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
        let text = String::from_utf8(read(&self.key)?).unwrap_or_default();
        let wrong = || format!("{} has no private key: 64 hexadecimal digits", self.key.display());
        let key = from_hex(&text).ok_or_else(|| Failure::input(wrong()))?;
        let mut bytes = read(&self.image)?;
        signature::sign(&mut bytes, &key)
            .map_err(|error| Failure::input(format!("{}: {error}", self.image.display())))?;
        write(&self.image, &bytes)?;
        println!("{}: signed by {}", self.image.display(), hex(&signature::public(&key)));
        Ok(())
    }
}
