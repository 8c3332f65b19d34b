//! Files as the protocol names them: `file:///home/me/tank/main.st`.

use std::fmt::Write;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use lsp_types::Uri;

/// What a client calls a text.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Name {
    /// A file of this machine.
    File(PathBuf),
    /// Something else, such as a text that was never saved.
    Other(String),
}

impl Name {
    /// What an address means. Two addresses of a file with other escapes are one name.
    pub fn new(uri: &Uri) -> Self {
        let text = uri.as_str();
        let path =
            text.strip_prefix("file://").and_then(|rest| rest.find('/').map(|at| &rest[at..]));
        match path.and_then(unescaped) {
            Some(path) => Self::File(normal(&path)),
            None => Self::Other(text.to_owned()),
        }
    }

    /// The address. None if the protocol has no form for it.
    pub fn uri(&self) -> Option<Uri> {
        let text = match self {
            Self::Other(text) => text.clone(),
            Self::File(path) => {
                let mut text = String::from("file://");
                for byte in path.as_os_str().as_bytes() {
                    match byte {
                        b'A'..=b'Z'
                        | b'a'..=b'z'
                        | b'0'..=b'9'
                        | b'/'
                        | b'-'
                        | b'.'
                        | b'_'
                        | b'~' => {
                            text.push(char::from(*byte));
                        }
                        _ => write!(text, "%{byte:02X}").ok()?,
                    }
                }
                text
            }
        };
        Uri::from_str(&text).ok()
    }

    /// As messages show it.
    pub fn shown(&self) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Other(text) => text.clone(),
        }
    }
}

/// A path without `.` and `..`, as far as that needs no look at the disk.
pub fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            std::path::Component::CurDir => {}
            std::path::Component::ParentDir => {
                normal.pop();
            }
            part => normal.push(part),
        }
    }
    normal
}

fn unescaped(text: &str) -> Option<PathBuf> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let digits = [rest.next()?, rest.next()?];
                if !digits.iter().all(u8::is_ascii_hexdigit) {
                    return None;
                }
                u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
            }
            byte => byte,
        });
    }
    // The system's paths have no zero byte.
    (!bytes.contains(&0)).then(|| PathBuf::from(std::ffi::OsString::from_vec(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::new(&Uri::from_str(text).expect("it is an address"))
    }

    #[test]
    fn a_file_is_the_same_however_its_address_is_escaped() {
        let path = Name::File("/home/Jürgen/a b.st".into());
        assert_eq!(name("file:///home/J%C3%BCrgen/a%20b.st"), path);
        assert_eq!(name("file:///home/x/../J%c3%bcrgen/%61%20b.st"), path);
        let uri = path.uri().expect("it has an address");
        assert_eq!(uri.as_str(), "file:///home/J%C3%BCrgen/a%20b.st");
        assert_eq!(Name::new(&uri), path);
    }

    #[test]
    fn other_addresses_stay_as_they_are() {
        for text in [
            "untitled:Untitled-1",
            "file:///a%",
            "file:///a%zz",
            "file:///a%+f",
            "file:///a%00b",
            "file:x",
        ] {
            if let Ok(uri) = Uri::from_str(text) {
                assert_eq!(Name::new(&uri), Name::Other(text.to_owned()));
            }
        }
    }
}
