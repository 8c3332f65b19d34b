//! What an editor asks: which declaration a name stands for, what can be typed, what a name can become.
//!
//! In the sources below `|` is the place that is asked about.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use takt_st::check::known;
use takt_st::diagnostic::Diagnostics;
use takt_st::project;
use takt_st::query::{Index, SymbolKind, comment, complete, describe, rename};
use takt_st::source::{FileId, Sources, Span};
use takt_st::syntax::lexer::Lexer;
use takt_st::syntax::token::{Sign, TokenKind};

struct Asked {
    sources: Sources,
    own: usize,
    index: Index,
    file: FileId,
    offset: u32,
}

/// A project of these files, one of which has a place.
fn ask(files: &[&str]) -> Asked {
    let mut sources = Sources::new();
    let mut place = None;
    for (number, text) in files.iter().enumerate() {
        let offset = text.find('|');
        let name = format!("f{number}.st");
        let id = sources.add(&name, text.replace('|', "").as_bytes()).expect("it is a source");
        place = place.or(offset.map(|offset| (id, offset as u32)));
    }
    let own = files.len();
    project::check_all("query", &mut sources).expect("there is a thread");
    let index = Index::new(&sources, own).expect("there is a thread");
    let (file, offset) = place.expect("one file has a place");
    Asked { sources, own, index, file, offset }
}

impl Asked {
    fn declaration(&self) -> String {
        let Some(one) = self.index.at(self.file, self.offset) else { return "nothing".into() };
        let span = self.index.symbol(one.symbol).span;
        format!("{}:{}", self.sources.get(span.file).name(), self.sources.position(span))
    }

    fn hover(&self) -> String {
        let one = self.index.at(self.file, self.offset).expect("there is a name");
        let text = describe::declaration(&self.sources, &self.index, one.symbol);
        let about = comment::of(&self.sources, self.index.symbol(one.symbol));
        about.map_or(text.clone(), |about| format!("{text}\n{about}"))
    }

    fn offered(&self, origin: complete::Origin) -> Vec<String> {
        let (all, _) = complete::at(&self.sources, &self.index, self.file, self.offset);
        all.into_iter().filter(|one| one.origin == origin).map(|one| one.label).collect()
    }

    /// The files with the new name, or why not.
    fn renamed(&self, new: &str) -> Result<Vec<String>, String> {
        let place = (self.file, self.offset);
        let places = rename::rename(&self.sources, self.own, &self.index, place, new)
            .map_err(|error| error.to_string())?;
        let texts = self.sources.iter().take(self.own).map(|(file, source)| {
            let mut text = source.text().to_owned();
            for span in places.iter().rev().filter(|span| span.file == file) {
                text.replace_range(span.start as usize..span.end as usize, new);
            }
            text
        });
        Ok(texts.collect())
    }
}

fn cases(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("the folder is there") {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            cases(&path, into);
        } else {
            into.push(path);
        }
    }
}

/// Names without a declaration: types and functions of the standard, words of tasks and resources.
fn is_standard(key: &str) -> bool {
    let words = [
        "EN", "ENO", "INTERVAL", "SINGLE", "CHANNEL", "PRIORITY", "OFFSET", "BUDGET", "DEADLINE",
        "ON",
    ];
    known::is_type(key) || known::function(key).is_some() || words.contains(&key)
}

/// The formal names of functions that the compiler makes itself.
fn is_formal(key: &str) -> bool {
    ["G", "N", "K", "L", "P", "X", "Y", "MN", "MX", "PORT", "MESSAGE", "LENGTH"].contains(&key)
        || key.starts_with("IN")
}

/// The names of a file that are not found in the index.
fn lost(sources: &Sources, index: &Index, file: FileId) -> String {
    let mut lexer = Lexer::new(file, sources.get(file));
    let mut unseen = Diagnostics::new();
    let mut tokens = vec![];
    while let token = lexer.next_word(&mut unseen)
        && token.kind != TokenKind::End
    {
        tokens.push(token);
    }
    let key = |span: Span| sources.text(span).to_ascii_uppercase();
    let mut lost = String::new();
    for (at, token) in tokens.iter().enumerate() {
        let found = index.at(file, token.span.start).is_some_and(|one| one.span == token.span);
        let formal =
            tokens.get(at + 1).is_some_and(|next| next.kind == TokenKind::Sign(Sign::Assign))
                && is_formal(&key(token.span));
        let processor = at > 0 && key(tokens[at - 1].span) == "ON";
        let name = token.kind == TokenKind::Identifier;
        if name && !(found || is_standard(&key(token.span)) || formal || processor) {
            let place = sources.position(token.span);
            writeln!(lost, "{}:{place}: {}", sources.get(file).name(), sources.text(token.span))
                .expect("a String takes everything");
        }
    }
    lost
}

