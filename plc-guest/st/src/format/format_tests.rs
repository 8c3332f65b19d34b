//! Small rules, each shown by a line. Whole files are in `tests/format`.

use super::*;

fn formatted(text: &str) -> Result<String, FormatError> {
    let mut sources = Sources::new();
    let file = sources.add("a.st", text.as_bytes()).expect("it is text");
    format(&sources, file)
}

/// The lines of a program's body, without their indentation.
fn body(text: &str) -> String {
    let text = formatted(&format!("PROGRAM p\n{text}\nEND_PROGRAM")).expect("it parses");
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines[1..lines.len() - 1].join("\n")
}

#[test]
fn operators_stand_between_blanks_and_signs_at_their_numbers() {
    for (found, expected) in [
        ("a:=-b--c*(-1)**2;", "a := -b - -c * (-1) ** 2;"),
        ("a:=AND(b,c)and(d);", "a := AND(b, c) AND (d);"),
        ("a [ 1 , -2 ]:=b . c ^ . d^.e;", "a[1, -2] := b.c^.d^.e;"),
        ("a := INT#-5+Colour#Red;", "a := INT#-5 + Colour#Red;"),
        ("f ( x:=1,not y=>z , q=> ) ;", "f(x := 1, NOT y => z, q =>);"),
        ("a:=w . %X3 or w.5;", "a := w.%X3 OR w.5;"),
        ("a := w.3 .5;", "a := w.3 .5;"),
        ("a:=not(b)<>true;", "a := NOT (b) <> TRUE;"),
    ] {
        assert_eq!(body(found), expected, "{found}");
    }
}

#[test]
fn ends_of_lines_are_those_of_the_source() {
    let text = "PROGRAM p\r\na:=1; // x  \r\n(* b\r\n   c *)\r\nEND_PROGRAM\r\n";
    let expected = "PROGRAM p\r\n    a := 1; // x\r\n    (* b\r\n       c *)\r\nEND_PROGRAM\r\n";
    assert_eq!(formatted(text).expect("it parses"), expected);
}

#[test]
fn what_does_not_parse_is_refused_with_the_errors_of_the_parser() {
    let Err(FormatError::Syntax(errors)) = formatted("PROGRAM p\n{x}\na := ;\nEND_PROGRAM") else {
        panic!("it was formatted");
    };
    assert_eq!(errors.len(), 1);
    assert!(errors[0].found.contains("cannot stand here"), "{errors:?}");
}

#[test]
fn indentation_makes_no_file_larger_than_a_source_may_be() {
    let deep = |statement: &str, count: usize| {
        let (open, close) = ("IF a THEN ".repeat(90), " END_IF".repeat(90));
        formatted(&format!("PROGRAM p {open}{}{close} END_PROGRAM", statement.repeat(count)))
    };
    assert!(deep("a();", 10).is_ok());
    assert!(matches!(deep("a();", 30_000), Err(FormatError::TooLarge)));
}

#[test]
fn a_lost_word_is_noticed() {
    let cut = |text: &str| {
        let mut sources = Sources::new();
        let file = sources.add("a.st", text.as_bytes()).expect("it is text");
        words::cut(file, sources.get(file)).iter().map(|word| word.start).collect::<Vec<_>>()
    };
    assert_eq!(cut("a (* b *) ;"), [0, 2, 10]);
    let differ = |one: &str, other: &str| {
        let mut sources = Sources::new();
        let one = sources.add("a.st", one.as_bytes()).expect("it is text");
        let other = sources.add("b.st", other.as_bytes()).expect("it is text");
        difference(&words::cut(one, sources.get(one)), &words::cut(other, sources.get(other)))
    };
    assert_eq!(differ("if a (* b\n c *)", "IF  a(* b  \nc *)"), None);
    assert_eq!(differ("a b", "a c"), Some(Some(2)));
    assert_eq!(differ("a b", "a B"), Some(Some(2)));
    assert_eq!(differ("a b", "a"), Some(Some(2)));
    assert_eq!(differ("a", "a b"), Some(None));
    assert_eq!(differ("a (* b *)", "a (* bc *)"), Some(Some(2)));
}
