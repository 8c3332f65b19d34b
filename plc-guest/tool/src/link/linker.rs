//! Runs the system's linker.

use std::path::{Path, PathBuf};
use std::process::Command;

use object::read::archive::ArchiveFile;
use object::{Object, ObjectSection};

use super::objects::{Weak, check};
use super::registers::{self, Members};
use super::{LinkError, read, undefined};

const SCRIPT: &str = include_str!("program.ld");

/// Functions of `math.h` that no compiler makes an instruction of.
const MATH: &[u8] = include_bytes!(env!("TAKT_MATH"));

const FLAGS: &[&str] = &[
    "-static",
    "--entry=0",
    "-nostdlib",
    "--gc-sections",
    "--build-id=none",
    "-z",
    "noexecstack",
    "-z",
    "norelro",
    "-z",
    "max-page-size=4096",
];

/// Links the files and gives the linked ELF file.
pub fn link(inputs: &[PathBuf]) -> Result<Vec<u8>, LinkError> {
    let folder = tempfile::tempdir().map_err(LinkError::Temporary)?;
    let (script, output) = (folder.path().join("program.ld"), folder.path().join("program.elf"));
    std::fs::write(&script, SCRIPT).map_err(LinkError::Temporary)?;
    let linker = find()?;
    let mut command = Command::new(&linker);
    if linker.ends_with("rust-lld") {
        command.args(["-flavor", "gnu"]);
    }
    command.args(FLAGS).arg("-T").arg(&script).arg("-o").arg(&output);
    // A library's members are linked only if something refers to them. Nothing refers to a declaration.
    let (mut weak, mut members) = (Weak::default(), Members::default());
    for input in inputs {
        for member in declaring_members(input, folder.path(), (&mut weak, &mut members))? {
            command.arg(member);
        }
    }
    let inputs = inputs.iter().map(|input| as_file(input));
    command.env("LC_ALL", "C").arg("--start-group").args(inputs).arg("--end-group");
    let mut said = run(&mut command)?;
    // Of what the files define, too, theirs is taken. They may not define it twice themselves.
    let twice =
        |said: &str| said.contains("multiple definition") || said.contains("duplicate symbol");
    if said.as_ref().is_some_and(|said| undefined::of_math(said) && !twice(said)) {
        let object = folder.path().join("math.o");
        std::fs::write(&object, MATH).map_err(LinkError::Temporary)?;
        said = run(command.arg("--allow-multiple-definition").arg(&object))?;
    }
    match said {
        None => {
            let linked = read(&output)?;
            weak.check(&linked)?;
            members.check(&linked)?;
            Ok(linked)
        }
        Some(text) => {
            Err(undefined::error(&text).unwrap_or(LinkError::Linker { linker, output: text }))
        }
    }
}

/// Runs the linker, and gives what it says if it fails.
fn run(command: &mut Command) -> Result<Option<String>, LinkError> {
    let linker = PathBuf::from(command.get_program());
    let result = command.output().map_err(|source| LinkError::Run { linker, source })?;
    let text = || String::from_utf8_lossy(&result.stderr).into_owned();
    Ok((!result.status.success()).then(text))
}

/// A path that a linker takes for a file: not for an option (`-x.o`), and not for a file with options (`@x.o`).
fn as_file(input: &Path) -> PathBuf {
    match input.as_os_str().as_encoded_bytes().first() {
        Some(b'-' | b'@') => Path::new(".").join(input),
        _ => input.to_owned(),
    }
}

/// The linker: GNU's, LLVM's, or the one that comes with Rust.
fn find() -> Result<PathBuf, LinkError> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    for name in ["ld", "ld.lld"] {
        if let Some(found) =
            std::env::split_paths(&path).map(|dir| dir.join(name)).find(|file| file.is_file())
        {
            return Ok(found);
        }
    }
    let sysroot = Command::new("rustc").args(["--print", "sysroot"]).output().ok();
    let sysroot =
        sysroot.and_then(|output| String::from_utf8(output.stdout).ok()).unwrap_or_default();
    let lld = Path::new(sysroot.trim()).join("lib/rustlib/x86_64-unknown-linux-gnu/bin/rust-lld");
    if lld.is_file() { Ok(lld) } else { Err(LinkError::NoLinker) }
}

/// Checks a file, and gives the members of a library that have declarations, as files of their own. An object file
/// has none: it is linked anyway.
fn declaring_members(
    input: &Path,
    folder: &Path,
    (weak, with_registers): (&mut Weak, &mut Members),
) -> Result<Vec<PathBuf>, LinkError> {
    let bytes = read(input)?;
    let broken = |source| LinkError::Object { path: input.to_owned(), source };
    if bytes.starts_with(b"!<thin>\n") {
        return Err(LinkError::Thin { path: input.to_owned() });
    }
    if !bytes.starts_with(b"!<arch>\n") {
        let file = object::File::parse(&*bytes).map_err(broken)?;
        check(input, &file)?;
        registers::check(input, &file)?;
        weak.add(&file, false);
        return Ok(Vec::new());
    }
    let mut members = Vec::new();
    for member in ArchiveFile::parse(&*bytes).map_err(broken)?.members() {
        let data = member.and_then(|member| member.data(&*bytes)).map_err(broken)?;
        let Ok(file) = object::File::parse(data) else { continue };
        check(input, &file)?;
        weak.add(&file, true);
        with_registers.add(input, &file)?;
        if file.sections().any(|section| section.name() == Ok(takt_sdk::declaration::SECTION)) {
            // Not by the input's name: two libraries may have the same.
            let number = std::fs::read_dir(folder).map_or(0, Iterator::count);
            let path = folder.join(format!("member-{number}.o"));
            std::fs::write(&path, data).map_err(LinkError::Temporary)?;
            members.push(path);
        }
    }
    Ok(members)
}
