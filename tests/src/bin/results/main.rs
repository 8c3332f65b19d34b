//! Puts what `scripts/results` has measured into `docs/results.md`, and draws it.
//!
//!     results FOLDER ROOT
//!
//! FOLDER has what the steps have left, ROOT is the project. The page's words are its author's; only
//! what lies between a pair of marks, `<!-- NAME -->` and `<!-- /NAME -->`, is replaced, so that no
//! figure in a table is ever typed. A step that has left nothing leaves its table as it is.

#![forbid(unsafe_code)]

mod footprint;
mod frame;
mod paid;
mod plcs;
mod ranges;
mod scaling;
mod traffic;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use std::process::ExitCode;
use takt_tests::trusted_lines;

use takt_tests::Value;

/// What the steps have left.
struct Measured {
    folder: PathBuf,
}

impl Measured {
    /// A file's text.
    fn text(&self, name: &str) -> Option<String> {
        fs::read_to_string(self.folder.join(name)).ok()
    }

    /// A report.
    fn json(&self, name: &str) -> Option<Value> {
        serde_json::from_str(&self.text(name)?).ok()
    }

    /// The first of the numbers that a line of the program `pay` gives to this name.
    fn paid(&self, file: &str, name: &str) -> Option<u64> {
        let text = self.text(file)?;
        text.lines().find_map(|line| {
            // A console may have other things before it in the line.
            let (_, line) = line.split_once("pay: ")?;
            let mut words = line.split_whitespace();
            (words.next() == Some(name)).then(|| words.next()?.parse().ok()).flatten()
        })
    }
}

/// The entry of a partition in a report.
fn partition<'a>(report: &'a Value, name: &str) -> Option<&'a Value> {
    report["partitions"].as_array()?.iter().find(|partition| partition["name"] == name)
}

/// A number of a report, in us with three digits.
fn us(value: &Value) -> Option<String> {
    value.as_u64().map(|ns| format!("{}.{:03}", ns / 1000, ns % 1000))
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, root] = arguments.as_slice() else {
        eprintln!("usage: results FOLDER ROOT");
        return ExitCode::from(64);
    };
    let measured = Measured { folder: folder.into() };
    match write(&measured, Path::new(root)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("results: {error}");
            ExitCode::FAILURE
        }
    }
}

fn write(measured: &Measured, root: &Path) -> io::Result<()> {
    let page = root.join("docs/results.md");
    let mut text = fs::read_to_string(&page)?;
    let tables = [
        ("plcs", plcs::table(measured).map(|t| t + "\n![Release latencies](plots/plcs.svg)\n")),
        ("calls", paid::calls(measured)),
        ("start", paid::start(measured)),
        ("compile", paid::compile(measured)),
        ("beyond", paid::beyond(measured)),
        ("footprint", footprint::table(measured)),
        ("io", traffic::table(measured)),
        ("io-counts", traffic::counts(measured)),
        ("io-lines", Some(trusted_lines::input_and_output(root)?)),
        ("lines", Some(trusted_lines::table(root)?)),
        (
            "scaling",
            scaling::table(measured)
                .map(|t| t + "\n![Release latency by number of PLCs](plots/scaling.svg)\n"),
        ),
    ];
    for (name, table) in tables {
        match table {
            Some(table) => text = replaced(&text, name, &table)?,
            None => eprintln!("results: not measured, left as it is: {name}"),
        }
    }
    fs::write(&page, text)?;
    if let Some(table) = frame::table(measured) {
        let page = root.join("docs/frame.md");
        let text = replaced(&fs::read_to_string(&page)?, "frame", &table)?;
        fs::write(&page, text)?;
    }
    fs::create_dir_all(root.join("docs/plots"))?;
    let plots = [
        ("plcs", plcs::plot(measured)),
        ("scaling", scaling::plot(measured)),
        ("frame", frame::plot(measured)),
    ];
    for (name, plot) in plots {
        if let Some(plot) = plot {
            fs::write(root.join(format!("docs/plots/{name}.svg")), plot)?;
        }
    }
    Ok(())
}

/// `text` with something else between the marks of this name.
fn replaced(text: &str, name: &str, table: &str) -> io::Result<String> {
    let missing = || io::Error::other(format!("the page has no marks for {name}"));
    let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- /{name} -->"));
    let (before, rest) = text.split_once(&begin).ok_or_else(missing)?;
    let (_, after) = rest.split_once(&end).ok_or_else(missing)?;
    Ok(format!("{before}{begin}\n{}\n\n{end}{after}", table.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_lies_between_the_marks_is_replaced() {
        let page = "a\n<!-- x -->\nold\n<!-- /x -->\nb\n";
        let new = replaced(page, "x", "new\n").unwrap();
        assert_eq!(new, "a\n<!-- x -->\n\nnew\n\n<!-- /x -->\nb\n");
        assert_eq!(replaced(&new, "x", "new\n").unwrap(), new);
        assert!(replaced(page, "y", "").is_err());
    }

    #[test]
    fn a_line_behind_something_else_on_the_console_counts() {
        let folder = std::env::temp_dir().join(format!("takt-results-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("log"), "x\r\nlinux# pay: fork+exit 12 13\r\npay: fork 1 2\n")
            .unwrap();
        let measured = Measured { folder: folder.clone() };
        assert_eq!(measured.paid("log", "fork+exit"), Some(12));
        assert_eq!(measured.paid("log", "fork"), Some(1));
        assert_eq!(measured.paid("log", "exit"), None);
        fs::remove_dir_all(folder).unwrap();
    }
}
