//! From bytes to the raw form, with every failure in our own words.
//!
//! The `toml` crate knows where a file stops being TOML, and serde what type stood where another
//! was wanted. Both speak of fields, structs and `i64`, to programmers. What they say is reworded
//! here; what is not recognised passes unchanged, so a newer version of either can make a message
//! plainer or rougher, but never lose its place.

use std::str::Utf8Error;

use serde::de::DeserializeOwned;

use super::diagnostic::Diagnostic;
use super::raw;

/// The version of the format that this Takt reads.
const VERSION: i64 = 1;

/// What to write for a key that is missing.
const EXAMPLES: &[(&str, &str)] = &[
    ("version", "`version = 1` as the first line"),
    ("system", "a table [system] with the keys `name` and `major_frame`"),
    ("name", "`name = \"a-name\"`"),
    ("bit_rate", "`bit_rate = \"500kbit/s\"`"),
    ("major_frame", "`major_frame = \"1ms\"`, the time after which the schedule repeats"),
    (
        "kind",
        "`kind = \"plc\"` or `kind = \"linux\"`; for a channel `kind = \"sampling\"` or \
         `kind = \"queuing\"`",
    ),
    ("cpu", "`cpu = 0`, the number of the host's CPU that the partition runs on"),
    ("memory", "`memory = \"64MiB\"`"),
    ("partition", "`partition = \"a-name\"`, the partition that this is about"),
    ("offset", "`offset = \"0us\"`, counted from the start of the major frame"),
    ("duration", "`duration = \"300us\"`"),
    ("period", "`period = \"1ms\"`, the time from one release of the task to the next"),
    ("budget", "`budget = \"100us\"`, the longest that one job of the task executes"),
    ("priority", "`priority = 1`, from 0 to 255; a higher number is more urgent"),
    ("message_bytes", "`message_bytes = 512`, the length of the longest message"),
    ("source", "`source = \"cell:setpoints\"`, the partition that sends and its port"),
    (
        "destinations",
        "`destinations = [\"axis:setpoints\"]`, the partitions that receive, and their ports",
    ),
    ("vector", "`vector = 64`, a number from 32 to 254 by which the guest knows the interrupt"),
    ("ports", "`ports = \"0x378-0x37a\"`, the first and the last port of a range"),
    ("address", "`address = \"0xd0000000\"`, where the guest sees the device's memory"),
    ("size", "`size = \"4KiB\"`, how much of the device's memory the guest sees"),
    ("width", "`width = 1`, the bytes of the access: 1, 2 or 4"),
    ("value", "`value = \"0x00\"`"),
    ("image", "`image = \"tank.plc\"`, a program image"),
    ("path", "`path = \"disk.img\"`"),
    ("tap", "`tap = \"takt0\"`, the name of the interface on the host"),
    ("mac", "`mac = \"02:00:00:00:00:01\"`"),
    ("shape", "`shape = \"constant\"`, \"ramp\", \"sine\" or \"square\""),
    ("error", "`error = \"deadline-missed\"`, or another error of docs/health.md"),
    ("action", "`action = \"log\"`, or another action of docs/health.md"),
    ("at_most", "`at_most = 3`"),
    ("within", "`within = \"10s\"`"),
];

/// What the parser and serde call things, and what the file's author calls them.
const PLAIN: &[(&str, &str)] = &[
    ("i64", "a whole number"),
    ("f64", "a number without quotes, such as 2.5"),
    ("a boolean", "true or false"),
    ("a string", "a text in quotes"),
    ("a sequence", "a list in square brackets, such as `[0, 1]` or `[\"axis:setpoints\"]`"),
    ("literal string", "a value: a text in quotes, a whole number, true or false"),
    ("`nan`", "a value: a text in quotes, a whole number, true or false"),
    ("`\"`", "a text that ends with `\"` on the same line"),
    ("newline", "a new line"),
    ("newline, `#`", "one key and its value on a line"),
    ("non-double-quote visible characters, `\\`", "printable characters"),
    ("invalid float", "this is not a value"),
    ("invalid basic string", "this text is broken"),
    ("recursion limit", "a key has too many parts"),
    ("cannot recurse further; max recursion depth met", "this is nested too deep"),
];

