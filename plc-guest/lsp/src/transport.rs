//! Messages as bytes: a header with a length, an empty line, JSON.
//!
//! `lsp-server` has the messages and writes them. Reading is done here, because it would make room for whatever
//! length a header names, and would end at the first text that is no message.

use std::io::{self, BufRead, Read, Write};

use lsp_server::{ErrorCode, Message};
use serde_json::{Value, json};

/// The bytes of one message. A file of 8 MiB takes less, also with each of its bytes escaped as `\n` is.
pub const MESSAGE_BYTES: u64 = 32 << 20;

/// The bytes of one line of a header.
const LINE_BYTES: u64 = 4096;

/// The lines of a header.
const LINES: usize = 16;

/// What was read.
#[derive(Debug)]
pub enum Incoming {
    /// A message.
    Message(Message),
    /// A text that is no message, with the answer to it.
    Unreadable(String),
}

/// Why nothing more can be read.
#[derive(Debug)]
pub enum ReadError {
    /// The stream refuses.
    Io(io::Error),
    /// It is not in the form of the protocol, so that the next message cannot be found.
    Header(String),
}

impl std::fmt::Display for ReadError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot read the next message: {error}"),
            Self::Header(found) => {
                write!(f, "the input is not that of a language client: {found}")
            }
        }
    }
}

impl std::error::Error for ReadError {}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// The next message; none at the end of the input.
///
/// # Errors
///
/// See [`ReadError`].
pub fn read(input: &mut impl BufRead) -> Result<Option<Incoming>, ReadError> {
    let Some(length) = header(input)? else { return Ok(None) };
    let mut bytes = Vec::new();
    // It grows with what comes and not with what is promised.
    input.take(length).read_to_end(&mut bytes)?;
    if (bytes.len() as u64) < length {
        return Ok(None);
    }
    let value: Value = match serde_json::from_slice(&bytes) {
        Ok(value) => value,
        Err(error) => {
            let text = format!("this is no JSON: {error}");
            return Ok(Some(unreadable(ErrorCode::ParseError, &Value::Null, &text)));
        }
    };
    let id = value.get("id").cloned().unwrap_or(Value::Null);
    Ok(Some(match serde_json::from_value(value) {
        Ok(message) => Incoming::Message(message),
        Err(_) => {
            let text = "this is neither a request nor a notification nor a response";
            let id = if id.is_i64() || id.is_string() { id } else { Value::Null };
            unreadable(ErrorCode::InvalidRequest, &id, text)
        }
    }))
}

fn unreadable(code: ErrorCode, id: &Value, text: &str) -> Incoming {
    let error = json!({ "code": code as i32, "message": text });
    Incoming::Unreadable(json!({ "jsonrpc": "2.0", "id": id, "error": error }).to_string())
}

/// The length of the message that follows.
fn header(input: &mut impl BufRead) -> Result<Option<u64>, ReadError> {
    let mut length = None;
    for number in 0..LINES {
        let mut line = Vec::new();
        input.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line)?;
        if line.is_empty() && number == 0 {
            return Ok(None);
        }
        let text = String::from_utf8_lossy(&line);
        let shown = || text.chars().take(80).collect::<String>();
        let Some(text) = text.strip_suffix("\r\n") else {
            return Err(ReadError::Header(format!("a line {:?} without its end", shown())));
        };
        if text.is_empty() {
            let missing = || ReadError::Header("a header without Content-Length".into());
            return length.ok_or_else(missing).map(Some);
        }
        let Some((name, value)) = text.split_once(':') else {
            return Err(ReadError::Header(format!("{:?}, which is no header", shown())));
        };
        if name.trim().eq_ignore_ascii_case("Content-Length") {
            let number: Option<u64> = value.trim().parse().ok();
            length = match number {
                Some(number) if number <= MESSAGE_BYTES => Some(number),
                _ => {
                    let found = format!("{:?}; allowed are at most {MESSAGE_BYTES} bytes", shown());
                    return Err(ReadError::Header(found));
                }
            };
        }
    }
    Err(ReadError::Header(format!("a header of more than {LINES} lines")))
}

/// Writes a message.
///
/// # Errors
///
/// Those of `output`.
pub fn write(output: &mut impl Write, message: &Message) -> io::Result<()> {
    message.write(output)
}

/// Writes a message that is JSON already.
///
/// # Errors
///
/// Those of `output`.
pub fn write_text(output: &mut impl Write, text: &str) -> io::Result<()> {
    write!(output, "Content-Length: {}\r\n\r\n{text}", text.len())?;
    output.flush()
}
