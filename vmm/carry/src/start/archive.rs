//! Unpacks a cpio archive of the form `newc`, as the kernel unpacks its initial RAM disk.

use std::fs::{self, File, Permissions};
use std::io::{self, Read};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Component, Path, PathBuf};

use cpio::newc;
use thiserror::Error;

/// What is in an entry's mode (inode(7)).
const TYPE: u32 = 0o170_000;
const FOLDER: u32 = 0o040_000;
const FILE: u32 = 0o100_000;
const LINK: u32 = 0o120_000;
const PERMISSIONS: u32 = 0o7777;

/// Why an archive is not unpacked. What came before in it has been.
#[derive(Debug, Error)]
pub enum UnpackError {
    #[error("the archive breaks off or is none: {0}")]
    Archive(io::Error),
    #[error("{name}: neither a folder, a file of its own, nor a symbolic link (mode {mode:o})")]
    Kind { name: String, mode: u32 },
    #[error("{0}: leads out of the folder")]
    Outside(String),
    #[error("cannot make {}: {source}", path.display())]
    Make { path: PathBuf, source: io::Error },
}

/// Unpacks an archive into a folder, over what is there.
///
/// # Errors
/// See [`UnpackError`].
pub fn unpack(mut archive: impl Read, folder: &Path) -> Result<(), UnpackError> {
    loop {
        let mut reader = newc::Reader::new(archive).map_err(UnpackError::Archive)?;
        if reader.entry().is_trailer() {
            return Ok(());
        }
        let path = folder.join(inside(reader.entry().name())?);
        make(&mut reader, &path)?;
        archive = reader.finish().map_err(UnpackError::Archive)?;
    }
}

fn make(reader: &mut newc::Reader<impl Read>, path: &Path) -> Result<(), UnpackError> {
    let failed = |source| UnpackError::Make { path: path.to_owned(), source };
    let mode = reader.entry().mode();
    match mode & TYPE {
        FOLDER => match fs::create_dir(path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Ok(()),
            made => made.map_err(failed)?,
        },
        // Of a file with several names only one has the contents.
        FILE if reader.entry().nlink() <= 1 => {
            let mut file = File::create(path).map_err(failed)?;
            io::copy(reader, &mut file).map_err(failed)?;
        }
        LINK => {
            let mut target = String::new();
            reader.read_to_string(&mut target).map_err(failed)?;
            return symlink(target, path).map_err(failed);
        }
        _ => return Err(UnpackError::Kind { name: reader.entry().name().to_owned(), mode }),
    }
    fs::set_permissions(path, Permissions::from_mode(mode & PERMISSIONS)).map_err(failed)
}

/// The path, if it stays inside of a folder.
fn inside(name: &str) -> Result<&Path, UnpackError> {
    let path = Path::new(name);
    let stays = |part| matches!(part, Component::Normal(_) | Component::CurDir);
    if path.components().all(stays) { Ok(path) } else { Err(UnpackError::Outside(name.to_owned())) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use vmm_sys_util::tempdir::TempDir;

    fn entry(archive: Vec<u8>, name: &str, mode: u32, data: &[u8]) -> Vec<u8> {
        let builder = newc::Builder::new(name).mode(mode).nlink(1);
        let mut writer = builder.write(archive, data.len() as u32);
        writer.write_all(data).unwrap();
        writer.finish().unwrap()
    }

    fn unpacked(archive: &[u8]) -> (TempDir, Result<(), UnpackError>) {
        let folder = TempDir::new().unwrap();
        let result = unpack(archive, folder.as_path());
        (folder, result)
    }

    #[test]
    fn folders_files_and_links_come_out_as_they_went_in_over_what_is_there() {
        let mut archive = entry(Vec::new(), "bin", FOLDER | 0o755, b"");
        archive = entry(archive, "bin/tool", FILE | 0o644, b"another, and longer");
        archive = entry(archive, "bin", FOLDER | 0o755, b"");
        archive = entry(archive, "bin/tool", FILE | 0o750, b"a tool");
        archive = entry(archive, "bin/link", LINK | 0o777, b"tool");
        archive = newc::trailer(archive).unwrap();
        // What lies behind is not the archive's.
        archive.resize(archive.len() + 4096, 0);
        let (folder, result) = unpacked(&archive);
        result.unwrap();
        let link = folder.as_path().join("bin/link");
        assert_eq!(fs::read(&link).unwrap(), b"a tool");
        assert_eq!(fs::metadata(link).unwrap().permissions().mode() & PERMISSIONS, 0o750);
    }

    #[test]
    fn what_is_no_archive_breaks_off_or_leads_elsewhere_is_refused() {
        let whole = entry(Vec::new(), "file", FILE | 0o644, &[7; 100]);
        for archive in [&[][..], &[0; 200], &whole, &whole[..whole.len() - 50], &whole[..60]] {
            assert!(matches!(
                unpacked(archive).1,
                Err(UnpackError::Archive(_) | UnpackError::Make { .. })
            ));
        }
        for name in ["/no-such-folder/file", "../file", "a/../../b"] {
            let archive = entry(Vec::new(), name, FILE | 0o644, b"");
            assert!(matches!(unpacked(&archive).1, Err(UnpackError::Outside(_))), "{name}");
        }
        let pipe = entry(Vec::new(), "pipe", 0o010_644, b"");
        assert!(matches!(unpacked(&pipe).1, Err(UnpackError::Kind { .. })));
    }
}
