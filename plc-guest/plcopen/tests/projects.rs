//! Projects against what they have to become. Where they lie, `NAME.xml` is a project and `NAME.expected`
//! what it becomes: each file behind its name, then what is refused and what is ignored.

use proptest::prelude::*;
use std::fmt::Write;
use std::path::Path;
use takt_plcopen::{Import, ImportError, import};

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/projects").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn shown(import: &Import) -> String {
    let mut text = String::new();
    for file in &import.files {
        writeln!(text, "=== {}\n{}", file.name, file.text).unwrap();
    }
    text.push_str("=== refused\n");
    for defect in &import.refused {
        writeln!(text, "{defect}").unwrap();
    }
    text.push_str("=== ignored\n");
    for name in &import.ignored {
        writeln!(text, "{name}").unwrap();
    }
    text
}

fn becomes_what_is_expected(name: &str) {
    let import = import(&read(&format!("{name}.xml"))).expect("a project");
    let (found, expected) = (shown(&import), read(&format!("{name}.expected")));
    assert!(found == expected, "{name}.xml became\n{found}");
}

#[test]
fn a_project_becomes_source_files() {
    becomes_what_is_expected("plant");
}

#[test]
fn what_cannot_be_imported_is_refused_by_name_and_the_rest_is_not() {
    becomes_what_is_expected("refused");
}

#[test]
fn what_is_no_project_is_refused_whole() {
    let error = import("<svg/>").unwrap_err();
    assert_eq!(error.to_string(), "1:1: the document is a <svg>, not a PLCopen <project>");
    for text in ["", "PROGRAM p END_PROGRAM", "<project>", "<project></types>", "\u{0}"] {
        assert!(matches!(import(text), Err(ImportError::Xml(_))), "{text:?}");
    }
}

#[test]
fn entities_are_refused() {
    let text = "<!DOCTYPE p [<!ENTITY a \"aaaa\">]><project>&a;</project>";
    assert!(matches!(import(text), Err(ImportError::Xml(_))));
}

#[test]
fn types_without_end_are_refused() {
    let deep = 20_000;
    let text = format!(
        "<project><types><dataTypes><dataType name=\"A\">{}{}</dataType></dataTypes></types></project>",
        "<baseType><array><dimension lower=\"0\" upper=\"1\"/>".repeat(deep),
        "</array></baseType>".repeat(deep)
    );
    match import(&text) {
        // The reader of XML may give up first.
        Err(ImportError::Xml(_)) => {}
        Err(error) => panic!("{error}"),
        Ok(import) => {
            assert!(import.files.is_empty());
            assert!(import.refused[0].to_string().contains("deeper than 32 levels"));
        }
    }
}

#[test]
fn units_whose_names_differ_in_case_get_files_of_their_own() {
    let unit = |name| format!("<pou name=\"{name}\" pouType=\"program\"><body><ST/></body></pou>");
    let pous = format!("{}{}{}", unit("Main"), unit("MAIN"), unit("main_2"));
    let import = import(&format!("<project><types><pous>{pous}</pous></types></project>")).unwrap();
    let names: Vec<_> = import.files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(names, ["Main.st", "MAIN_2.st", "main_2_2.st"]);
}

proptest! {
    /// Names and values of strangers end no declaration and leave no folder.
    #[test]
    fn whatever_stands_in_attributes(name in ".{0,12}", value in ".{0,24}", address in "%?.{0,8}") {
        let escaped = |text: &str| {
            let escape = |c: char| match c {
                c if c < ' ' || ('\u{7f}'..'\u{a0}').contains(&c) => String::new(),
                '\u{fffe}' | '\u{ffff}' => String::new(),
                c => format!("&#{};", u32::from(c)),
            };
            text.chars().map(escape).collect::<String>()
        };
        let (name, value, address) = (escaped(&name), escaped(&value), escaped(&address));
        let text = format!(
            "<project><types><pous><pou name=\"{name}\" pouType=\"program\"><interface><localVars>\
             <variable name=\"x\" address=\"{address}\"><type><INT/></type><initialValue>\
             <simpleValue value=\"{value}\"/></initialValue></variable></localVars></interface>\
             <body><ST/></body></pou></pous></types></project>"
        );
        for file in import(&text).expect("well-formed").files {
            let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.');
            prop_assert!(file.name.chars().all(plain) && !file.name.starts_with('.'));
            prop_assert_eq!(file.text.lines().count(), 5, "{}", file.text);
        }
    }

    #[test]
    fn any_change_of_a_project_is_imported_or_refused(at in 0usize..6_000, with in ".{0,4}") {
        let mut text = read("plant.xml");
        let at = (0..=at.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap();
        let end = (at + 4..).find(|end| text.is_char_boundary((*end).min(text.len()))).unwrap();
        text.replace_range(at..end.min(text.len()), &with);
        let _ = import(&text);
    }
}
