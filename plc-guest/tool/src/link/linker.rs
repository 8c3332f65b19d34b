//! Runs the system's linker.

use std::path::{Path, PathBuf};
use std::process::Command;

use object::read::archive::ArchiveFile;
use object::{Object, ObjectSection};

use super::objects::check;
use super::{LinkError, read};

const SCRIPT: &str = include_str!("program.ld");

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
    for input in inputs {
        for member in declaring_members(input, folder.path())? {
            command.arg(member);
        }
    }
    command.arg("--start-group").args(inputs).arg("--end-group");
    let run = |source| LinkError::Run { linker: linker.clone(), source };
    let result = command.env("LC_ALL", "C").output().map_err(run)?;
    if result.status.success() {
        return read(&output);
    }
    let text = String::from_utf8_lossy(&result.stderr).into_owned();
    let symbols = undefined(&text);
    if symbols.is_empty() {
        return Err(LinkError::Linker { linker, output: text });
    }
    let hint = hint(&symbols);
    Err(LinkError::Unresolved { symbols, hint })
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
fn declaring_members(input: &Path, folder: &Path) -> Result<Vec<PathBuf>, LinkError> {
    let bytes = read(input)?;
    let broken = |source| LinkError::Object { path: input.to_owned(), source };
    if !bytes.starts_with(b"!<arch>\n") {
        check(input, &object::File::parse(&*bytes).map_err(broken)?)?;
        return Ok(Vec::new());
    }
    let mut members = Vec::new();
    for member in ArchiveFile::parse(&*bytes).map_err(broken)?.members() {
        let data = member.and_then(|member| member.data(&*bytes)).map_err(broken)?;
        let Ok(file) = object::File::parse(data) else { continue };
        check(input, &file)?;
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

/// The symbols that the linker did not find, from what GNU's and LLVM's linkers say.
fn undefined(output: &str) -> Vec<String> {
    let one = |line: &str| {
        let (_, rest) = line
            .split_once("undefined reference to `")
            .or_else(|| line.split_once("undefined symbol: "))?;
        Some(rest.trim_end_matches('\'').to_owned())
    };
    let mut symbols: Vec<_> = output.lines().filter_map(one).collect();
    symbols.sort();
    symbols.dedup();
    symbols
}

fn hint(symbols: &[String]) -> &'static str {
    let any = |names: &[&str]| symbols.iter().any(|symbol| names.contains(&symbol.as_str()));
    if any(&["memcpy", "memmove", "memset", "memcmp"]) {
        ". The memory functions are in takt.c of the SDK: compile and link it too"
    } else if any(&["__stack_chk_fail"]) {
        ". Compile with -fno-stack-protector"
    } else if any(&["malloc", "free", "printf", "puts", "exit", "abort", "strlen", "fopen"]) {
        ". A control program has no C library: compile with -ffreestanding and bring what it needs"
    } else if any(&[
        "sin", "cos", "tan", "exp", "log", "pow", "sqrt", "fmod", "floor", "sinf", "sqrtf",
    ]) {
        ". There is no mathematical library: link object files that have these functions"
    } else {
        ""
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undefined_symbols_are_found_in_what_both_linkers_say() {
        let gnu = "ld: a.o: in function `f':\na.c:(.text+0x5): undefined reference to `sin'\n\
                   ld: b.c:3: undefined reference to `sin'\n";
        assert_eq!(undefined(gnu), ["sin"]);
        assert_eq!(
            undefined("ld.lld: error: undefined symbol: cos\n>>> referenced by a.c\n"),
            ["cos"]
        );
        assert!(undefined("ld: cannot open a.o").is_empty());
    }
}
