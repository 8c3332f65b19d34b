//! Projects against what they have to become. Where they lie, `NAME.xml` is a project and `NAME.expected`
//! what it becomes: each file behind its name, then what is refused and what is ignored.

use proptest::prelude::*;
use std::fmt::Write;
use std::path::Path;
use takt_plcopen::{Import, ImportError, MAXIMUM_REFUSED, import};

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
    assert_eq!(import.further, 0);
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
    let other = "<Project xmlns=\"www.iec.ch/public/TC65SC65BWG7TF10\"/>";
    let error = import(other).unwrap_err().to_string();
    assert!(
        error.starts_with("1:1: the document is a <Project>, as IEC 61131-10 has it"),
        "{error}"
    );
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

/// A program with this body.
fn program(body: &str) -> String {
    let body = format!("<body><ST><xhtml>{body}</xhtml></ST></body>");
    let text = format!(
        "<project><types><pous><pou name=\"P\" pouType=\"program\">{body}</pou></pous></types></project>"
    );
    let import = import(&text).unwrap();
    let text = &import.files[0].text;
    text.strip_prefix("PROGRAM P\n").unwrap().strip_suffix("END_PROGRAM\n").unwrap().to_owned()
}

#[test]
fn no_statement_becomes_a_part_of_the_comment_in_the_block_before_it() {
    for body in [
        "<div>a := 1; // x</div><div>b := 2;</div>",
        "<p>a := 1; // x</p>b := 2;",
        "<ul><li>a := 1; // x</li><li>b := 2;</li></ul>",
        "<table><tr><td>a := 1; // x</td></tr><tr><td>b := 2;</td></tr></table>",
        "<pre>a := 1; // x</pre><span>b := 2;</span>",
        "<div><p><span>a := 1; // x</span></p></div><b>b := 2;</b>",
        "<div>a := 1; // x<!-- y --></div><![CDATA[b := 2;]]>",
        "a := 1; // x<div/>b := 2;",
        "a := 1; // x<br/><br/>b := 2;",
        "<p>a := 1; // x</p>\n<p>b := 2;</p>",
    ] {
        assert_eq!(program(body), "a := 1; // x\nb := 2;\n", "{body}");
    }
    // What is no block does not break a line.
    assert_eq!(program("a<b>b</b> := <span>1</span>; <i>// x</i>y"), "ab := 1; // xy\n");
}

#[test]
fn what_is_beside_global_variables_in_the_data_of_a_tool_is_told_of() {
    let list =
        "<globalVars name=\"G\"><variable name=\"x\"><type><INT/></type></variable></globalVars>";
    let ignored = |data: &str| {
        let text = format!("<project><addData>{data}</addData></project>");
        let import = import(&text).unwrap();
        assert_eq!(import.files.len(), data.matches("<globalVars").count(), "{data}");
        import.ignored.into_iter().collect::<Vec<_>>()
    };
    assert!(ignored(&format!("<data name=\"d\">\n{list}<!-- c -->{list}</data>")).is_empty());
    assert_eq!(ignored(&format!("<data name=\"d\">{list}<pou name=\"P\"/></data>")), ["d"]);
    assert_eq!(ignored(&format!("<data name=\"d\"><documentation/>{list}</data>")), ["d"]);
    assert_eq!(ignored(&format!("<data name=\"d\">{list}text</data>")), ["d"]);
    assert_eq!(ignored("<data><pou/></data><data/>"), ["<data> without a name"]);
    // What is within such data is told of by itself.
    let within = "<addData><data name=\"e\"/></addData>";
    assert_eq!(ignored(&format!("<data name=\"d\">{list}{within}</data>")), ["e"]);
}

/// Each of these took time that grew with the square of the project, or more.
#[test]
fn a_large_project_takes_no_longer_than_its_size() {
    let many = 200_000;
    let actions = "<action name=\"A\"/>\n".repeat(many);
    let names = "<pou name=\"P\" pouType=\"program\"><body><ST/></body></pou>".repeat(many / 4);
    let text = format!(
        "<project><types><pous><pou name=\"{}\" pouType=\"program\"><actions>{actions}</actions></pou>{names}\
         </pous></types></project>",
        "x".repeat(1 << 20)
    );
    let import = import(&text).unwrap();
    assert_eq!(
        (import.refused.len(), import.further),
        (MAXIMUM_REFUSED, many + 1 - MAXIMUM_REFUSED)
    );
    assert_eq!((import.refused[999].at.line, import.refused[999].at.column), (1000, 1));
    assert!(import.refused.iter().all(|defect| defect.to_string().len() < 200));
    let last = import.files.last().unwrap();
    assert_eq!((import.files.len(), &*last.name), (many / 4, &*format!("P_{}.st", many / 4)));
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
