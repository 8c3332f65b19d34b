//! What files are that an image cannot be made of, by their first bytes.

use std::io::Read;
use std::path::{Path, PathBuf};

use takt_st::diagnostic::{Code, Diagnostic};
use takt_st::source::Sources;

use super::structured_text::is_text;

/// What the names of these files do not tell apart, with how to go on.
const ALLOWED: &str =
    "Structured Text (.st), folders of it, or object files (.o) and static libraries (.a)";

/// Messages about the inputs that are neither Structured Text nor object files or static libraries.
pub fn refused(inputs: &[PathBuf]) -> Sources {
    let mut sources = Sources::new();
    for path in inputs.iter().filter(|path| !is_text(path)) {
        let (code, found, hint) = match kind(path) {
            Ok(Kind::Linkable) => continue,
            Ok(Kind::Other(found, hint)) => (Code::NoSource, format!("found {found}"), hint),
            Err(error) => (Code::CannotRead, format!("cannot be read: {error}"), None),
        };
        sources.refuse(&path.display().to_string(), None, |span| {
            let one = Diagnostic::new(code, span, found).allowed(ALLOWED);
            match hint {
                Some(hint) => one.hint(hint),
                None => one,
            }
        });
    }
    sources
}

/// What a file is.
enum Kind {
    /// An object file or a static library.
    Linkable,
    /// Something else, and what to do about it.
    Other(&'static str, Option<&'static str>),
}

fn kind(path: &Path) -> std::io::Result<Kind> {
    if !path.metadata()?.is_file() {
        return Ok(Kind::Other("a device, socket or pipe", None));
    }
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(512).read_to_end(&mut bytes)?;
    Ok(of_bytes(&bytes))
}

fn of_bytes(bytes: &[u8]) -> Kind {
    if bytes.starts_with(b"!<arch>\n") || bytes.starts_with(b"!<thin>\n") {
        return Kind::Linkable;
    }
    if bytes.starts_with(b"\x7FELF") {
        // The file's type, behind 16 bytes: little-endian, as everything here is.
        return match bytes.get(16..18) {
            Some([1, 0]) => Kind::Linkable,
            Some([2, 0]) => Kind::Other("an ELF program", Some(COMPILED)),
            Some([3, 0]) => Kind::Other("an ELF program or shared library", Some(COMPILED)),
            _ => Kind::Other("an ELF file that is no object file", Some(COMPILED)),
        };
    }
    if bytes.starts_with(&takt_program::MAGIC) {
        let hint = "it is built already: `takt plc inspect` shows it, `takt plc test` runs it";
        return Kind::Other("a program image of Takt", Some(hint));
    }
    if bytes.starts_with(b"BC\xC0\xDE") {
        let hint = "clang writes it with -flto: compile without";
        return Kind::Other("what LLVM optimises later, without machine code", Some(hint));
    }
    if bytes.is_empty() {
        return Kind::Other("an empty file", None);
    }
    if SCRIPT.iter().any(|word| bytes.windows(word.len()).any(|part| part == *word)) {
        let hint = "give the library that it names (after GROUP or INPUT) instead";
        return Kind::Other("a script for a linker", Some(hint));
    }
    // A character may be cut in the middle.
    let cut = str::from_utf8(bytes).err().is_none_or(|error| error.error_len().is_none());
    match cut && !bytes.contains(&0) {
        true => Kind::Other(
            "text in a file whose name does not end with .st",
            Some("if it is Structured Text, give it a name that ends with .st"),
        ),
        false => Kind::Other("a binary file of another kind", None),
    }
}

/// How distributions begin the scripts that they put into the place of a library.
const SCRIPT: [&[u8]; 2] = [b"/* GNU ld script", b"OUTPUT_FORMAT("];

const COMPILED: &str = "an image is made of what a compiler writes with `-c`, before it is linked";
