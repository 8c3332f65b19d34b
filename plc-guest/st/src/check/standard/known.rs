//! The names that mean something without a declaration, for editors.

use super::{channel, conversion, table};
use crate::check::{names, test};
use crate::hir::Elementary;

/// The names of the elementary types, and of the strings.
pub fn types() -> impl Iterator<Item = &'static str> {
    Elementary::ALL.into_iter().map(Elementary::name).chain(["STRING", "WSTRING"])
}

/// Whether this key is the name of an elementary type or of a string.
#[must_use]
pub fn is_type(key: &str) -> bool {
    names::elementary(key).is_some() || matches!(key, "STRING" | "WSTRING")
}

/// The functions that the compiler makes itself, except for conversions: name, and how it is called.
pub fn functions() -> impl Iterator<Item = (&'static str, String)> {
    let own = |name: &'static str, form: &str| (name, form.to_owned());
    let table = table::FUNCTIONS.iter().filter(|function| !function.name.starts_with("TAKT_"));
    table.map(|function| (function.name, function.form())).chain([
        own("REF", "REF(variable)"),
        own("LOWER_BOUND", "LOWER_BOUND(ARR, DIM)"),
        own("UPPER_BOUND", "UPPER_BOUND(ARR, DIM)"),
        own(channel::FORMS[0].0, channel::FORMS[0].1),
        own(channel::FORMS[1].0, channel::FORMS[1].1),
    ])
}

/// The functions that only a test can call.
pub fn test_functions() -> impl Iterator<Item = &'static str> {
    test::names()
}

/// How the function of this key, or the conversion, is called, if the compiler makes it itself.
#[must_use]
pub fn function(key: &str) -> Option<String> {
    let known = functions().find(|(name, _)| *name == key).map(|(_, form)| form);
    let hidden = || table::function(key).map(|function| function.form());
    let of_tests = || test::form(key).map(|form| form.replace('`', ""));
    known.or_else(hidden).or_else(of_tests).or_else(|| {
        let known = conversion::parse(key).is_some() || conversion::binary_coded(key).is_some();
        known.then(|| format!("{key}(IN)"))
    })
}
