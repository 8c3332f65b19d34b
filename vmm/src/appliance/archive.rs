//! The results as one cpio archive: a format that every system can unpack, and that needs nothing
//! to be known before it is written.

use std::fs;
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use super::Error;

/// Writes the files of `folder`, then `status`, as a cpio archive of the `newc` format.
///
/// The folder is flat by contract; whatever is not a plain file is left out.
pub(super) fn write(out: &mut impl Write, folder: &Path, status: u8) -> Result<(), Error> {
    let unreadable = |path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::Read { path, source }
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable(folder))? {
        let path = entry.map_err(unreadable(folder))?.path();
        if path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    for path in &files {
        let data = fs::read(path).map_err(unreadable(path))?;
        let name = path.file_name().unwrap_or_default();
        write_entry(out, name.as_bytes(), 0o100644, &data)?;
    }
    write_entry(out, b"status", 0o100644, format!("{status}\n").as_bytes())?;
    write_entry(out, b"TRAILER!!!", 0, &[])?;
    Ok(out.flush()?)
}

/// Writes one member: a header of hexadecimal fields, the name and the data, the last two filled
/// up to a multiple of four bytes (Linux Documentation/driver-api/early-userspace, buffer-format).
fn write_entry(out: &mut impl Write, name: &[u8], mode: u32, data: &[u8]) -> Result<(), Error> {
    const HEADER_BYTES: usize = 110;
    const ZEROS: [u8; 3] = [0; 3];
    let padding = |length: usize| &ZEROS[..length.wrapping_neg() % 4];

    let size = u32::try_from(data.len()).map_err(|_| {
        let name = std::ffi::OsStr::from_bytes(name);
        Error::TooLong(name.into())
    })?;
    let name_size = name.len() + 1;
    let (links, zero) = (1, 0);
    write!(
        out,
        "070701{zero:08x}{mode:08x}{zero:08x}{zero:08x}{links:08x}{zero:08x}{size:08x}\
         {zero:08x}{zero:08x}{zero:08x}{zero:08x}{name_size:08x}{zero:08x}"
    )?;
    out.write_all(name)?;
    out.write_all(&[0])?;
    out.write_all(padding(HEADER_BYTES + name_size))?;
    out.write_all(data)?;
    out.write_all(padding(data.len()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    /// Reads the members back: (name, mode, data).
    fn members(mut archive: &[u8]) -> Vec<(String, u32, Vec<u8>)> {
        let mut found = Vec::new();
        while !archive.is_empty() {
            assert_eq!(&archive[..6], b"070701");
            let field = |index: usize| {
                let text = &archive[6 + 8 * index..][..8];
                usize::from_str_radix(std::str::from_utf8(text).unwrap(), 16).unwrap()
            };
            let (mode, size, name_size) = (field(1), field(6), field(11));
            let name_end = 110 + name_size;
            let data_start = name_end.next_multiple_of(4);
            let data_end = data_start + size;
            assert_eq!(archive[name_end - 1], 0);
            let name = String::from_utf8(archive[110..name_end - 1].to_vec()).unwrap();
            let data = archive[data_start..data_end].to_vec();
            found.push((name, mode as u32, data));
            archive = &archive[data_end.next_multiple_of(4)..];
        }
        found
    }

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn archive_holds_the_files_in_order_and_ends_with_the_status() {
        let folder = scratch("archive");
        fs::write(folder.join("report.json"), b"{}\n").unwrap();
        fs::write(folder.join("empty"), b"").unwrap();
        fs::create_dir_all(folder.join("no-file")).unwrap();
        let mut archive = Vec::new();
        write(&mut archive, &folder, 42).unwrap();
        fs::remove_dir_all(&folder).unwrap();
        let file = 0o100644;
        assert_eq!(
            members(&archive),
            [
                ("empty".into(), file, vec![]),
                ("report.json".into(), file, b"{}\n".to_vec()),
                ("status".into(), file, b"42\n".to_vec()),
                ("TRAILER!!!".into(), 0, vec![]),
            ]
        );
    }

    #[test]
    fn names_and_data_of_any_length_stay_aligned() {
        for name_length in 1..9 {
            for length in 0..9 {
                let (name, data) = (vec![b'n'; name_length], vec![0xd; length]);
                let mut archive = Vec::new();
                write_entry(&mut archive, &name, 0o100600, &data).unwrap();
                assert_eq!(archive.len() % 4, 0);
                let name = String::from_utf8(name).unwrap();
                assert_eq!(members(&archive), [(name, 0o100600, data)]);
            }
        }
    }

    #[test]
    fn missing_folder_is_named() {
        let error = write(&mut Vec::new(), Path::new("/no/such/folder"), 0).unwrap_err();
        assert!(error.to_string().contains("/no/such/folder"), "{error}");
    }
}
