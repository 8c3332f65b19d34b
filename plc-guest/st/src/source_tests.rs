//! Places in sources: lines, columns, and text that is none.

use super::*;

#[test]
fn a_position_counts_characters_and_not_bytes() {
    let mut sources = Sources::new();
    let file = sources.add("a.st", "ä := 1;\r\n  öö := x;\n".as_bytes()).expect("it is text");
    let text = sources.get(file).text();
    let at = text.find('x').expect("it is there") as u32;
    assert_eq!(sources.get(file).position(at), Position { line: 2, column: 9 });
    assert_eq!(sources.get(file).line(1), "ä := 1;");
    assert_eq!(sources.get(file).line(2), "  öö := x;");
    assert_eq!(sources.get(file).line(7), "");
}

#[test]
fn an_offset_behind_the_end_is_the_end() {
    let mut sources = Sources::new();
    let file = sources.add("a.st", b"abc").expect("it is text");
    assert_eq!(sources.get(file).position(99), Position { line: 1, column: 4 });
}

#[test]
fn what_is_no_text_is_refused_with_its_place() {
    let mut sources = Sources::new();
    assert_eq!(
        sources.add("b.st", b"ab\xFFc"),
        Err(SourceError::NotText { name: "b.st".into(), offset: 2 })
    );
    assert_eq!(
        sources.add("b.st", b"a\0c"),
        Err(SourceError::NotText { name: "b.st".into(), offset: 1 })
    );
}

#[test]
fn a_column_of_a_long_line_is_exact_in_every_block() {
    let mut sources = Sources::new();
    let text = "aö".repeat(400);
    let file = sources.add("a.st", text.as_bytes()).expect("it is text");
    let source = sources.get(file);
    for (index, (offset, _)) in text.char_indices().enumerate() {
        let expected = Position { line: 1, column: index as u32 + 1 };
        assert_eq!(source.position(offset as u32), expected);
    }
}

/// What is missing at the end of a text is told there, also if the text fills its last block.
#[test]
fn the_end_of_a_text_of_any_length_has_its_column() {
    for (character, length) in ["x", "ö"].into_iter().flat_map(|character| {
        [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK].map(|length| (character, length))
    }) {
        let mut sources = Sources::new();
        let text = character.repeat(length / character.len());
        let file = sources.add("a.st", text.as_bytes()).expect("it is text");
        let column = text.chars().count() as u32 + 1;
        assert_eq!(sources.get(file).position(text.len() as u32), Position { line: 1, column });
    }
}
