//! A source for the Structured Text compiler.

use takt_st::diagnostic::{json, text};
use takt_st::project;
use takt_st::source::Sources;

/// Checks the source with the library, and shows every message in both forms.
///
/// # Panics
/// If a source without an error makes no program or one with an error makes one, or a message says nothing or is
/// of no place.
pub fn run(data: &[u8]) {
    let mut sources = Sources::new();
    if sources.add("main.st", data).is_err() {
        return;
    }
    let Ok(checked) = project::check("fuzz", &mut sources) else { return };
    let errors = checked.diagnostics.iter().filter(|one| one.is_error()).count();
    assert_eq!(checked.program.is_some(), errors == 0);
    for one in &checked.diagnostics {
        assert!(!one.found.is_empty());
        assert!(one.span.start <= one.span.end);
        assert!(one.span.end as usize <= sources.get(one.span.file).text().len());
        assert!(!text::to_string(&sources, one).is_empty());
        assert!(!json::to_string(&sources, one).is_empty());
    }
}
