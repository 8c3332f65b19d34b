//! How a defect in a partition file is shown: as a compiler would, with the line itself.
//!
//! The reader of these messages stands before a machine that did not start. So each one is the
//! same four things: the place, what was found, the line with the value underlined, what is
//! allowed; and where two lines contradict each other, both are shown.
//!
//! A defect is data and text, not one enum variant per rule: nothing in Takt ever branches on
//! *which* rule a file broke, and the wording is best read beside the check it belongs to.
//!
//! The file is hostile input, and its content reaches a terminal through here: control characters
//! and those that reverse the direction of writing are replaced, and everything is cut to a length.

use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

/// A place in the file, in bytes.
pub type Span = Range<usize>;

/// Longest line that is shown whole, in characters.
const LINE_MAX: usize = 100;
/// What is kept of a longer line: this much before the value, of the value, and after it.
const KEEP: [usize; 3] = [40, 60, 30];
/// Longest piece of the file that is repeated inside a message, in characters.
const QUOTE_MAX: usize = 60;
/// Longest message, in characters: the parser repeats a key of any length. Our own are shorter.
const MESSAGE_MAX: usize = 2000;
/// A tab is shown as this, so that the underline fits whatever the terminal's tab stops are.
const TAB: &str = "    ";

/// One defect of a partition file.
#[derive(Debug)]
pub struct Diagnostic {
    span: Span,
    message: String,
    related: Option<(Span, String)>,
    allowed: String,
}

impl Diagnostic {
    /// A defect at `span`: what was found there, and what would have been allowed.
    pub fn new(span: Span, found: impl Into<String>, allowed: impl Into<String>) -> Diagnostic {
        Diagnostic { span, message: found.into(), related: None, allowed: allowed.into() }
    }

    /// Adds the other place of a contradiction, with a few words about it.
    pub fn and(mut self, span: Span, label: impl Into<String>) -> Diagnostic {
        self.related = Some((span, label.into()));
        self
    }

    /// The whole message, without a newline at its end. `path` is printed as the user gave it.
    pub fn render(&self, path: &Path, text: &str) -> String {
        let here = Excerpt::of(text, &self.span);
        let there = self.related.as_ref().map(|(span, label)| (Excerpt::of(text, span), label));
        let line_max = there.as_ref().map_or(here.line, |(there, _)| there.line.max(here.line));
        let gutter = line_max.to_string().len();

        let mut out = String::new();
        let place = format!("{}:{}:{}", path.display(), here.line, here.column);
        // Writing to a String cannot fail.
        let _ = writeln!(out, "error: {place}: {}", first(&printable(&self.message), MESSAGE_MAX));
        here.draw(&mut out, gutter, '^', "");
        if let Some((there, label)) = there {
            there.draw(&mut out, gutter, '-', &printable(label));
        }
        let _ = write!(out, "{:gutter$} = allowed: {}", "", printable(&self.allowed));
        out
    }
}

/// A piece of the file for use inside a message: in quotes, escaped, cut.
pub fn quote(text: &str) -> String {
    let mut chars = text.chars();
    let head: String = chars.by_ref().take(QUOTE_MAX).collect();
    let more = if chars.next().is_some() { "..." } else { "" };
    format!("\"{}{more}\"", head.escape_debug())
}

/// One line of the file, made fit to be shown, and where in it a value lies.
struct Excerpt {
    /// From 1.
    line: usize,
    /// From 1, in characters of the file.
    column: usize,
    shown: String,
    /// Where in `shown` the underline starts, and its length, in characters.
    indent: usize,
    width: usize,
}

impl Excerpt {
    fn of(text: &str, span: &Span) -> Excerpt {
        let start = text.floor_char_boundary(span.start.min(text.len()));
        let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
        let rest = &text[line_start..];
        let line = rest.split('\n').next().unwrap_or(rest);
        let line = line.strip_suffix('\r').unwrap_or(line);

        // A value may start at the line's end, where something is missing, or go on to the next.
        let from = (start - line_start).min(line.len());
        let to = text.floor_char_boundary(span.end.min(text.len()));
        let to = to.saturating_sub(line_start).clamp(from, line.len());
        let (before, value, after) = (&line[..from], &line[from..to], &line[to..]);
        let pieces = [before, value, after].map(printable);

        let cut = pieces.iter().map(|p| p.chars().count()).sum::<usize>() > LINE_MAX;
        let [before_shown, value_shown, after_shown] = if cut {
            let [b, v, a] = KEEP;
            [last(&pieces[0], b), first(&pieces[1], v), first(&pieces[2], a)]
        } else {
            pieces
        };
        Excerpt {
            line: text[..line_start].matches('\n').count() + 1,
            column: before.chars().count() + 1,
            indent: before_shown.chars().count(),
            width: value_shown.chars().count().max(1),
            shown: format!("{before_shown}{value_shown}{after_shown}"),
        }
    }

