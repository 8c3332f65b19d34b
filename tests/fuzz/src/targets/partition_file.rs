//! The partition file. It is the administrator's, but a mistake in it must be told, with its place,
//! and never be a panic.

use takt_plan::{self as config, check};

use super::scratch;

/// Reads the file, and draws it if it is good.
///
/// # Panics
/// If a defect is told without a place, or the picture of a good file is empty.
pub fn run(data: &[u8]) {
    let path = scratch::file("partition.toml", data);
    match config::load(&path, Some(4)) {
        Ok(file) => {
            assert!(!check::report(&file).is_empty());
            assert!(!check::needs(&file).is_empty());
        }
        Err(error) => assert!(error.to_string().contains("partition.toml"), "{error}"),
    }
}
