//! The formatter over whole files.
//!
//! Each `tests/format/NAME.st` has a source and, behind the line `// formatted`, what becomes of it. With
//! `TAKT_ST_BLESS=1` that part is written anew; read the difference before you keep it. For all other
//! sources of this crate it is tested that a result has the same words and that nothing is left to format.

use std::path::{Path, PathBuf};

use takt_st::diagnostic::Diagnostics;
use takt_st::format::{FormatError, format};
use takt_st::source::Sources;
use takt_st::syntax::lexer::Lexer;
use takt_st::syntax::token::TokenKind;

const DIVIDER: &str = "// formatted\n";

fn collect(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("the folder is there") {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            collect(&path, into);
        } else if path.extension().is_some_and(|extension| extension == "st") {
            into.push(path);
        }
    }
}

fn sources_in(folder: &str) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    collect(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder), &mut paths);
    paths.sort();
    assert!(!paths.is_empty(), "{folder} has no sources");
    paths
}

fn formatted(text: &str) -> Result<String, FormatError> {
    let mut sources = Sources::new();
    let file = sources.add("a.st", text.as_bytes()).expect("it is a source");
    format(&sources, file)
}

/// All tokens and comments of a source without white space, keywords by their kind.
fn words(text: &str) -> Vec<(TokenKind, String)> {
    let mut sources = Sources::new();
    let file = sources.add("a.st", text.as_bytes()).expect("it is a source");
    let mut lexer = Lexer::new(file, sources.get(file));
    let mut diagnostics = Diagnostics::new();
    let mut words = Vec::new();
    loop {
        let token = lexer.next_token(&mut diagnostics);
        let text = match token.kind {
            TokenKind::End => return words,
            TokenKind::Keyword(_) => String::new(),
            TokenKind::Comment => sources.text(token.span).split_whitespace().collect(),
            _ => sources.text(token.span).to_owned(),
        };
        words.push((token.kind, text));
    }
}

/// Formats what parses; gives whether it does.
#[track_caller]
fn keeps_its_words(text: &str, what: &str) -> bool {
    let once = match formatted(text) {
        Ok(once) => once,
        Err(FormatError::Syntax(_)) => return false,
        Err(error) => panic!("{what}: {error}\n{text}"),
    };
    assert_eq!(words(&once), words(text), "{what}");
    let twice = formatted(&once).expect("what was formatted parses");
    assert_eq!(twice, once, "{what}: formatted again, it changes");
    true
}

#[test]
fn sources_are_formatted_as_their_files_say() {
    let bless = std::env::var_os("TAKT_ST_BLESS").is_some();
    for path in sources_in("tests/format") {
        let text = std::fs::read_to_string(&path).expect("it is text");
        let (source, expected) = text.split_once(DIVIDER).expect("it has two parts");
        let found = formatted(source).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        if bless {
            let text = format!("{source}{DIVIDER}{found}");
            std::fs::write(&path, text).expect("it can be written");
        } else {
            assert_eq!(found, expected, "{}", path.display());
        }
        assert!(keeps_its_words(source, &path.display().to_string()));
    }
}

#[test]
fn the_library_and_all_cases_keep_their_words() {
    let mut cases = 0;
    for folder in ["library", "tests/programs", "tests/cases"] {
        for path in sources_in(folder) {
            let text = std::fs::read_to_string(&path).expect("it is text");
            let parses = keeps_its_words(&text, &path.display().to_string());
            assert!(parses || folder == "tests/cases", "{} does not parse", path.display());
            cases += usize::from(parses);
            if folder == "library" {
                let formatted = formatted(&text).expect("it parses");
                assert_eq!(formatted, text, "{} is not formatted", path.display());
            }
        }
    }
    assert!(cases > 60, "only {cases} of the sources parse");
}

/// Breaks and comments at places where people do not put them.
#[test]
fn white_space_and_comments_may_stand_anywhere() {
    for path in sources_in("tests/cases") {
        let text = std::fs::read_to_string(&path).expect("it is text");
        let words = words(&text);
        let only_code = words.iter().filter(|(kind, _)| *kind != TokenKind::Comment);
        let texts: Vec<&str> = only_code
            .map(|(kind, text)| match kind {
                TokenKind::Keyword(keyword) => keyword.text(),
                _ => text,
            })
            .collect();
        for between in [" ", "\n", "\n\n\n", " (* c *) ", "\n\t// c\n", "\n(* c\n  d *)", "{p}"] {
            keeps_its_words(&texts.join(between), &format!("{} {between:?}", path.display()));
        }
    }
}