    fn draw(&self, out: &mut String, gutter: usize, mark: char, label: &str) {
        let Excerpt { line, shown, indent, width, .. } = self;
        let marks: String = std::iter::repeat_n(mark, *width).collect();
        let underline = format!("{:indent$}{marks} {label}", "");
        let _ = writeln!(out, "{:gutter$} |", "");
        let _ = writeln!(out, "{}", format!("{line:gutter$} | {shown}").trim_end());
        let _ = writeln!(out, "{:gutter$} | {}", "", underline.trim_end());
    }
}

fn first(text: &str, count: usize) -> String {
    match text.char_indices().nth(count) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

fn last(text: &str, count: usize) -> String {
    match text.char_indices().rev().nth(count) {
        Some((at, c)) => format!("...{}", &text[at + c.len_utf8()..]),
        None => text.to_owned(),
    }
}

/// `text` without what could move a terminal's cursor or turn its direction of writing (Unicode
/// Standard Annex 9, explicit formatting characters).
fn printable(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\t' => out.push_str(TAB),
            '\u{061c}'
            | '\u{200e}'
            | '\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2066}'..='\u{2069}'
            | '\u{feff}' => out.push(char::REPLACEMENT_CHARACTER),
            c if c.is_control() => out.push(char::REPLACEMENT_CHARACTER),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn render(text: &str, span: Span) -> String {
        Diagnostic::new(span, "found", "this").render(Path::new("f.toml"), text)
    }

    #[test]
    fn the_value_is_underlined() {
        let expected = "error: f.toml:2:5: found\n  |\n2 | b = 10\n  |     ^^\n  = allowed: this";
        assert_eq!(render("a = 1\nb = 10\n", 10..12), expected);
    }

    #[test]
    fn the_other_place_is_shown_with_its_label_and_a_common_gutter() {
        let text = format!("a = 1\n{}b = 2\n", "\n".repeat(8));
        let d = Diagnostic::new(4..5, "found", "this").and(18..19, "the other one");
        let expected = "error: f:1:5: found\n   |\n 1 | a = 1\n   |     ^\n   |\n10 | b = 2\n   \
                        |     - the other one\n   = allowed: this";
        assert_eq!(d.render(Path::new("f"), &text), expected);
    }

    #[test]
    fn columns_are_characters_and_the_underline_fits_behind_tabs() {
        let text = "\t\"äöü\" = 7\r\n";
        let at = text.find('7').unwrap();
        let out = render(text, at..at + 1);
        assert!(out.starts_with("error: f.toml:1:10: "), "{out}");
        assert!(out.contains("\n1 |     \"äöü\" = 7\n  |             ^\n"), "{out}");
    }

    #[test]
    fn a_long_line_is_cut_around_the_value() {
        let text = format!("{}VALUE{}", "x".repeat(5000), "y".repeat(5000));
        let out = render(&text, 5000..5005);
        assert!(out.contains(&format!("1 | ...{}VALUE{}...\n", "x".repeat(40), "y".repeat(30))));
        assert!(out.contains(&format!("  | {}^^^^^\n", " ".repeat(43))), "{out}");
    }

    #[test]
    fn a_value_of_several_lines_is_underlined_to_the_end_of_the_first() {
        assert!(render("a = '''x\ny'''\n", 4..13).contains("  |     ^^^^\n"));
    }

    #[test]
    fn nothing_from_the_file_reaches_the_terminal_as_a_command() {
        let out = render("a = \"\u{1b}[2J\u{202e}\"\n", 4..5);
        assert!(!out.contains(['\u{1b}', '\u{202e}']), "{out:?}");
        assert_eq!(quote("\u{1b}x"), "\"\\u{1b}x\"");
        assert_eq!(quote(&"x".repeat(100)).len(), 60 + 3 + 2);
    }

    #[test]
    fn a_message_has_an_end() {
        let message = "x".repeat(1 << 20);
        assert!(Diagnostic::new(0..1, message, "this").render(Path::new("f"), "a").len() < 3000);
    }

    #[test]
    fn a_place_outside_the_text_or_inside_a_character_does_not_panic() {
        for (start, end) in [(0, 0), (1, 2), (2, 1), (3, 99), (99, 99)] {
            let out = render("ä\n", start..end);
            assert!(out.starts_with("error: f.toml:"), "{out}");
        }
    }
}
