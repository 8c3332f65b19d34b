//! Where one token ends and the next begins.

use super::*;
use crate::source::Sources;

/// The kinds of all words, and how many messages there were.
fn kinds(text: &str) -> (Vec<TokenKind>, usize) {
    let mut sources = Sources::new();
    let file = sources.add("a.st", text.as_bytes()).expect("it is text");
    let mut diagnostics = Diagnostics::new();
    let mut lexer = Lexer::new(file, sources.get(file));
    let mut kinds = Vec::new();
    loop {
        let token = lexer.next_word(&mut diagnostics);
        if token.kind == TokenKind::End {
            return (kinds, diagnostics.iter().count());
        }
        kinds.push(token.kind);
    }
}

#[test]
fn a_range_of_numbers_is_no_number_with_a_point() {
    use TokenKind::*;
    assert_eq!(kinds("1..10"), (vec![Integer, Sign(super::Sign::Range), Integer], 0));
    assert_eq!(kinds("1.5..x"), (vec![Real, Sign(super::Sign::Range), Identifier], 0));
    assert_eq!(kinds("T#1s..T#2s").0.len(), 3);
}

#[test]
fn a_date_ends_before_a_subtraction() {
    use TokenKind::*;
    let minus = Sign(super::Sign::Minus);
    assert_eq!(kinds("D#2026-01-02-D#2026-01-01").0, [Date, minus, Date]);
    assert_eq!(kinds("DT#2026-01-02-12:00:00 - T#1s").0, [DateAndTime, minus, Duration]);
    assert_eq!(kinds("T#-5s-T#5s").0, [Duration, minus, Duration]);
}

#[test]
fn keywords_have_any_case_and_names_may_begin_like_them() {
    use TokenKind::*;
    assert_eq!(
        kinds("end_Function_Block iffy"),
        (vec![Keyword(super::Keyword::EndFunctionBlock), Identifier], 0)
    );
    assert_eq!(super::Keyword::ALL.iter().map(|word| word.text().len()).max(), Some(LONGEST));
}

#[test]
fn comments_nest_and_an_open_one_is_told_at_its_start() {
    assert_eq!(kinds("(* a (* b *) c *) x /* // */ y // z"), (vec![TokenKind::Identifier; 2], 0));
    assert_eq!(kinds("(* a (* b *) x"), (vec![], 1));
    assert_eq!(kinds("(*"), (vec![], 1));
    assert_eq!(kinds("(*)"), (vec![], 1));
}

#[test]
fn strange_characters_in_a_row_are_one_error() {
    assert_eq!(kinds("a \u{1}\u{2}\u{3} b").1, 1);
    assert_eq!(kinds("größe").1, 1);
}

#[test]
fn what_is_neither_number_nor_name_is_told() {
    for text in ["1x", "2E3", "1_a", "'abc", "a__b"] {
        assert_eq!(kinds(text).1, 1, "{text}");
    }
}

#[test]
fn every_address_is_one_word() {
    for text in ["%IX0.0", "%QW4", "%M*", "%I1.2.3", "%X7"] {
        assert_eq!(kinds(text), (vec![TokenKind::Address], 0), "{text}");
    }
}