#[test]
fn each_name_of_a_program_that_the_checker_accepts_is_found() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let mut paths = Vec::new();
    cases(&folder.join("cases"), &mut paths);
    cases(&folder.join("programs"), &mut paths);
    let (mut accepted, mut wrong) = (0, String::new());
    for path in paths {
        let mut sources = Sources::new();
        let text = std::fs::read(&path).expect("a case can be read");
        let name = path.display().to_string();
        let Ok(file) = sources.add(&name, &text) else { continue };
        let checked = project::check_all("query", &mut sources).expect("there is a thread");
        if checked.program.is_none() {
            continue;
        }
        let index = Index::new(&sources, 1).expect("there is a thread");
        let files = if accepted == 0 { sources.iter().count() } else { 1 };
        accepted += 1;
        // With the first, the library too.
        for (file, _) in sources.iter().take(files) {
            wrong += &lost(&sources, &index, file);
        }
        let doubted = index.uses().iter().find(|one| !one.certain);
        assert!(doubted.is_none(), "{name}: {}", sources.position(doubted.expect("one").span));
        let unknown = index.unknown().iter().find(|span| span.file == file);
        let shown = unknown.map(|span| sources.text(*span));
        assert_eq!(shown, None, "{name}");
    }
    assert!(accepted > 30, "only {accepted} cases are accepted");
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn a_name_stands_for_its_declaration_in_another_file() {
    let types = "TYPE Tank : STRUCT level : REAL; END_STRUCT; END_TYPE";
    let use_it = |body: &str| {
        format!(
            "PROGRAM Main VAR tanks : ARRAY[1..2, 0..3] OF Tank; r : REF_TO Tank; END_VAR\n{body}\nEND_PROGRAM"
        )
    };
    for body in [
        "tanks[1, 0].le|vel := 1.0;",
        "tanks[1][2].level| := 1.0;",
        "r^.|level := 1.0;",
        // What follows is not complete.
        "tanks[1, 2].|level := 1.0; IF",
    ] {
        assert_eq!(ask(&[types, &use_it(body)]).declaration(), "f0.st:1:20", "{body}");
    }
    assert_eq!(ask(&[types, &use_it("tanks[1, 0].levl| := 1.0;")]).declaration(), "nothing");
}

#[test]
fn the_nearest_declaration_counts() {
    let global = "VAR_GLOBAL x : INT; END_VAR";
    let own = "PROGRAM Main VAR x : INT; END_VAR |x := 1; END_PROGRAM";
    let outer = "PROGRAM Main VAR y : INT; END_VAR |x := y; END_PROGRAM";
    let external = "PROGRAM Main VAR_EXTERNAL |x : INT; END_VAR x := 1; END_PROGRAM";
    assert_eq!(ask(&[global, own]).declaration(), "f1.st:1:18");
    assert_eq!(ask(&[global, outer]).declaration(), "f0.st:1:12");
    assert_eq!(ask(&[global, external]).declaration(), "f0.st:1:12");
}

#[test]
fn a_value_of_two_enumerations_is_found_by_what_it_is_compared_with() {
    let types = "TYPE A : (Off, Run); B : (Off, Go); END_TYPE";
    let body = |text: &str| format!("PROGRAM Main VAR a : A; b : B; END_VAR {text} END_PROGRAM");
    for (text, expected) in [
        ("b := |Off;", "f0.st:1:27"),
        ("a := |Off;", "f0.st:1:11"),
        ("IF |Off = b THEN END_IF", "f0.st:1:27"),
        ("IF b <> (|Off) THEN END_IF", "f0.st:1:27"),
        ("CASE b OF |Off: END_CASE", "f0.st:1:27"),
        ("a := B#|Off;", "f0.st:1:27"),
    ] {
        assert_eq!(ask(&[types, &body(text)]).declaration(), expected, "{text}");
    }
}

