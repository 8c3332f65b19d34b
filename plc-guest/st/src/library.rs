//! The library: what of the standard is written in ST, and the function blocks of the SDK (docs/blocks.md).
//!
//! Its files are a part of the compiler and are checked with every project. A function of the library
//! may have several forms with one name, of which a call takes the one that its arguments fit.

use crate::source::Sources;

macro_rules! file {
    ($name:literal) => {
        (concat!("library/", $name, ".st"), include_str!(concat!("../library/", $name, ".st")))
    };
}

/// The files, by the names that messages show.
const FILES: &[(&str, &str)] = &[
    file!("standard/bistable"),
    file!("standard/edge"),
    file!("standard/counter"),
    file!("standard/timer"),
    file!("standard/text"),
    file!("standard/number"),
    file!("standard/calendar"),
    file!("standard/time_text"),
    file!("standard/character"),
    file!("standard/encoding"),
    file!("blocks/clock"),
    file!("blocks/control"),
    file!("blocks/alarm"),
    file!("blocks/filter"),
    file!("blocks/fft"),
];

/// Adds all files of the library.
pub fn add(sources: &mut Sources) {
    for (name, text) in FILES {
        let added = sources.add(name, text.as_bytes());
        debug_assert!(added.is_ok(), "{name} is a source");
    }
}

#[cfg(test)]
#[path = "library_tests.rs"]
mod tests;
