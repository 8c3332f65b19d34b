//! Programs for the Linux guest that only tests need: an initial RAM disk that is the guest's own, and
//! behind it a second archive, which the kernel unpacks over the first (kernel,
//! `Documentation/driver-api/early-userspace/buffer-format.rst`).

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::{scratch, target};

/// Makes an initial RAM disk with these programs in `/bin`. Returns its path below `target/`, as
/// [`System::initrd`](crate::System) and [`File::linux_with`](crate::File::linux_with) take it.
#[must_use]
pub fn initrd_with(name: &str, programs: &[&Path]) -> String {
    let files: Vec<(String, Vec<u8>)> = programs
        .iter()
        .map(|path| {
            let name = path.file_name().expect("a program has a name").to_string_lossy();
            (format!("bin/{name}"), fs::read(path).expect("the program is built"))
        })
        .collect();
    initrd_and(name, &archive(&files))
}

/// Makes an initial RAM disk that is the guest's own with another archive behind it. Returns its path
/// as [`initrd_with`] does.
#[must_use]
pub fn initrd_and(name: &str, archive: &[u8]) -> String {
    let mut image = fs::read(target("guest/initrd.img")).expect("scripts/guest-image has run");
    image.resize(image.len().next_multiple_of(4), 0);
    image.extend(archive);
    write(&format!("{name}.img"), &image);
    format!("tests/{name}.img")
}

/// Makes an initial RAM disk of only busybox and this script, which is the first process. It
/// finds nothing mounted, and no folder but `/dev` with a console, which every kernel has of itself.
#[must_use]
pub fn initrd_of(name: &str, script: &str) -> PathBuf {
    let script = format!("#!/busybox sh\n{script}\n");
    let busybox = fs::read(target("guest/busybox")).expect("scripts/guest-image has run");
    let files = [("busybox".to_owned(), busybox), ("init".to_owned(), script.into_bytes())];
    write(&format!("{name}.img"), &archive(&files))
}

fn write(file: &str, image: &[u8]) -> PathBuf {
    static WRITTEN: AtomicU32 = AtomicU32::new(0);
    let path = scratch().join(file);
    // A run that packs the file at this moment must see the old or the new one, and two tests may write it at once.
    let new = scratch().join(format!("{file}.new{}", WRITTEN.fetch_add(1, Ordering::Relaxed)));
    fs::write(&new, image).expect("the image can be written");
    fs::rename(&new, &path).expect("the image can be renamed");
    path
}

/// An archive of executable files, by path and contents, in the format `newc`.
#[must_use]
pub fn archive(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    const EXECUTABLE: u32 = 0o100_755;
    let mut archive = Vec::new();
    for (number, (path, contents)) in files.iter().enumerate() {
        entry(&mut archive, number as u32 + 1, path, EXECUTABLE, contents);
    }
    entry(&mut archive, 0, "TRAILER!!!", 0, &[]);
    archive
}

fn entry(archive: &mut Vec<u8>, inode: u32, path: &str, mode: u32, contents: &[u8]) {
    let size = u32::try_from(contents.len()).expect("the format has 32 bits for a length");
    // Inode, mode, owner, group, links, time, size, four device numbers, length of the path with
    // its zero, checksum (which this format does not have).
    let fields = [inode, mode, 0, 0, 1, 0, size, 0, 0, 0, 0, path.len() as u32 + 1, 0];
    archive.extend_from_slice(b"070701");
    for field in fields {
        // Writing to a Vec cannot fail.
        let _ = write!(archive, "{field:08x}");
    }
    archive.extend_from_slice(path.as_bytes());
    archive.push(0);
    archive.resize(archive.len().next_multiple_of(4), 0);
    archive.extend_from_slice(contents);
    archive.resize(archive.len().next_multiple_of(4), 0);
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn an_archive_is_one_that_cpio_reads() {
        let files = [("bin/a".to_owned(), b"abcde".to_vec()), ("b".to_owned(), vec![7; 600])];
        for (path, contents) in &files {
            let mut cpio = Command::new("cpio")
                .args(["--extract", "--to-stdout", "--quiet", path])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            cpio.stdin.take().unwrap().write_all(&archive(&files)).unwrap();
            let output = cpio.wait_with_output().unwrap();
            assert!(output.status.success());
            assert_eq!(&output.stdout, contents);
        }
    }
}
