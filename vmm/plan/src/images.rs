//! The files that a partition is started from.
//!
//! A path is relative to the folder of the partition file, never to the place where somebody
//! happened to start Takt: the same file then means the same images on the desk, as a service and
//! in the appliance. `..` is taken off the path as text, so that the path which is checked, the
//! one that `takt check --needs` prints and the one that is opened later are one and the same
//! string, without links followed in between.

use std::fs::{self, File};
use std::io;
use std::path::{Component, Path, PathBuf};

use thiserror::Error;
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};

/// Longest path that Linux takes, with its final NUL (`PATH_MAX` in `uapi/linux/limits.h`).
const PATH_MAX: usize = 4096;
/// Longest path of a socket in bytes: `sun_path` of unix(7), less its NUL.
pub const SOCKET_PATH_MAX: usize = 107;
/// Where the guest images of the examples are built.
const GUEST_IMAGES: &str = "target/guest";

/// An image and the place in the file that asks for it.
#[derive(Debug)]
pub struct Image {
    pub span: Span,
    pub path: PathBuf,
}

/// Why a file cannot be read. Also used for the partition file itself.
#[derive(Debug, Error)]
pub enum Unreadable {
    /// The kernel's own words, such as "No such file or directory".
    #[error("{0}")]
    Io(#[from] io::Error),
    /// A folder, a device, a pipe.
    #[error("it is not a regular file")]
    NotAFile,
}

/// Opens a regular file for reading. What it is comes before the opening: opening a pipe would
/// wait for ever.
pub fn open(path: &Path) -> Result<File, Unreadable> {
    if !fs::metadata(path)?.is_file() {
        return Err(Unreadable::NotAFile);
    }
    Ok(File::open(path)?)
}

/// The absolute path that a path of the file stands for.
pub fn resolve(folder: &Path, path: &Spanned<String>) -> Result<Image, Diagnostic> {
    let text = path.get_ref();
    if text.is_empty() || text.len() >= PATH_MAX || text.contains(char::is_control) {
        let found = format!("the path {} cannot be that of a file", quote(text));
        let allowed = "1 to 4095 bytes, without control characters";
        return Err(Diagnostic::new(path.span(), found, allowed));
    }
    Ok(Image { span: path.span(), path: without_dots(&folder.join(text)) })
}

/// The absolute path that the path of a socket stands for.
pub fn resolve_socket(folder: &Path, path: &Spanned<String>) -> Result<PathBuf, Diagnostic> {
    let found = match resolve(folder, path) {
        Ok(image) if image.path.as_os_str().len() <= SOCKET_PATH_MAX => return Ok(image.path),
        Ok(_) => "is too long for a socket",
        Err(_) => "cannot be that of a socket",
    };
    let found = format!("the path {} {found}", quote(path.get_ref()));
    let allowed = format!(
        "1 to {SOCKET_PATH_MAX} bytes together with the folder's path, without control characters"
    );
    Err(Diagnostic::new(path.span(), found, allowed))
}

fn without_dots(path: &Path) -> PathBuf {
    let mut clean = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            // At the root there is nothing to take off, as in the kernel's own walk.
            Component::ParentDir => {
                clean.pop();
            }
            other => clean.push(other),
        }
    }
    clean
}

/// Points at an image that cannot be read.
pub fn check(image: &Image) -> Result<(), Diagnostic> {
    open(&image.path).map(|_| ()).map_err(|error| unreadable(image, &error))
}

/// Says that an image cannot be read, and what would make it readable.
pub fn unreadable(image: &Image, error: &Unreadable) -> Diagnostic {
    let found = format!("{} cannot be read: {error}", image.path.display());
    let built = image.path.to_str().is_some_and(|p| p.contains(&format!("/{GUEST_IMAGES}/")));
    let allowed = if built {
        "a regular file; scripts/guest-image makes those in target/guest"
    } else {
        "a regular file, by a path relative to the folder of the partition file"
    };
    Diagnostic::new(image.span.clone(), found, allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_starts_at_the_folder_of_the_file_and_loses_its_dots() {
        let at = |path: &str| without_dots(&Path::new("/a/configs").join(path));
        assert_eq!(at("../target/x"), Path::new("/a/target/x"));
        assert_eq!(at("./x/./y"), Path::new("/a/configs/x/y"));
        assert_eq!(at("../../../../x"), Path::new("/x"));
        assert_eq!(at("/boot/x"), Path::new("/boot/x"));
    }

    #[test]
    fn a_socket_has_a_short_path_from_the_root() {
        let at = |path: &str| {
            let path = Spanned::new(0..path.len(), path.to_owned());
            resolve_socket(Path::new("/plant"), &path).ok()
        };
        assert_eq!(at("../run/takt.sock").unwrap(), Path::new("/run/takt.sock"));
        let longest = "x".repeat(SOCKET_PATH_MAX - "/plant/".len());
        assert!(at(&longest).is_some());
        assert!(at(&(longest + "x")).is_none());
        assert!(at("").is_none());
    }

    #[test]
    fn a_folder_or_a_device_is_no_image() {
        assert!(matches!(open(Path::new("/")), Err(Unreadable::NotAFile)));
        assert!(matches!(open(Path::new("/dev/null")), Err(Unreadable::NotAFile)));
        assert!(matches!(open(Path::new("/no/such/file")), Err(Unreadable::Io(_))));
    }
}
