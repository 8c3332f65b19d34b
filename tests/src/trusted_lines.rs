//! The code that a user has to trust: what runs on the host while guests do, counted in lines that are neither
//! blank, nor a comment, nor a test.

use std::fs;
use std::io;
use std::path::Path;

/// Folders of code that runs on the host while guests do, and what each is.
const TRUSTED: [(&str, &str); 13] = [
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

/// Files that only a build with the feature `test-hooks` has: nothing of them is in what users run.
const HOOKS: [&str; 2] = ["vmm/src/hooks/present.rs", "vmm/src/hooks/forbidden_call.rs"];

/// Lines of each of these folders: the folder, what it is, and the lines.
///
/// # Errors
///
/// If a folder or a file of it cannot be read.
pub fn by_folder(root: &Path) -> io::Result<Vec<(&'static str, &'static str, usize)>> {
    let of = |(folder, what)| Ok((folder, what, lines_below(&root.join(folder))?));
    TRUSTED.into_iter().map(of).collect()
}

/// The same as a table with the sum.
///
/// # Errors
///
/// Those of [`by_folder`].
pub fn table(root: &Path) -> io::Result<String> {
    let mut text = "| folder | what | lines |\n| --- | --- | --- |\n".to_owned();
    let mut sum = 0;
    for (folder, what, lines) in by_folder(root)? {
        sum += lines;
        text += &format!("| `{folder}` | {what} | {lines} |\n");
    }
    Ok(text + &format!("| | together | {sum} |\n"))
}

fn lines_below(folder: &Path) -> io::Result<usize> {
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

/// Lines before the tests, which are last in a file, that are neither blank nor comment.
fn code_lines(text: &str) -> usize {
    let before = text.split("#[cfg(test)]\nmod tests").next().unwrap_or("");
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
        assert_eq!(code_lines(""), 0);
    }
}
