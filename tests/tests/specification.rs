//! The specification names a test for each promise, and the page about real hosts one for each guard. A promise whose test
//! is gone would be held by nothing.

use std::fs;
use std::path::Path;

/// The tests that a page names, as `module` and `test`: code spans of identifiers with `::` between.
fn named(page: &str) -> Vec<(&str, &str)> {
    let spans = page.split('`').skip(1).step_by(2);
    spans
        .filter_map(|span| span.rsplit_once("::"))
        .filter(|(module, _)| *module != "module")
        .collect()
}

/// The page, and the source of a module of tests of whole machines.
fn page_of(name: &str) -> (String, impl Fn(&str) -> String) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ is in the project");
    let text = fs::read_to_string(root.join("docs").join(name)).expect("the page is there");
    let source = move |module: &str| {
        let file = root.join(format!("tests/tests/nested/{}.rs", module.replace("::", "/")));
        fs::read_to_string(file).unwrap_or_default()
    };
    (text, source)
}

/// Fails unless the page names so many tests of whole machines, and all of them exist.
fn check(page: &str, at_least: usize) {
    let (text, source) = page_of(page);
    let named = named(&text);
    assert!(named.len() > at_least, "{page} names only {} tests", named.len());
    let missing: Vec<String> = named
        .into_iter()
        .filter(|(module, test)| !source(module).contains(&format!("#[test]\nfn {test}() {{")))
        .map(|(module, test)| format!("{module}::{test}"))
        .collect();
    assert!(missing.is_empty(), "docs/{page} names tests that do not exist: {missing:?}");
}

#[test]
fn each_test_that_the_specification_names_exists() {
    check("specification.md", 20);
}

#[test]
fn each_test_that_the_page_about_real_hosts_names_exists() {
    check("real-host.md", 15);
}

/// Continuous integration does not run those.
#[test]
fn the_specification_tells_which_tests_run_in_the_long_form_only() {
    let (text, source) = page_of("specification.md");
    let (mut rows, mut untold) = (0, Vec::new());
    for row in text.lines() {
        let only_long = named(row).into_iter().any(|(module, test)| {
            let marked = format!("--long\"]\n#[test]\nfn {test}() {{");
            source(module).contains(&marked)
        });
        rows += usize::from(only_long);
        if only_long && !row.contains("in the long form only") {
            untold.push(row);
        }
    }
    assert!(rows > 5, "{rows} rows");
    assert!(untold.is_empty(), "{untold:#?}");
}

/// Without the option cargo runs none that takes long, and ends well.
#[test]
fn each_command_for_a_test_of_a_whole_machine_runs_it() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("it has one").join("docs");
    let mut commands = 0;
    for page in fs::read_dir(docs).expect("the pages are there") {
        let path = page.expect("it can be listed").path();
        let text =
            if path.is_file() { fs::read_to_string(&path).expect("a text") } else { continue };
        for line in text.lines().filter(|line| line.contains("--test nested ")) {
            commands += 1;
            assert!(line.contains("--include-ignored"), "{}: {line}", path.display());
        }
    }
    assert!(commands > 3, "{commands}");
}
