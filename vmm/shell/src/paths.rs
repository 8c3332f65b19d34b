//! Paths on both sides, as scp tells them apart: what is before the first colon is the guest's name, unless there is a
//! slash before it.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;

use takt_plan::PartitionFile;

use crate::ShellError;
use crate::choose;
use crate::ssh::Guest;

/// Where a path leads.
#[derive(Debug, PartialEq, Eq)]
pub enum Place {
    /// To a file of this machine.
    Here(OsString),
    /// To a file of the guest.
    There(OsString),
}

/// The guest that is meant by the paths, and each of them.
///
/// # Errors
/// Unless exactly one guest is meant.
pub fn read(file: &PartitionFile, words: &[OsString]) -> Result<(Guest, Vec<Place>), ShellError> {
    let all = choose::reachable(file);
    let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
    let (name, places) = tell_apart(&names, words)?;
    Ok((choose::guest(file, Some(name))?, places))
}

fn tell_apart<'a>(
    names: &[&'a str],
    words: &[OsString],
) -> Result<(&'a str, Vec<Place>), ShellError> {
    let mut guest: Option<&'a str> = None;
    let mut places = Vec::with_capacity(words.len());
    for word in words {
        let Some((name, path)) = split(word) else {
            places.push(Place::Here(word.clone()));
            continue;
        };
        let Some(name) = names.iter().copied().find(|other| *other == name) else {
            let (path, name) = (word.display().to_string(), name.display().to_string());
            return Err(ShellError::NoSuchGuest { path, name });
        };
        match guest.replace(name) {
            Some(other) if other != name => {
                return Err(ShellError::TwoGuests(other.to_owned(), name.to_owned()));
            }
            _ => places.push(Place::There(path.to_owned())),
        }
    }
    let example = || names.first().map_or("linux", |name| *name).to_owned();
    guest.map(|guest| (guest, places)).ok_or_else(|| ShellError::NoGuestPath { example: example() })
}

/// What is before and behind the colon of a path in a guest.
fn split(word: &OsStr) -> Option<(&OsStr, &OsStr)> {
    let bytes = word.as_bytes();
    let colon = bytes.iter().position(|byte| matches!(byte, b':' | b'/'))?;
    let (name, path) = bytes.split_at_checked(colon)?;
    let path = path.strip_prefix(b":").filter(|_| !name.is_empty())?;
    Some((OsStr::from_bytes(name), OsStr::from_bytes(path)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 2] = ["hmi", "data"];

    fn told(words: &[&str]) -> Result<(&'static str, Vec<Place>), ShellError> {
        let words: Vec<OsString> = words.iter().map(OsString::from).collect();
        tell_apart(&NAMES, &words)
    }

    #[test]
    fn a_colon_before_any_slash_leads_into_a_guest() {
        let (name, places) = told(&["a", "./b:c", "/d:e", ":f", "data:g:h", "data:"]).unwrap();
        assert_eq!(name, "data");
        let here = |path: &str| Place::Here(path.into());
        let there = |path: &str| Place::There(path.into());
        let rest = [here("a"), here("./b:c"), here("/d:e"), here(":f"), there("g:h"), there("")];
        assert_eq!(places, rest);
    }

    #[test]
    fn what_is_no_guest_is_not_left_to_scp() {
        for word in ["plc:/a", "root@hmi:/a", "[hmi]:/a", "scp://hmi/a", "HMI:a"] {
            let error = told(&["hmi:/b", word]).unwrap_err();
            assert!(matches!(error, ShellError::NoSuchGuest { .. }), "{word}: {error}");
        }
    }

    #[test]
    fn one_guest_is_meant() {
        assert!(matches!(told(&["hmi:/a", "data:/a"]), Err(ShellError::TwoGuests(..))));
        let error = told(&["a", "b"]).unwrap_err();
        assert!(error.to_string().contains("hmi:/tmp"), "{error}");
    }
}
