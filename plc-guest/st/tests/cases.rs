//! Tables of accepted and refused sources: one small file each in `tests/cases/<topic>`, which says at
//! its end what the compiler tells about it:
//!
//! ```text
//! // error 3 unknown-name: there is no variable `levl`
//! ```
//!
//! In `foreign`, on what other languages and tools write, the hints are there as well: `//   hint: write ...`.
//! A file without such lines is accepted without a word. With `TAKT_ST_BLESS=1` the lines are written
//! anew; read the difference before you keep it.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use takt_st::project;
use takt_st::source::Sources;

/// What a hint begins with.
const HINT: &str = "//   hint: ";

fn files(folder: &Path, into: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).expect("the folder of cases is there");
    for entry in entries {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            files(&path, into);
        } else if path.extension().is_some_and(|extension| extension == "st") {
            into.push(path);
        }
    }
}

/// The source, and the lines at its end that say what is expected.
fn split(text: &str) -> (String, String) {
    let is_expected = |line: &&str| {
        ["// error ", "// warning ", HINT].iter().any(|begin| line.starts_with(begin))
    };
    let expected = text.lines().rev().take_while(is_expected).count();
    let lines: Vec<&str> = text.lines().collect();
    let (source, expected) = lines.split_at(lines.len() - expected);
    let join = |lines: &[&str]| lines.iter().fold(String::new(), |all, line| all + line + "\n");
    (join(source), join(expected))
}

fn told(source: &str, with_hints: bool) -> String {
    let mut sources = Sources::new();
    let file = sources.add("case.st", source.as_bytes()).expect("it is a source");
    let checked = project::check_tests("case", &mut sources).expect("there is a thread");
    let mut told = String::new();
    for one in &checked.diagnostics {
        let line = match one.span.file == file {
            true => sources.position(one.span).line.to_string(),
            false => {
                format!("in {}:{}", sources.get(one.span.file).name(), sources.position(one.span))
            }
        };
        writeln!(told, "// {} {line} {}: {}", one.code.severity(), one.code, one.found)
            .expect("a String takes everything");
        if let Some(hint) = one.hint.as_ref().filter(|_| with_hints) {
            writeln!(told, "{HINT}{hint}").expect("a String takes everything");
        }
    }
    told
}

#[test]
fn every_case_is_told_as_its_file_says() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases");
    let mut paths = Vec::new();
    files(&folder, &mut paths);
    paths.sort();
    assert!(!paths.is_empty(), "there are no cases");
    let bless = std::env::var_os("TAKT_ST_BLESS").is_some();
    let mut wrong = String::new();
    for path in paths {
        let text = std::fs::read_to_string(&path).expect("a case is text");
        let (source, expected) = split(&text);
        let told = told(&source, path.starts_with(folder.join("foreign")));
        if told == expected {
            continue;
        }
        if bless {
            std::fs::write(&path, source + &told).expect("the case can be written");
        }
        let shown = path.strip_prefix(&folder).unwrap_or(&path).display();
        writeln!(wrong, "{shown}:\nexpected\n{expected}told\n{told}").expect("it takes everything");
    }
    assert!(bless || wrong.is_empty(), "{wrong}");
}

#[test]
fn no_name_of_the_compilers_own_is_proposed() {
    let source =
        "FUNCTION_BLOCK Edge VAR_INPUT go : BOOL R_EDGE; END_VAR VAR_OUTPUT q : BOOL; END_VAR
q := go;
END_FUNCTION_BLOCK
TEST 'member' VAR edge : Edge; END_VAR
edge(go := TRUE);
ASSERT(edge.go_last);
END_TEST
";
    let mut sources = Sources::new();
    sources.add("case.st", source.as_bytes()).expect("it is a source");
    let checked = project::check_tests("case", &mut sources).expect("there is a thread");
    let told = checked.diagnostics.iter().find(|one| one.found == "Edge has no `go_last`");
    let told = told.expect("it is refused");
    assert_eq!((told.allowed.as_deref(), &told.hint), (Some("go, q"), &None));
}
