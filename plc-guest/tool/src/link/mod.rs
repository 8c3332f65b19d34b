//! From object files and static libraries to a program image.
//!
//! The linking itself is done by the system's linker with a script of ours: it knows relocations, archives
//! and dead code better than anything that could be written here. What it makes, a static ELF file with everything at
//! its final address, is then read: the declarations of the program become tables of the image, the segments
//! become its segments, and the debug information its line map. What the guest's loader does not do is
//! refused: constructors, thread-local variables, relocations at load time, memory that is writable and
//! executable.

mod declarations;
mod declared;
mod elf;
mod lines;
mod linker;
mod names;
mod objects;
mod places;
mod registers;
mod undefined;

use std::path::{Path, PathBuf};

use takt_program::ImageError;

/// Why no image was made.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("cannot read {}: {source}", .path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("cannot make a temporary folder: {0}")]
    Temporary(std::io::Error),
    #[error("{} is no object file or static library: {source}", .path.display())]
    Object { path: PathBuf, source: object::Error },
    #[error(
        "no linker: neither ld nor ld.lld is in the PATH, and rustc has no rust-lld; on Debian, install binutils"
    )]
    NoLinker,
    #[error("cannot run {}: {source}", .linker.display())]
    Run { linker: PathBuf, source: std::io::Error },
    #[error("{} failed:\n{output}", .linker.display())]
    Linker { linker: PathBuf, output: String },
    #[error("these functions and variables are used but nowhere defined: {}{hints}", .symbols.join(", "))]
    Unresolved { symbols: Vec<String>, hints: String },
    #[error(
        "these functions and variables are weak and nowhere defined: {}; their address would be 0, and a call a fault. Define \
         them, or leave out what uses them",
        .symbols.join(", ")
    )]
    Weak { symbols: Vec<String> },
    #[error(
        "the program has functions whose code is chosen when it is loaded (ifunc): {}; the kernel loads no such functions. \
         Link a library without them",
        .functions.join(", ")
    )]
    Chosen { functions: Vec<String> },
    #[error(
        "{} has no code, only what gcc or clang keep for link-time optimisation; compile without -flto, or with -ffat-lto-objects",
        .path.display()
    )]
    Optimisation { path: PathBuf },
    #[error(
        "{} is a thin archive, which has no object files but their paths; make it without `T` (ar rcs), or give the object files",
        .path.display()
    )]
    Thin { path: PathBuf },
    #[error("output `{first}`, which task `{}` writes, and output `{second}`, which task `{}` writes, have a bit in common", .tasks.0, .tasks.1)]
    Shared { first: String, second: String, tasks: (String, String) },
    /// An error about what is declared there.
    #[error("{place}: {error}")]
    At { place: String, error: Box<LinkError> },
    #[error("{what}, {field}: {defect}")]
    Rule { what: String, field: &'static str, defect: takt_program::Defect },
    #[error("the linked program cannot be read: {0}")]
    Elf(#[from] object::Error),
    #[error(
        "section {name} of the object files is not one of a control program; allowed are .text, .rodata, .data, \
         .bss and their parts (.text.NAME)"
    )]
    Section { name: String },
    #[error(
        "the program has static constructors: {}; nothing would run them. Set such variables in the \
         function of TAKT_INIT",
        .functions.join(", ")
    )]
    Constructors { functions: Vec<String> },
    #[error(
        "the program has a function in the section .init or .fini; nothing would run it. TAKT_INIT(function) declares a \
         function that runs at each start"
    )]
    Init,
    #[error(
        "the program has thread-local variables: {}; a control program has no threads",
        .variables.join(", ")
    )]
    ThreadLocal { variables: Vec<String> },
    #[error("{}: section {name} is writable and executable; a program's code cannot change", .path.display())]
    WritableCode { path: PathBuf, name: String },
    #[error(
        "{}: section {name} is aligned to {found} bytes; allowed is up to {allowed}", .path.display()
    )]
    Alignment { path: PathBuf, name: String, found: u64, allowed: u64 },
    #[error("the linker put section {name} at {found:#x} instead of {expected:#x}")]
    Address { name: &'static str, found: u64, expected: u64 },
    #[error(
        "{}: {function} reads `{symbol}` plus an offset through a table of addresses, which linkers resolve to a wrong place; \
         compile with -fno-pic, or declare the variable with visibility(\"hidden\") as takt.h does",
        .path.display()
    )]
    Table { path: PathBuf, function: String, symbol: String },
    #[error(
        "{}: its assembler has noted that it uses {what}, which the PLC's kernel does not give to programs; the program would \
         fault. Compile without -march=native, -mavx and attributes for them",
        .path.display()
    )]
    Registers { path: PathBuf, what: &'static str },
    #[error("no program is declared: TAKT_PROGRAM(...) in C, takt_sdk::program!(...) in Rust")]
    NoProgram,
    #[error("{what} is declared twice")]
    Twice { what: &'static str },
    #[error("declaration {index} is broken: {why}")]
    Declaration { index: usize, why: String },
    #[error("{what} `{name}`: {why}")]
    Declared { what: &'static str, name: String, why: String },
    #[error("the program breaks a rule of images: {0}")]
    Image(#[from] ImageError),
}

impl LinkError {
    /// The same error, with the place that it is about.
    fn at(self, place: Option<&String>) -> Self {
        match place {
            None => self,
            Some(place) => Self::At { place: place.clone(), error: Box::new(self) },
        }
    }
}

/// Links these files and gives the image.
pub fn build(inputs: &[PathBuf]) -> Result<Vec<u8>, LinkError> {
    let linked = linker::link(inputs)?;
    let program = elf::read(&linked)?;
    let (mut builder, names) = declarations::builder(&program)?;
    let here = std::env::current_dir().unwrap_or_default();
    for line in lines::of(&program, &here) {
        builder.line(line);
    }
    builder.build().map_err(|error| names.error(error))
}

fn read(path: &Path) -> Result<Vec<u8>, LinkError> {
    std::fs::read(path).map_err(|source| LinkError::Read { path: path.to_owned(), source })
}
