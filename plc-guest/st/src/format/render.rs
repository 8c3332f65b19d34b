//! From lines to text: indentation, and where comments stand.

use super::layout::Line;
use super::words::Word;
use crate::limits;
use crate::syntax::token::TokenKind;

/// The blanks of one level.
const LEVEL: usize = 4;

/// The columns from one tab stop to the next, for what is left of a source's tabs.
const TAB: usize = 4;

/// The text of all lines; ends of lines are those of `source`. None if it would be larger than a source
/// may be.
pub(super) fn text(lines: &[Line<'_>], source: &str) -> Option<String> {
    let columns = remark_columns(lines);
    let mut text = String::new();
    for (line, column) in lines.iter().zip(columns) {
        if line.blank_before {
            text.push('\n');
        }
        text.extend(std::iter::repeat_n(' ', LEVEL * line.indent));
        for (at, piece) in line.pieces.iter().enumerate() {
            let last = at + 1 == line.pieces.len();
            if let Some(column) = column.filter(|_| last) {
                let missing = column.saturating_sub(column_at(&text, text.len()));
                text.extend(std::iter::repeat_n(' ', missing.max(1)));
            } else if at > 0 && piece.blank_before {
                text.push(' ');
            }
            push(&mut text, &piece.word, source);
        }
        text.push('\n');
        if text.len() > limits::FILE_BYTES {
            return None;
        }
    }
    let carriage_returns = source
        .find('\n')
        .is_some_and(|end| source.get(..end).is_some_and(|line| line.ends_with('\r')));
    Some(if carriage_returns { text.replace('\n', "\r\n") } else { text })
}

/// For each line the column of the comment at its end, if it has one behind other words.
///
/// Comments of lines that belong together stand in one column. Among declarations, lines without a
/// comment may lie between them; among statements those would only bring distant lines together.
fn remark_columns(lines: &[Line<'_>]) -> Vec<Option<usize>> {
    let mut columns = vec![None; lines.len()];
    let mut first = 0;
    while let Some(line) = lines.get(first) {
        let rest = lines.get(first + 1..).unwrap_or(&[]);
        let belongs = |next: &&Line<'_>| {
            !next.blank_before
                && next.indent == line.indent
                && next.declares == line.declares
                && (line.declares || width(next).is_some() && width(line).is_some())
        };
        let behind = first + 1 + rest.iter().take_while(belongs).count();
        let group = lines.get(first..behind).unwrap_or(&[]);
        let widest = group.iter().filter_map(width).max();
        for (column, line) in columns.iter_mut().skip(first).zip(group) {
            *column = width(line).and(widest).map(|widest| LEVEL * line.indent + widest + 1);
        }
        first = behind;
    }
    columns
}

/// The characters before the comment at the end of a line; none if there is no such comment.
fn width(line: &Line<'_>) -> Option<usize> {
    let (last, words) = line.pieces.split_last()?;
    let of_lines = words.iter().any(|piece| piece.word.text.contains('\n'));
    if !last.word.is_remark() || of_lines || words.iter().all(|piece| piece.word.is_remark()) {
        return None;
    }
    let characters =
        words.iter().map(|piece| piece.word.text.chars().count() + usize::from(piece.blank_before));
    // The first word has no blank before it.
    Some(
        characters.sum::<usize>()
            - words.first().map_or(0, |piece| usize::from(piece.blank_before)),
    )
}

/// Adds a word. The lines of a comment keep their places relative to its first one.
fn push(text: &mut String, word: &Word<'_>, source: &str) {
    let mut lines = word.text.split('\n');
    let first = lines.next().unwrap_or("");
    if word.text.len() == first.len() {
        text.push_str(first);
        return;
    }
    let new = column_at(text, text.len());
    let old = column_at(source, word.start);
    text.push_str(end_cut(first, word));
    for line in lines {
        text.push('\n');
        let line = end_cut(line, word);
        if word.kind == TokenKind::Pragma {
            text.push_str(line);
            continue;
        }
        let body = line.trim_ascii_start();
        if !body.is_empty() {
            let column = column_at(line, line.len() - body.len());
            text.extend(std::iter::repeat_n(' ', (column + new).saturating_sub(old)));
            text.push_str(body);
        }
    }
}

/// A line of a comment or pragma without what its end of line leaves.
fn end_cut<'a>(line: &'a str, word: &Word<'_>) -> &'a str {
    match word.kind {
        TokenKind::Pragma => line.strip_suffix('\r').unwrap_or(line),
        _ => line.trim_ascii_end(),
    }
}

/// The column of a byte in its line, from 0.
fn column_at(text: &str, at: usize) -> usize {
    let before = text.get(..at).unwrap_or("");
    let line = before.rsplit('\n').next().unwrap_or("");
    line.chars().fold(0, |column, character| match character {
        '\t' => column + TAB - column % TAB,
        _ => column + 1,
    })
}
