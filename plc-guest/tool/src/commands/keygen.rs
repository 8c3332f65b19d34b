//! `takt plc keygen`: a pair of Ed25519 keys, as hexadecimal digits in two files.

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use takt_program::signature;

use super::{PRIVATE, PUBLIC, hex};
use crate::{Failure, status};

/// Arguments of `keygen`.
#[derive(clap::Args)]
pub struct Keygen {
    /// NAME.key becomes the private key, NAME.pub the public one.
    name: PathBuf,
}

impl Keygen {
    pub fn run(self) -> Result<(), Failure> {
        let mut private = [0; 32];
        File::open("/dev/urandom").and_then(|mut file| file.read_exact(&mut private)).map_err(
            |error| Failure {
                status: status::HOST_CANNOT,
                message: format!("cannot read /dev/urandom: {error}"),
            },
        )?;
        let public = signature::public(&private);
        let (key, public_key) = (with(&self.name, ".key"), with(&self.name, ".pub"));
        create(&key, &format!("{PRIVATE} {}", hex(&private)), 0o600)?;
        create(&public_key, &format!("{PUBLIC} {}", hex(&public)), 0o644).inspect_err(|_| {
            // Half a pair is of no use, and would be in the way of the next one.
            let _ = fs::remove_file(&key);
        })?;
        println!(
            "private key {}, public key {}: {}",
            key.display(),
            public_key.display(),
            hex(&public)
        );
        Ok(())
    }
}

fn with(name: &Path, end: &str) -> PathBuf {
    let mut name = name.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// A key is never overwritten: what it has signed could not be signed again.
fn create(path: &Path, text: &str, mode: u32) -> Result<(), Failure> {
    let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    let write = |mut file: File| {
        // What is left of a key is none, and would be in the way of the next one.
        writeln!(file, "{text}").inspect_err(|_| drop(fs::remove_file(path)))
    };
    file.and_then(write)
        .map_err(|error| Failure::input(format!("cannot make {}: {error}", path.display())))
}
