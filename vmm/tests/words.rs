//! Plain English: README, the pages of `docs/` and `--help` use the field's terms.
//!
//! The project once had a dialect of its own. `docs/glossary.md` has the terms that took its place. This
//! test keeps the old words out. Text in backticks and code blocks is not
//! looked at, since names of files, keys and threads are what they are.
//!
//! Some turns of phrase make the reader guess who does what. Those are kept out of the comments of the
//! sources too.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// An old word, and what to write.
const OLD: [(&str, &str); 12] = [
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
    ("means ill", "malicious process"),
];

/// A turn of phrase, and what to write.
const TURNS: [(&str, &str); 5] = [
    ("whoever", "the one who does it, by name"),
    ("nobody", "a sentence with a subject"),
    ("nothing but", "only"),
    ("none but", "only"),
    ("who insists", "the one who does it, by name"),
];

/// Folders of sources, below the root.
const SOURCES: [&str; 5] = ["devices", "plc-guest", "scheduler", "tests", "vmm"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The text without code: blocks between fences, and what is in backticks.
fn prose(page: &str) -> String {
    let outside = page.split("\n```").step_by(2);
    let lines = outside.flat_map(|part| part.split('`').step_by(2));
    lines.collect::<Vec<_>>().join(" ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The words of some lists that are in a text.
fn found(text: &str, lists: &[&[(&str, &str)]]) -> Vec<String> {
    let text = text.to_lowercase();
    let found = lists.iter().copied().flatten().filter(|(old, _)| text.contains(old));
    found.map(|(old, new)| format!("\"{old}\": write {new}")).collect()
}

/// The old words of a text.
fn old_words(text: &str) -> Vec<String> {
    found(text, &[&OLD, &TURNS])
}

/// The turns of phrase in a source's comments, each of which is some lines without code between them.
fn turns(source: &str) -> Vec<String> {
    let mut comments = vec![String::new()];
    for line in source.lines() {
        let comment = line.split_once("//").map(|(_, text)| text.trim_start_matches(['/', '!']));
        match (comment, comments.last_mut()) {
            (Some(text), Some(last)) => *last += &format!("{text}\n"),
            _ => comments.push(String::new()),
        }
    }
    comments.iter().flat_map(|comment| found(&prose(comment), &[&TURNS])).collect()
}

/// The sources below a folder. Results of builds are none.
fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, into);
        } else if path.extension().is_some_and(|end| end == "rs") {
            into.push(path);
        }
    }
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
fn comments_are_in_plain_english() {
    let mut all = Vec::new();
    SOURCES.iter().for_each(|folder| sources(&root().join(folder), &mut all));
    assert!(all.len() > 500, "where are the sources?");
    // This file has the words.
    all.retain(|path| !path.ends_with("vmm/tests/words.rs"));
    for path in all {
        let found = turns(&fs::read_to_string(&path).unwrap());
        assert!(found.is_empty(), "{}:\n{}", path.display(), found.join("\n"));
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
    let clients = ["ctl", "top", "console", "doctor", "jitter", "shell", "copy"];
    for client in clients {
        let program = takt.with_file_name(format!("takt-{client}"));
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

#[test]
fn a_turn_of_phrase_is_found_in_a_comment_only() {
    let source = "// It is nothing\n// but a word.\nlet nobody = 1; // Whoever\n/// `nobody`\nfn nobody() {}";
    let found = turns(source);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found[0].starts_with("\"whoever\"") && found[1].starts_with("\"nothing but\""));
}
