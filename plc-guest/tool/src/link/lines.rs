//! The line map, from the debug information of the compiler.

use std::path::Path;

use addr2line::gimli::{self, EndianSlice, LittleEndian};
use takt_program::CodeOffset;
use takt_program::address::CODE;
use takt_program::build::Line;

use super::elf::Program;

type Context<'a> = addr2line::Context<EndianSlice<'a, LittleEndian>>;

/// The lines of all code that debug information tells of; paths inside of `here` are made relative to it.
/// Without debug information, or if it is broken, there are none: a program runs as well without.
pub fn of(program: &Program, here: &Path) -> Vec<Line> {
    lines(program, here).unwrap_or_default()
}

fn lines(program: &Program, here: &Path) -> Result<Vec<Line>, gimli::Error> {
    let section = |id: gimli::SectionId| -> Result<_, gimli::Error> {
        let bytes = program.debug.get(id.name()).map_or(&[][..], Vec::as_slice);
        Ok(EndianSlice::new(bytes, LittleEndian))
    };
    let context = addr2line::Context::from_dwarf(gimli::Dwarf::load(section)?)?;
    let end = CODE + program.code.len() as u64;
    let mut lines: Vec<Line> = Vec::new();
    let mut known_to = CODE;
    for (at, bytes, location) in context.find_location_range(CODE, end)? {
        if at > known_to {
            lines.push(Line { at: offset(known_to), file: String::new(), line: 0 });
        }
        known_to = at.saturating_add(bytes);
        let inner = (location.file.unwrap_or_default(), location.line.unwrap_or(0));
        let (file, line) = match of_library(inner.0) {
            true => caller(&context, at).unwrap_or(inner),
            false => inner,
        };
        let file =
            Path::new(file).strip_prefix(here).map_or(file.into(), |path| path.to_string_lossy());
        let same = |last: &Line| last.line == line && last.file == file;
        if (CODE..end).contains(&at) && !lines.last().is_some_and(same) {
            lines.push(Line { at: offset(at), file: file.into_owned(), line });
        }
    }
    if known_to > CODE && known_to < end {
        lines.push(Line { at: offset(known_to), file: String::new(), line: 0 });
    }
    Ok(lines)
}

/// The place in the project from which the function of a library comes that was put there.
fn caller<'a>(context: &'a Context<'a>, at: u64) -> Option<(&'a str, u32)> {
    let mut frames = context.find_frames(at).skip_all_loads().ok()?;
    while let Ok(Some(frame)) = frames.next() {
        if let Some(location) = frame.location
            && let (Some(file), Some(line)) = (location.file, location.line)
            && !of_library(file)
        {
            return Some((file, line));
        }
    }
    None
}

/// Whether a file is of the SDK, of Rust's libraries, or of a crate that was fetched. A line there tells an author nothing.
pub fn of_library(file: &str) -> bool {
    const FOLDERS: [&str; 5] =
        ["/rustc/", "/lib/rustlib/", "/.cargo/registry/", "takt-sdk/", "takt-blocks/"];
    const HEADERS: [&str; 2] = ["takt.h", "blocks.h"];
    let name = file.rsplit('/').next().unwrap_or(file);
    HEADERS.contains(&name) || FOLDERS.iter().any(|folder| file.contains(folder))
}

/// Only for addresses of the code, which has at most 16 MiB.
fn offset(at: u64) -> CodeOffset {
    CodeOffset((at - CODE) as u32)
}