fn plain(words: &str) -> &str {
    PLAIN.iter().find(|(theirs, _)| *theirs == words).map_or(words, |(_, ours)| ours)
}

/// Reads the raw form.
pub fn parse(text: &str) -> Result<raw::File, Diagnostic> {
    // The version comes first: a file of another version is told so, and not that it has a key
    // which this version does not know.
    let version = from_toml::<raw::Versioned>(text)?.version;
    if *version.get_ref() != VERSION {
        let found = format!("the file is of version {}", version.get_ref());
        let allowed = format!("{VERSION}, the version that this Takt reads");
        return Err(Diagnostic::new(version.span(), found, allowed));
    }
    from_toml(text)
}

/// The defect of a file that is not UTF-8, and the text to show it in: the bad bytes become
/// replacement characters, so all before the first of them keeps its position.
pub fn not_utf8(bytes: &[u8], error: Utf8Error) -> (String, Diagnostic) {
    let at = error.valid_up_to();
    let byte = bytes.get(at).copied().unwrap_or_default();
    let span = at..at + char::REPLACEMENT_CHARACTER.len_utf8();
    let found = format!("the byte {byte:#04x} is not UTF-8");
    let shown = String::from_utf8_lossy(bytes).into_owned();
    (shown, Diagnostic::new(span, found, "text in UTF-8"))
}

fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, Diagnostic> {
    toml::from_str(text).map_err(|error| {
        // Without a place it is the whole file that lacks something: its start stands for it.
        let span = error.span().unwrap_or(0..0);
        let date =
            text.get(span.clone()).is_some_and(|v| v.starts_with(|c: char| c.is_ascii_digit()));
        let (found, allowed) = reword(error.message(), date);
        Diagnostic::new(span, found, allowed)
    })
}

/// What was found and what is allowed. `date` says that the value starts with a digit: serde has
/// no dates, and calls one a map.
fn reword(message: &str, date: bool) -> (String, String) {
    let (found, expected) = match message.rsplit_once(", expected ") {
        Some((found, expected)) => (found, Some(expected)),
        None => (message, None),
    };
    let allowed = match expected {
        Some(_) if found.ends_with(" as i128") => "a whole number of at most 64 bits",
        Some(expected) => plain(expected),
        None if found == "duplicate key" => "each key once in its table",
        None => "what TOML allows, with the keys that docs/partition-file.md lists",
    };
    let found = if let Some(key) = found.strip_prefix("missing field ") {
        let name = key.trim_matches('`');
        let example = EXAMPLES.iter().find(|(k, _)| *k == name).map_or(allowed, |(_, e)| e);
        return (format!("the key {key} is missing"), example.to_owned());
    } else if found.contains("$__toml_private_datetime") {
        return ("found a date or a time".into(), "no date or time anywhere".into());
    } else if let Some(key) = found.strip_prefix("unknown field ") {
        format!("unknown key {key}")
    } else if let Some(value) = found.strip_prefix("invalid type: ") {
        match value {
            "map" if date => "found a date or a time".to_owned(),
            "map" => "found a table".to_owned(),
            "sequence" => "found an array".to_owned(),
            value => format!("found {}", value.strip_suffix(" as i128").unwrap_or(value)),
        }
    } else {
        plain(found).to_owned()
    };
    (found, allowed.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn serdes_words_become_those_of_the_file() {
        let says = |message| {
            let (found, allowed) = reword(message, false);
            format!("{found} | {allowed}")
        };
        assert_eq!(says("unknown field `x`, expected `a` or `b`"), "unknown key `x` | `a` or `b`");
        assert_eq!(
            says("invalid type: integer `3`, expected a string"),
            "found integer `3` | a text in quotes"
        );
        assert!(says("missing field `kind`").starts_with("the key `kind` is missing | `kind = "));
        assert_eq!(
            says("invalid type: integer `9` as i128, expected i64"),
            "found integer `9` | a whole number of at most 64 bits"
        );
        assert!(says("something new").starts_with("something new | what TOML allows"));
    }

    #[test]
    fn a_date_is_not_called_a_table() {
        assert_eq!(reword("invalid type: map, expected i64", true).0, "found a date or a time");
    }
}
