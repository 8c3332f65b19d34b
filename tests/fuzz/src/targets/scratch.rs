//! Files for subjects that read files: in memory, and gone with the process.

use std::fs;
use std::path::PathBuf;
use std::thread_local;

use tempfile::TempDir;

thread_local! {
    static FOLDER: TempDir = TempDir::new_in("/dev/shm").expect("a folder in /dev/shm");
}

/// A file with this content. There is one of each name at a time in each thread.
pub fn file(name: &str, content: &[u8]) -> PathBuf {
    let path = FOLDER.with(|folder| folder.path().join(name));
    fs::write(&path, content).expect("space in /dev/shm");
    path
}
