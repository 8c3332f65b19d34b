//! Messages as the tool takes and shows them.

use std::io::{self, Read, Write};

use serde::Serialize;
use serde_json::Value as Json;

use crate::arguments::Shape;
use crate::failure::Failure;
use crate::layout::{Layout, Values};

/// What is shown of a message that came.
#[derive(Debug)]
pub struct Message<'a> {
    pub port: &'a str,
    /// 0, or 4 if messages before it were overwritten.
    pub code: u32,
    pub age_ns: u64,
    /// Only samples have one.
    pub valid: Option<bool>,
    pub bytes: &'a [u8],
}

/// A line of `--json`.
#[derive(Debug, Serialize)]
struct Line<'a> {
    port: &'a str,
    code: u32,
    age_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    valid: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fields: Option<Values<'a>>,
}

impl Shape {
    /// Shows a message, at once.
    pub fn show(&self, message: &Message<'_>, out: &mut impl Write) -> Result<(), Failure> {
        let bytes = message.bytes;
        let values = self.layout.as_ref().map(|layout| layout.decode(bytes)).transpose();
        let values =
            values.map_err(|error| Failure::shape(message.port, &error, &hexadecimal(bytes)))?;
        let written = match (self.json, values) {
            (true, fields) => {
                let line = Line {
                    port: message.port,
                    code: message.code,
                    age_ns: message.age_ns,
                    valid: message.valid,
                    bytes: fields.is_none().then(|| hexadecimal(bytes)),
                    fields,
                };
                serde_json::to_string(&line)
                    .map_err(io::Error::from)
                    .and_then(|line| writeln!(out, "{line}"))
            }
            (false, Some(values)) => writeln!(out, "{values}"),
            (false, None) if self.hex => writeln!(out, "{}", hexadecimal(bytes)),
            (false, None) => out.write_all(bytes),
        };
        written.and_then(|()| out.flush()).map_err(|error| Failure::Stream("output", error))
    }

    /// Calls `each` with every message of the argument or of standard input.
    pub fn take(
        &self,
        data: Option<&str>,
        count: Option<u64>,
        input: impl io::BufRead,
        mut each: impl FnMut(&[u8]) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let failed = |error| Failure::Stream("input", error);
        if let Some(data) = data {
            let message = self.parse(data.as_bytes())?;
            return (0..count.unwrap_or(1)).try_for_each(|_| each(&message));
        }
        if self.is_raw() {
            let mut message = Vec::new();
            // One byte more than any message, so that one that is too long is seen to be.
            let most = u64::from(takt_port::channel::MESSAGE_MAX) + 1;
            input.take(most).read_to_end(&mut message).map_err(failed)?;
            return (0..count.unwrap_or(1)).try_for_each(|_| each(&message));
        }
        let most = usize::try_from(count.unwrap_or(u64::MAX)).unwrap_or(usize::MAX);
        for line in input.split(b'\n').take(most) {
            each(&self.parse(&line.map_err(failed)?)?)?;
        }
        Ok(())
    }

    fn is_raw(&self) -> bool {
        !self.hex && !self.json && self.layout.is_none()
    }

    fn parse(&self, data: &[u8]) -> Result<Vec<u8>, Failure> {
        if self.is_raw() {
            return Ok(data.to_owned());
        }
        let text = std::str::from_utf8(data).map_err(|error| Failure::Usage(error.to_string()))?;
        let parsed = match (self.json, &self.layout) {
            (true, layout) => from_json(text, layout.as_ref()),
            (false, Some(layout)) => layout.encode_text(text),
            (false, None) => from_hexadecimal(text),
        };
        parsed.map_err(Failure::Usage)
    }
}

fn from_json(text: &str, layout: Option<&Layout>) -> Result<Vec<u8>, String> {
    let object: Json = serde_json::from_str(text).map_err(|error| format!("JSON: {error}"))?;
    match (object.get("fields"), object.get("bytes"), layout) {
        (Some(fields), _, Some(layout)) => layout.encode_json(fields),
        (_, Some(Json::String(bytes)), _) => from_hexadecimal(bytes),
        (Some(_), None, None) => Err("fields need a --layout".to_owned()),
        _ => Err("a message in JSON has fields, or bytes as hexadecimal text".to_owned()),
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hexadecimal(text: &str) -> Result<Vec<u8>, String> {
    let digits: Option<Vec<u8>> = text
        .chars()
        .filter(|c| !c.is_ascii_whitespace())
        .map(|c| c.to_digit(16).map(|digit| digit as u8))
        .collect();
    match digits {
        Some(digits) if digits.len().is_multiple_of(2) => {
            Ok(digits.as_chunks::<2>().0.iter().map(|[high, low]| high << 4 | low).collect())
        }
        _ => Err(format!("{text}: not pairs of hexadecimal digits")),
    }
}

#[cfg(test)]
#[path = "format_tests.rs"]
mod tests;
