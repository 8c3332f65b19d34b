//! The subcommands, one file each.

pub mod build;
pub mod check;
pub mod diff;
pub mod fmt;
pub mod import;
mod inputs;
pub mod inspect;
pub mod keep;
pub mod keygen;
pub mod live;
pub mod lsp;
pub mod new;
mod next_start;
mod output;
pub mod record;
pub mod shadow;
pub mod sign;
mod structured_text;
pub mod test;
pub mod verify;
pub mod versions;
mod worst;

use std::path::Path;

use takt_program::Image;

use crate::Failure;
use output::write;

/// The bytes of a file.
fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(path)
        .map_err(|error| Failure::input(format!("cannot read {}: {error}", path.display())))
}

/// Refuses to write a file over one that is read: a slip of the pen would cost its author the source.
fn spare<'p>(output: &Path, inputs: impl IntoIterator<Item = &'p Path>) -> Result<(), Failure> {
    let Ok(there) = output.canonicalize() else { return Ok(()) };
    match inputs.into_iter().find(|input| input.canonicalize().is_ok_and(|input| input == there)) {
        Some(input) => Err(Failure::input(format!(
            "{} would be overwritten; give another name for the output",
            input.display()
        ))),
        None => Ok(()),
    }
}

/// The image in these bytes, checked.
fn image<'a>(path: &Path, bytes: &'a [u8]) -> Result<Image<'a>, Failure> {
    Image::verify(bytes).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What stands in front of the digits of a key in its file.
const PRIVATE: &str = "takt private key";
const PUBLIC: &str = "takt public key";

/// The key in a file of this kind. The public key and the private one have as many digits, and only one of them may be shown to others.
fn key(path: &Path, kind: &str) -> Result<[u8; 32], Failure> {
    let text = String::from_utf8(read(path)?).unwrap_or_default();
    let digits = text.trim().strip_prefix(kind).map(str::trim_start);
    digits.and_then(from_hex).ok_or_else(|| {
        let found = [PRIVATE, PUBLIC].into_iter().find(|other| text.trim().starts_with(other));
        let found = found.map_or_else(String::new, |other| format!("found a {other}; "));
        Failure::input(format!(
            "{}: {found}allowed: a file with `{kind}` and 64 hexadecimal digits, as `takt plc keygen` makes it",
            path.display()
        ))
    })
}

/// 32 bytes from hexadecimal digits.
fn from_hex(text: &str) -> Option<[u8; 32]> {
    let text = text.trim();
    // `from_str_radix` alone would take a sign for a digit.
    if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; 32];
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}
