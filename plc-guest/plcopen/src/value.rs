//! Initial values.

use crate::element::{Element, is_name};
use crate::error::{Defect, DefectKind};
use crate::type_spec::MAXIMUM_DEPTH;

/// ` := value` for the `<initialValue>` of a variable or type, or nothing if it has none.
pub fn initial_value(of: Element<'_>) -> Result<String, Defect> {
    match of.child("initialValue") {
        Some(initial) => Ok(format!(" := {}", value(initial, 0)?)),
        None => Ok(String::new()),
    }
}

/// The value within an element.
fn value(holder: Element<'_>, depth: u32) -> Result<String, Defect> {
    if depth > MAXIMUM_DEPTH {
        return Err(holder.defect(DefectKind::TooDeep { maximum: MAXIMUM_DEPTH }));
    }
    let inner = holder.inner("a value")?;
    match inner.tag() {
        "simpleValue" => simple(inner),
        "arrayValue" => {
            let mut values = Vec::new();
            for each in inner.children() {
                let one = value(each, depth + 1)?;
                values.push(match each.attribute("repetitionValue") {
                    Some(_) => format!("{}({one})", each.integer("repetitionValue")?),
                    None => one,
                });
            }
            Ok(format!("[{}]", values.join(", ")))
        }
        "structValue" => {
            let mut members = Vec::new();
            for each in inner.children() {
                members.push(format!("{} := {}", each.name_in("member")?, value(each, depth + 1)?));
            }
            Ok(format!("({})", members.join(", ")))
        }
        _ => Err(inner.not_supported()),
    }
}

/// A literal or the name of a constant. It stays as it is written, if it is one word of the language: a
/// value must not end its declaration and begin something else.
fn simple(element: Element<'_>) -> Result<String, Defect> {
    let value = element.required_attribute("value")?.trim();
    let string = is_string(value, '\'') || is_string(value, '"');
    let word = !value.is_empty()
        && value.chars().all(is_part_of_a_word)
        && value.char_indices().all(|(at, c)| !matches!(c, '+' | '-') || is_sign(&value[..at]));
    if string || word || value.split('#').all(is_name) {
        Ok(value.to_owned())
    } else {
        Err(element.value(value, "literal or name"))
    }
}

/// Characters of numbers, durations, dates, and names with a type before or a member after.
fn is_part_of_a_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '#' | '.' | '+' | '-' | ':' | '%')
}

/// Whether a plus or minus behind this is no operator: it is a sign at the beginning, in an exponent, or behind a type,
/// where the hyphens of dates are too.
fn is_sign(before: &str) -> bool {
    let number = before.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-'));
    before.is_empty() || before.contains('#') || number && before.ends_with(['e', 'E'])
}

/// Whether a text is one string in these quotes: `$` hides the character after it.
fn is_string(text: &str, quote: char) -> bool {
    let mut characters = text.chars();
    if characters.next() != Some(quote) {
        return false;
    }
    while let Some(c) = characters.next() {
        match c {
            '$' => {
                characters.next();
            }
            c if c == quote => return characters.next().is_none(),
            '\n' | '\r' => return false,
            _ => {}
        }
    }
    false
}
