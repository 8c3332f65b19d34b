//! The page on Structured Text (docs/st.md) tells what the compiler does: its examples have the messages
//! that it shows, and its rows name every case.

use std::collections::BTreeSet;
use std::path::Path;

use takt_st::diagnostic::text;
use takt_st::hir::Elementary;
use takt_st::project;
use takt_st::source::Sources;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn page() -> String {
    std::fs::read_to_string(root().join("../../docs/st.md")).expect("the page is there")
}

/// What stands between two fences.
fn fenced<'p>(page: &'p str, fence: &str) -> Vec<&'p str> {
    let parts = page.split(fence).skip(1);
    parts.map(|part| part.split("```").next().unwrap_or_default()).collect()
}

#[test]
fn every_example_has_the_messages_that_the_compiler_shows() {
    let page = page();
    let (sources, messages) = (fenced(&page, "```st\n"), fenced(&page, "```text\n"));
    assert_eq!((sources.len(), messages.len()), (10, 10));
    for (source, expected) in sources.into_iter().zip(messages) {
        let mut files = Sources::new();
        files.add("main.st", source.as_bytes()).expect("it is a source");
        let checked = project::check("page", &mut files).expect("there is a thread");
        let told: String =
            checked.diagnostics.iter().map(|one| text::to_string(&files, one)).collect();
        assert_eq!(told, expected, "{source}");
    }
}

#[test]
fn the_rows_name_cases_that_are_there() {
    let page = page();
    let topics: BTreeSet<String> = std::fs::read_dir(root().join("tests/cases"))
        .expect("there are cases")
        .map(|entry| entry.expect("it can be listed").file_name().to_string_lossy().into_owned())
        .collect();
    let named: BTreeSet<&str> = page
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|name| name.split_once('/').is_some_and(|(topic, _)| topics.contains(topic)))
        .collect();
    assert!(named.len() > 70, "only {} cases are named", named.len());
    for name in named {
        let path = root().join("tests/cases").join(name).with_extension("st");
        assert!(path.is_file(), "{name} is named and not there");
    }
}

/// Whether a case has an error, by what stands at its end; the test of the cases holds that.
fn has_error(case: &str) -> bool {
    let path = root().join("tests/cases").join(case).with_extension("st");
    let text = std::fs::read_to_string(path).expect("the case is there");
    text.lines().any(|line| line.starts_with("// error "))
}

/// The cases that a cell names.
fn named(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

#[test]
fn each_row_has_what_it_accepts_and_what_it_refuses() {
    let page = page();
    let table = page.split("## The language").nth(1).expect("the table is there");
    let table = table.split("\n## ").next().unwrap_or_default();
    let elementary: Vec<Vec<&str>> = table
        .lines()
        .skip_while(|line| !line.starts_with("| elementary type"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    let rows: Vec<Vec<&str>> = table
        .lines()
        .skip_while(|line| !line.starts_with('|'))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    assert!(rows.len() > 35, "only {} rows", rows.len());
    let mut wrong = Vec::new();
    for row in &rows {
        let (part, accepted, refused) = (row[1], named(row[3]), named(row[4]));
        let (table, decision) = (row[2], row[5]);
        if !["table", "figure", "clause", "Takt's own", "none"]
            .iter()
            .any(|it| table.starts_with(it))
        {
            wrong.push(format!("{part}: not where the standard has it, but `{table}`"));
        }
        if accepted.is_empty() && !decision.starts_with("None of it is accepted: ") {
            wrong.push(format!("{part}: no case that is accepted, and not why there is none"));
        }
        if refused.is_empty() && !decision.starts_with("Nothing of it is refused: ") {
            wrong.push(format!("{part}: no case that is refused, and not why there is none"));
        }
        for case in accepted.iter().filter(|case| has_error(case)) {
            wrong.push(format!("{part}: {case} is refused"));
        }
        let is_warning = |case: &&&str| row[4].contains(&format!("`{case}` (a warning)"));
        for case in refused.iter().filter(|case| !has_error(case) && !is_warning(case)) {
            wrong.push(format!("{part}: {case} is accepted"));
        }
    }
    for row in &elementary {
        let (accepted, refused) = (named(row[4]), named(row[5]));
        if accepted.len() != 1 || accepted.iter().any(|case| has_error(case)) {
            wrong.push(format!("{}: {accepted:?} as accepted", row[1]));
        }
        if refused.len() != 1 || !refused.iter().all(|case| has_error(case)) {
            wrong.push(format!("{}: {refused:?} as refused", row[1]));
        }
    }
    let named: Vec<&str> = elementary.iter().map(|row| row[1]).collect();
    let missing = Elementary::ALL.iter().map(|one| one.name()).chain(["STRING", "WSTRING"]);
    wrong.extend(missing.filter(|one| !named.contains(one)).map(|one| format!("{one}: no row")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
