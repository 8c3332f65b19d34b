//! Names and paths: which strings an image may have.
//!
//! Names are shown on terminals, written into files and typed by operators, so they have only
//! characters that mean nothing elsewhere. As in IEC 61131-3, upper and lower case are the same name.

use core::cmp::Ordering;

use crate::error::{ImageError, Where};
use crate::limit;

/// The strings section, with which references are looked up.
#[derive(Clone, Copy)]
pub(crate) struct Strings<'a>(pub &'a [u8]);

impl<'a> Strings<'a> {
    /// A string that has been checked; empty if it was not.
    pub fn get(self, (offset, length): (u32, u32)) -> &'a str {
        let (from, length) = (offset as usize, length as usize);
        let bytes = self.0.get(from..).and_then(|rest| rest.get(..length)).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }

    fn checked(
        self,
        whence: Where,
        field: &'static str,
        (offset, length): (u32, u32),
        limit: u32,
    ) -> Result<&'a str, ImageError> {
        whence.at_most(field, length.into(), limit.into())?;
        let end = u64::from(offset) + u64::from(length);
        whence.at_most(field, end, self.0.len() as u64)?;
        let text = self.get((offset, length));
        whence.rule(text.len() == length as usize, field, "the text must be UTF-8")?;
        Ok(text)
    }

    /// A name with at least one character.
    pub fn name(self, whence: Where, at: (u32, u32)) -> Result<&'a str, ImageError> {
        let name = self.checked(whence, "name", at, limit::NAME_BYTES)?;
        whence.rule(!name.is_empty(), "name", "the name must not be empty")?;
        whence.rule(name.bytes().all(is_name), "name", RULE)?;
        Ok(name)
    }

    /// A name, or nothing.
    pub fn optional_name(self, whence: Where, at: (u32, u32)) -> Result<(), ImageError> {
        if at == (0, 0) { Ok(()) } else { self.name(whence, at).map(|_| ()) }
    }

    /// A path of a source file, or nothing.
    pub fn path(self, whence: Where, at: (u32, u32)) -> Result<(), ImageError> {
        let path = self.checked(whence, "file", at, limit::PATH_BYTES)?;
        let clean = !path.chars().any(char::is_control);
        whence.rule(clean, "file", "the path must not have control characters")
    }
}

const RULE: &str = "a name has letters, digits and the characters _ . - [ ] , only";

fn is_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"_.-[],".contains(&byte)
}

/// The order of names in tables: byte by byte, with letters as lower case.
pub(crate) fn order(a: &str, b: &str) -> Ordering {
    let a = a.bytes().map(|byte| byte.to_ascii_lowercase());
    a.cmp(b.bytes().map(|byte| byte.to_ascii_lowercase()))
}
