//! The standard library: the functions and function blocks of the standard that are written in ST.
//!
//! Its files are a part of the compiler and are checked with every project. A function of the library
//! may have several forms with one name, of which a call takes the one that its arguments fit.

use crate::source::Sources;

/// The files, by the names that messages show.
const FILES: &[(&str, &str)] = &[];

/// Adds all files of the library.
pub fn add(sources: &mut Sources) {
    for (name, text) in FILES {
        let added = sources.add(name, text.as_bytes());
        debug_assert!(added.is_ok(), "{name} is a source");
    }
}
