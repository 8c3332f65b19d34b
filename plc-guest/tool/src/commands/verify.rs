//! `takt plc verify`: is an image whole, and signed by whom it should be?

use std::path::PathBuf;

use super::{PUBLIC, hex, image, key, read};
use crate::{Failure, status};

/// Arguments of `verify`.
#[derive(clap::Args)]
pub struct Verify {
    /// The image.
    image: PathBuf,
    /// A public key (a file of `takt plc keygen`): the image must be signed by one of those given.
    #[arg(long = "key", value_name = "FILE")]
    keys: Vec<PathBuf>,
}

impl Verify {
    pub fn run(self) -> Result<(), Failure> {
        let bytes = read(&self.image)?;
        let image = image(&self.image, &bytes)?;
        let path = self.image.display();
        let mut accepted = Vec::new();
        for file in &self.keys {
            accepted.push(key(file, PUBLIC)?);
        }
        let not_signed = |message| Failure { status: status::NOT_AS_EXPECTED, message };
        match image.key() {
            Some(key) if accepted.is_empty() || accepted.contains(&key) => {
                println!("{path}: whole, signed by {}", hex(&key));
            }
            Some(key) => {
                let key = hex(&key);
                return Err(not_signed(format!(
                    "{path} is signed by {key}, which is none of the keys"
                )));
            }
            None if accepted.is_empty() => println!("{path}: whole, not signed"),
            None => return Err(not_signed(format!("{path} is not signed"))),
        }
        Ok(())
    }
}
