//! Plain English: README, the pages of `docs/` and `--help` use the field's terms.
//!
//! The project once had a dialect of its own. `docs/glossary.md` has the terms that took its place. This
//! test keeps the old words out. Text in backticks and code blocks is not
//! looked at, since names of files, keys and threads are what they are.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// An old word, and what to write.
const OLD: [(&str, &str); 14] = [
    ("event thread", "supervisor thread"),
    ("main thread", "supervisor thread"),
    ("kicker", "window enforcer"),
    ("ordinary class", "SCHED_OTHER"),
    ("ordinary scheduling class", "SCHED_OTHER"),
    ("detour", "VM exit inside a window"),
    ("sign of life", "heartbeat"),
    ("signs of life", "heartbeats"),
    ("doors shut", "sandbox entered"),
    ("kernel hurries", "expedited RCU grace periods"),
    ("schedule holds", "the schedule is active"),
    ("whoever", "the one who does it, by name"),
    ("nobody", "a sentence with a subject"),
    ("means ill", "malicious process"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The text without code: blocks between fences, and what is in backticks.
fn prose(page: &str) -> String {
    let outside = page.split("\n```").step_by(2);
    let lines = outside.flat_map(|part| part.split('`').step_by(2));
    lines.collect::<Vec<_>>().join(" ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The old words of a text.
fn old_words(text: &str) -> Vec<String> {
    let text = text.to_lowercase();
    let found = OLD.iter().filter(|(old, _)| text.contains(old));
    found.map(|(old, new)| format!("\"{old}\": write {new}")).collect()
}

/// README, CONTRIBUTING and all pages but the decisions, which tell what was thought when.
fn pages() -> Vec<String> {
    let docs = fs::read_dir(root().join("docs")).unwrap();
    let docs = docs.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let docs = docs.filter(|name| name.ends_with(".md") && name != "glossary.md");
    let mut pages: Vec<String> = docs.map(|name| format!("docs/{name}")).collect();
    pages.extend(["README.md", "CONTRIBUTING.md"].map(str::to_owned));
    pages
}

#[test]
fn pages_are_in_plain_english() {
    let pages = pages();
    assert!(pages.len() > 20, "where are the pages?");
    for page in &pages {
        let text = fs::read_to_string(root().join(page)).unwrap();
        let found = old_words(&prose(&text));
        assert!(found.is_empty(), "{page}:\n{}", found.join("\n"));
    }
}

#[test]
fn help_is_in_plain_english() {
    let takt = Path::new(env!("CARGO_BIN_EXE_takt"));
    let help = |program: &Path, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).arg("--help").output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(text.contains("Usage:"), "{}: {text}", program.display());
        let found = old_words(&text);
        assert!(found.is_empty(), "{} {arguments:?}:\n{}", program.display(), found.join("\n"));
    };
    for command in [&[][..], &["run"], &["check"], &["probe"]] {
        help(takt, command);
    }
    // These are packages of their own, and there if all of the workspace is built.
    for client in ["takt-ctl", "takt-top", "takt-doctor", "takt-jitter"] {
        let program = takt.with_file_name(client);
        if program.exists() {
            help(&program, &[]);
        }
    }
}

#[test]
fn an_old_word_is_found_and_code_is_not_looked_at() {
    let page = "A kicker\nwakes.\n```\nmain thread\n```\nThe `kicker-0` and the event\nthread.";
    let found = old_words(&prose(page));
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("\"event thread\"") && found[1].starts_with("\"kicker\""));
}