#[test]
fn a_declaration_is_shown_with_its_comments() {
    let text = "VAR_GLOBAL CONSTANT\n  (* other *)\n\n  // How high\n  (* the tank is. *)\n  \
                height : REAL := 2.5; // In metres.\n  next : INT := 1;\nEND_VAR\n\
                PROGRAM Main VAR x : REAL; END_VAR x := |height; END_PROGRAM";
    assert_eq!(
        ask(&[text]).hover(),
        "VAR_GLOBAL CONSTANT height : REAL := 2.5\nHow high\nthe tank is.\nIn metres."
    );
    let next = text.replace('|', "").replace("next", "|next");
    assert_eq!(ask(&[&next]).hover(), "VAR_GLOBAL CONSTANT next : INT := 1");
    let block = "PROGRAM Main VAR t : |SR; END_VAR t(S1 := TRUE, R := FALSE); END_PROGRAM";
    let shown = ask(&[block]).hover();
    assert!(shown.starts_with("FUNCTION_BLOCK SR\n    VAR_INPUT S1 : BOOL"), "{shown}");
}

#[test]
fn behind_a_dot_the_members_are_offered_that_can_be_used() {
    let block = "FUNCTION_BLOCK Pump VAR_INPUT on : BOOL; END_VAR VAR_OUTPUT flow : REAL; END_VAR \
                 VAR hours : REAL; END_VAR END_FUNCTION_BLOCK TYPE Pair : STRUCT p : Pump; END_STRUCT; END_TYPE";
    let body = |text: &str| {
        format!(
            "PROGRAM Main VAR q : ARRAY[1..2] OF Pump; pair : REF_TO Pair; i : INT; END_VAR {text} END_PROGRAM"
        )
    };
    for text in
        ["q[i + q[1].|", "q[MAX(i, 1)].|\n i := 1;", "pair^.p.|x := 3;", "i := 1; q[1].| END_IF"]
    {
        let offered = ask(&[block, &body(text)]).offered(complete::Origin::Place);
        assert_eq!(offered, ["flow", "on"], "{text}");
    }
    let offered = ask(&[block, &body("q[1].f|")]).offered(complete::Origin::Place);
    assert_eq!(offered, ["flow"]);
    assert_eq!(ask(&[block, &body("i.|")]).offered(complete::Origin::Place).len(), 0);
}

#[test]
fn a_test_sees_the_variables_of_instances() {
    let block = "FUNCTION_BLOCK Pump VAR_INPUT on : BOOL; END_VAR VAR hours : REAL; END_VAR END_FUNCTION_BLOCK";
    let test = "TEST 'hours' VAR pump : Pump; END_VAR ASSERT(pump.|hours = 0.0); END_TEST";
    let asked = ask(&[block, test]);
    assert_eq!(asked.offered(complete::Origin::Place), ["hours", "on"]);
    assert_eq!(asked.declaration(), "f0.st:1:54");
    assert!(asked.index.unknown().is_empty());
    let asked = ask(&[block, &test.replace('|', "").replace("ASSERT", "ASS|ERT")]);
    assert!(asked.offered(complete::Origin::Library).contains(&"ASSERT".to_owned()));
    // Its name is no name.
    let asked = ask(&[block, &test.replace('|', "").replace("'hours'", "'ho|urs'")]);
    assert_eq!(asked.declaration(), "nothing");
}

#[test]
fn where_a_value_stands_what_is_visible_is_offered() {
    let other = "TYPE Mode : (Idle, Running); END_TYPE VAR_GLOBAL level : REAL; END_VAR \
                 FUNCTION Twice : INT VAR_INPUT x : INT; END_VAR Twice := x; END_FUNCTION";
    let text = "PROGRAM Main VAR m : Mode; lamp : BOOL; END_VAR lamp := |; END_PROGRAM";
    let asked = ask(&[other, text]);
    assert_eq!(asked.offered(complete::Origin::Unit), ["lamp", "m"]);
    assert_eq!(
        asked.offered(complete::Origin::Project),
        ["Idle", "Mode", "Running", "Twice", "level"]
    );
    assert!(asked.offered(complete::Origin::Library).contains(&"LIMIT".to_owned()));
    assert!(asked.offered(complete::Origin::Language).contains(&"TRUE".to_owned()));
    let call = "PROGRAM Main VAR t : CTU; END_VAR t(CU := TRUE, |); END_PROGRAM";
    let offered = ask(&[call]).offered(complete::Origin::Place);
    assert!(
        offered.contains(&"Q =>".to_owned()) && offered.contains(&"PV :=".to_owned()),
        "{offered:?}"
    );
    let value = "PROGRAM Main VAR m : Mode; END_VAR m := Mode#| END_PROGRAM";
    assert_eq!(ask(&[other, value]).offered(complete::Origin::Place), ["Idle", "Running"]);
    let ty = "PROGRAM Main VAR m : Mo| END_VAR END_PROGRAM";
    assert_eq!(ask(&[other, ty]).offered(complete::Origin::Project), ["Mode"]);
}

