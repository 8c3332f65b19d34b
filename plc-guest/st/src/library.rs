//! The library: what of the standard is written in ST, and the function blocks of the SDK (docs/blocks.md).
//!
//! Its files are a part of the compiler and are checked with every project. A function of the library
//! may have several forms with one name, of which a call takes the one that its arguments fit.

use std::sync::{Arc, Mutex, PoisonError};

use crate::diagnostic::Diagnostics;
use crate::source::Sources;
use crate::syntax::ast::File;
use crate::syntax::parser;

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
        sources.push(name, text);
    }
}

/// The trees of the files that [`add`] has added last, of which the first has the number `own`.
///
/// To parse the library takes three quarters of a check of a small project, and an editor checks its project at each key:
/// the trees are kept until the first has another number.
#[must_use]
pub fn trees(sources: &Sources, own: usize) -> Arc<[File]> {
    static KEPT: Mutex<Option<(usize, Arc<[File]>)>> = Mutex::new(None);
    let kept = || KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((first, trees)) = &*kept()
        && *first == own
    {
        return Arc::clone(trees);
    }
    let mut none = Diagnostics::new();
    let files = sources.iter().skip(own);
    let trees: Arc<[File]> =
        files.map(|(file, _)| parser::parse(file, sources, &mut none)).collect();
    debug_assert!(!none.has_errors(), "the library is good");
    *kept() = Some((own, Arc::clone(&trees)));
    trees
}

#[cfg(test)]
#[path = "library_tests.rs"]
mod tests;
