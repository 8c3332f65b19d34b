//! The code that a user has to trust: what runs on the host while guests do, counted in lines that are neither
//! blank, nor a comment, nor a test.

use std::fs;
use std::io;
use std::path::Path;

/// A folder or a file, and what it is.
type Part = (&'static str, &'static str);

/// Folders of code that runs on the host while guests do, and what each is.
const TRUSTED: [Part; 13] = [
    ("vmm/src", "the program `takt`"),
    ("vmm/plan/src", "the partition file"),
    ("vmm/host/src", "what the host tells"),
    ("vmm/record/src", "records of windows"),
    ("vmm/retain/src", "files of retained values"),
    ("vmm/figures/src", "report, statistics, trace"),
    ("vmm/protocol/src", "the control socket's messages"),
    ("scheduler/src", "the schedule"),
    ("devices/src", "devices for Linux"),
    ("devices/channel/src", "channels"),
    ("devices/abi/src", "what host and PLC guest share"),
    ("plc-guest/program/src", "images of control programs"),
    ("plc-guest/change/src", "changes of control programs"),
];

/// What of it is there for disks and networks, and what each is.
const INPUT_AND_OUTPUT: [Part; 7] = [
    ("devices/src/virtio", "registers of virtio devices, queues that the kernel serves"),
    ("devices/src/disk", "disk: queue, requests, transfers"),
    ("vmm/src/disk", "disk: file, thread"),
    ("devices/src/net", "network: what it offers"),
    ("vmm/src/net", "network: tap device, counts"),
    ("vmm/src/vhost", "vhost: network, and sockets to the host"),
    ("vmm/src/virtio.rs", "where virtio devices are in the machine"),
];

/// Files that only a build with the feature `test-hooks` has: nothing of them is in what users run.
const HOOKS: [&str; 2] = ["vmm/src/hooks/present.rs", "vmm/src/hooks/forbidden_call.rs"];

/// Lines of each of these folders: the folder, what it is, and the lines.
///
/// # Errors
///
/// If a folder or a file of it cannot be read.
pub fn by_folder(root: &Path) -> io::Result<Vec<(&'static str, &'static str, usize)>> {
    lines_of(root, &TRUSTED)
}

fn lines_of(root: &Path, of: &[Part]) -> io::Result<Vec<(&'static str, &'static str, usize)>> {
    of.iter().map(|&(path, what)| Ok((path, what, lines_below(&root.join(path))?))).collect()
}

/// The same as a table with the sum.
///
/// # Errors
///
/// Those of [`by_folder`].
pub fn table(root: &Path) -> io::Result<String> {
    Ok(table_of("folder", by_folder(root)?))
}

/// The part of it that disks and networks have.
///
/// # Errors
///
/// If a file of it cannot be read.
pub fn input_and_output(root: &Path) -> io::Result<String> {
    Ok(table_of("where", lines_of(root, &INPUT_AND_OUTPUT)?))
}

fn table_of(head: &str, parts: Vec<(&str, &str, usize)>) -> String {
    let mut text = format!("| {head} | what | lines |\n| --- | --- | --- |\n");
    let sum: usize = parts.iter().map(|(.., lines)| lines).sum();
    for (path, what, lines) in parts {
        text += &format!("| `{path}` | {what} | {lines} |\n");
    }
    text + &format!("| | together | {sum} |\n")
}

fn lines_below(folder: &Path) -> io::Result<usize> {
    if folder.is_file() {
        return Ok(code_lines(&fs::read_to_string(folder)?));
    }
    let mut sum = 0;
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or("");
        if path.is_dir() {
            sum += if name == "tests" { 0 } else { lines_below(&path)? };
        } else if HOOKS.iter().any(|hook| path.ends_with(hook)) {
            // Not built.
        } else if name.ends_with(".rs") && name != "tests.rs" && !name.ends_with("_tests.rs") {
            sum += code_lines(&fs::read_to_string(&path)?);
        }
    }
    Ok(sum)
}

/// Lines before the tests, which are last in a file, that are neither blank nor comment. Tests that have a file of their own
/// are declared anywhere, and code comes behind that.
fn code_lines(text: &str) -> usize {
    let text = text.replace("#[cfg(test)]\nmod tests;\n", "");
    let before = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or("");
    before.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//")).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_blank_lines_and_tests_are_no_code_to_trust() {
        let text =
            "//! a\n\nuse b; // c\n    // d\nfn e() {}\n\n#[cfg(test)]\nmod tests {\n  f\n}\n";
        assert_eq!(code_lines(text), 2);
        assert_eq!(code_lines("#[cfg(test)]\nmod tests;\n\nuse a;\n"), 1);
        assert_eq!(code_lines(""), 0);
    }
}
