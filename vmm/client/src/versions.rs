//! Another version of a program: how it is sent, and how versions are shown.

use std::fmt::Write;
use std::io;
use std::path::Path;

use takt_protocol::{ImageVersion, Load, PART_MAX, Request, VersionStatus};

use crate::error::ClientError;
use crate::plain;

/// The bytes of an image.
///
/// # Errors
/// If the file cannot be read, or is empty.
pub fn read(image: &Path) -> Result<Vec<u8>, ClientError> {
    let bad = |source| ClientError::Image { path: image.to_owned(), source };
    let bytes = std::fs::read(image).map_err(bad)?;
    if bytes.is_empty() {
        return Err(bad(io::Error::new(io::ErrorKind::InvalidData, "the file is empty")));
    }
    Ok(bytes)
}

/// The requests that bring an image into a PLC, part by part.
#[must_use]
pub fn load(partition: &str, program: &str, bytes: &[u8]) -> Vec<Request> {
    let parts: Vec<&[u8]> = bytes.chunks(PART_MAX).collect();
    // Takt refuses more parts than a bank has room for, which are far fewer.
    let count = parts.len() as u32;
    let request = |(part, data): (u32, &&[u8])| {
        Request::Load(Load {
            partition: partition.to_owned(),
            program: program.to_owned(),
            part,
            parts: count,
            data: data.to_vec(),
        })
    };
    (0..).zip(&parts).map(request).collect()
}

/// The versions of a program in one line or two.
#[must_use]
pub fn shown(status: &VersionStatus) -> String {
    let image = |image: &ImageVersion| {
        let digits: String = image.hash.chars().take(8).collect();
        format!("{} ({digits})", image.version)
    };
    let other = status.other.as_ref().map_or_else(|| "-".to_owned(), image);
    let reason = status.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    let mut text = format!(
        "{:<16} runs {}, other {other}, {}{reason}\n",
        status.program,
        image(&status.running),
        status.phase
    );
    if status.took_ns > 0 {
        let at = status.at_ns as f64 / 1e9;
        let took = status.took_ns;
        let cycle = status.cycle;
        let _ = writeln!(text, "{:<16} last change at {at:.3} s, cycle {cycle}, in {took} ns", "");
    }
    if status.carried_pages > 0 {
        let (pages, time) = (status.carried_pages, status.carrying_ns.div_ceil(1000));
        let _ = writeln!(text, "{:<16} {pages} pages carried to a second state in {time} us", "");
    }
    text.lines().map(|line| plain(line) + "\n").collect()
}