#[test]
fn nothing_is_offered_within_comments_strings_and_numbers() {
    for text in ["(* le| *)", "// le|", "s := 'le|';", "x := 12|;", "x := %IX0.|;"] {
        let text = format!("PROGRAM Main VAR level : INT; END_VAR {text}\nEND_PROGRAM");
        let asked = ask(&[&text]);
        let (all, _) = complete::at(&asked.sources, &asked.index, asked.file, asked.offset);
        assert!(all.is_empty(), "{text}: {all:?}");
    }
}

#[test]
fn a_declaration_is_renamed_in_all_files() {
    let global = "VAR_GLOBAL |level : INT; END_VAR";
    let program = "PROGRAM Main VAR_EXTERNAL LEVEL : INT; END_VAR level := Level + 1; (* level *) END_PROGRAM";
    let other = "PROGRAM Other VAR level : INT; END_VAR level := 1; END_PROGRAM";
    assert_eq!(
        ask(&[global, program, other]).renamed("height").expect("it can be renamed"),
        [
            "VAR_GLOBAL height : INT; END_VAR",
            "PROGRAM Main VAR_EXTERNAL height : INT; END_VAR height := height + 1; (* level *) END_PROGRAM",
            other,
        ]
    );
    let function = "FUNCTION |Twice : INT VAR_INPUT x : INT; END_VAR Twice := x * 2; END_FUNCTION \
                    PROGRAM Main VAR y : INT; END_VAR y := Twice(x := y); END_PROGRAM";
    let renamed = ask(&[function]).renamed("Double").expect("it can be renamed");
    assert_eq!(renamed[0], function.replace('|', "").replace("Twice", "Double"));
}

#[test]
fn a_name_that_would_clash_is_refused() {
    let program = |body: &str| {
        format!(
            "VAR_GLOBAL g : INT; END_VAR PROGRAM Main VAR a, b : INT; END_VAR {body} END_PROGRAM"
        )
    };
    for (body, new, expected) in [
        ("|a := b;", "B", "has another meaning already"),
        // It would hide the global variable.
        ("|a := g;", "g", "`g` has another meaning already: `g` in f0.st:1"),
        // A function of the library is used by this name.
        ("|a := MAX(a, b);", "END_IF", "cannot be a name"),
        ("|a := b;", "1x", "cannot be a name"),
        ("|a := b;", "a b", "cannot be a name"),
        ("|a := b;", "", "cannot be a name"),
        ("|a := b;", "INT", "cannot be a name"),
        ("|a := b", "c", "f0.st has errors of syntax"),
        ("|a := b; b := q.a;", "c", "it is not clear whether `a` in f0.st:1"),
        ("a := |MAX(a, b);", "c", "there is no declared name"),
        ("a := |TIME_TO_STRING(T#1s);", "c", "is declared in a library"),
    ] {
        let error = ask(&[&program(body)]).renamed(new).expect_err(body);
        assert!(error.contains(expected), "{body} to {new}: {error}");
    }
    // Not used, but declared twice.
    let unused = "TYPE |A : INT; B : INT; END_TYPE PROGRAM Main END_PROGRAM";
    let error = ask(&[unused]).renamed("b").expect_err("there is another");
    assert!(error.contains("`B` is declared twice"), "{error}");
}

#[test]
fn wrong_projects_are_read_without_end_or_panic() {
    let text = "TYPE A : B; B : A; S : STRUCT s : S; END_STRUCT; END_TYPE PROGRAM Main VAR x : A; s : S; END_VAR \
                |x.y.z := s.s.s.s.; Main(Main := Main); x(); 5(y := 3); END_PROGRAM PROGRAM Main END_PROGRAM";
    let asked = ask(&[text]);
    let length = text.len() as u32;
    for offset in 0..length + 3 {
        let _ = complete::at(&asked.sources, &asked.index, asked.file, offset);
        if let Some(one) = asked.index.at(asked.file, offset) {
            assert_ne!(asked.index.symbol(one.symbol).kind, SymbolKind::Task);
            let shown = describe::declaration(&asked.sources, &asked.index, one.symbol);
            assert!(shown.len() < 1000, "{shown}");
        }
    }
}
