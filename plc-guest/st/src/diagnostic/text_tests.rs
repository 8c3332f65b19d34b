//! How a message shows the place in its source.

use super::*;
use crate::diagnostic::Code;
use crate::source::Sources;

fn span(sources: &Sources, text: &str) -> Span {
    let (file, source) = sources.iter().next().expect("there is a file");
    let start = source.text().find(text).expect("the text is there") as u32;
    Span { file, start, end: start + text.len() as u32 }
}

#[test]
fn the_marks_stand_below_the_place() {
    let mut sources = Sources::new();
    sources.add("a.st", "x := 1;\n\tÄ := levl;\n".as_bytes()).expect("it is text");
    let one = Diagnostic::new(Code::UnknownName, span(&sources, "levl"), "there is no `levl`")
        .allowed("a variable")
        .hint("did you mean `level`?")
        .related(span(&sources, "x"), "here");
    assert_eq!(
        to_string(&sources, &one),
        "error[unknown-name]: a.st:2:7: there is no `levl`\n \
         2 |  Ä := levl;\n   \
         |       ^^^^\n  \
         allowed: a variable\n  hint: did you mean `level`?\n  a.st:1:1: here\n"
    );
}

#[test]
fn of_a_line_of_megabytes_only_what_is_around_the_place_is_shown() {
    let mut sources = Sources::new();
    let text = format!("{}Z{}", "x".repeat(3_000_000), "y".repeat(3_000_000));
    sources.add("a.st", text.as_bytes()).expect("it is text");
    let shown = to_string(&sources, &Diagnostic::new(Code::Syntax, span(&sources, "Z"), "no"));
    let lines: Vec<&str> = shown.lines().collect();
    assert!(lines[1].len() < 140, "{}", lines[1]);
    assert_eq!(lines[1].find('Z'), lines[2].find('^'));
}

#[test]
fn a_place_of_several_lines_is_marked_to_the_end_of_its_first() {
    let mut sources = Sources::new();
    sources.add("a.st", b"ab (* c\nd *)").expect("it is text");
    let one = Diagnostic::new(Code::Unterminated, span(&sources, "(* c\nd *)"), "no");
    assert!(to_string(&sources, &one).contains("|    ^^^^\n"));
}
