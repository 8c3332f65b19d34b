//! What a hostile text can do to the parser. What it accepts and refuses is in `tests/cases`.

use super::*;
use crate::source::Sources;

/// How many errors there are.
fn errors(text: &str) -> usize {
    let mut sources = Sources::new();
    let file = sources.add("a.st", text.as_bytes()).expect("it is text");
    let mut diagnostics = Diagnostics::new();
    let _ = parse(file, &sources, &mut diagnostics);
    diagnostics.iter().filter(|one| one.is_error()).count()
}

#[test]
fn what_is_too_deep_is_one_error() {
    let deep = |open: &str, inner: &str, close: &str| {
        let count = 100_000;
        let text = open.repeat(count) + inner + &close.repeat(count);
        errors(&format!("PROGRAM p\n{text};\nEND_PROGRAM"))
    };
    for (open, inner, close) in [
        ("x := (", "1", ")"),
        ("IF a THEN ", "b := 1;", " END_IF;"),
        ("CASE a OF 1: ", "b := 1;", " END_CASE;"),
        ("a[", "1", "]"),
        ("f(", "1", ")"),
        ("NOT ", "x", ""),
        ("REPEAT ", "", " UNTIL a END_REPEAT;"),
    ] {
        assert_eq!(deep(open, inner, close), 1, "{open}");
    }
    let types = format!("TYPE t : {} INT; END_TYPE", "ARRAY[0..1] OF ".repeat(100_000));
    assert_eq!(errors(&types), 1);
    let initial = format!("VAR_GLOBAL a : T := {}; END_VAR", "[".repeat(100_000));
    assert_eq!(errors(&initial), 1);
}

#[test]
fn a_keyword_in_place_of_a_types_name_ends() {
    for keyword in ["END_TYPE", "PROGRAM", "IF"] {
        assert_ne!(errors(&format!("TYPE {keyword} : INT; END_TYPE")), 0, "{keyword}");
    }
}

#[test]
fn a_chain_without_end_is_an_error_and_no_exhausted_stack() {
    for link in [" + 1", ".x", "^", "[1]", "(1)", " ** 2", " AND b"] {
        let text = format!("PROGRAM p\nx := a{};\nEND_PROGRAM", link.repeat(100_000));
        assert_eq!(errors(&text), 1, "{link}");
    }
}

#[test]
fn arguments_count_like_the_operators_that_they_become() {
    let call = |first: &str, count: usize| format!("ADD({first}{})", ", 1".repeat(count - 1));
    let told = |call: &str| errors(&format!("PROGRAM p\nx := {call};\nEND_PROGRAM"));
    assert_eq!(told(&call("1", 200)), 0);
    assert_eq!(told(&call("1", 1000)), 1);
    assert_eq!(told(&call(&call("1", 120), 120)), 0);
    assert_eq!(told(&call(&call("1", 200), 200)), 1);
}

#[test]
fn a_text_of_errors_only_is_read_to_its_end() {
    for piece in ["(* ", "IF ", "; ", "VAR ", "END_IF ", "{", "'", ":= ", "CASE ", "x : ", "\u{1}"]
    {
        let text = format!("PROGRAM p\n{}", piece.repeat(50_000));
        assert!(errors(&text) <= crate::limits::ERRORS_PER_FILE + 1, "{piece}");
    }
}
