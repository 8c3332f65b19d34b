//! The extension for the editor: it is well formed, its files are there, and it knows the words of the language.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use takt_st::syntax::token::Keyword;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("vscode").join(name)
}

fn json(name: &str) -> Value {
    let text = fs::read_to_string(file(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{name}: {error}"))
}

#[test]
fn the_files_that_the_package_names_are_there() {
    let package = json("package.json");
    let contributes = &package["contributes"];
    for path in [&contributes["languages"][0]["configuration"], &contributes["grammars"][0]["path"]]
    {
        json(path.as_str().expect("a path"));
    }
    let client = package["main"].as_str().expect("a path");
    let client = fs::read_to_string(file(client)).expect("the client is there");
    assert!(client.contains(r#"args: ["plc", "lsp"]"#) && client.contains(r#"get("command")"#));
    let library = package["dependencies"].as_object().expect("libraries").keys().next();
    assert!(client.contains(&format!("require(\"{}/node\")", library.expect("one"))));
    assert!(contributes["configuration"]["properties"]["takt.command"].is_object());
    let scope = &contributes["grammars"][0]["scopeName"];
    assert_eq!(*scope, json("syntaxes/st.tmLanguage.json")["scopeName"]);
}

#[test]
fn the_grammar_knows_each_keyword_once() {
    let grammar = json("syntaxes/st.tmLanguage.json");
    let matches = |group: &Value| group["match"].as_str().map(str::to_owned);
    let repository = grammar["repository"].as_object().expect("rules").values();
    let rules: Vec<String> = repository
        .flat_map(|rule| {
            let inner = rule["patterns"].as_array().into_iter().flatten().filter_map(matches);
            matches(rule).into_iter().chain(inner).collect::<Vec<_>>()
        })
        .filter(|rule| rule.starts_with(r"\b(?i:") && rule.ends_with(r")\b"))
        .collect();
    for keyword in Keyword::ALL {
        let word = keyword.text();
        let has = |rule: &&String| {
            let words = rule.trim_start_matches(r"\b(?i:").trim_end_matches(r")\b");
            words.split('|').any(|known| known == word)
        };
        assert_eq!(rules.iter().filter(has).count(), 1, "{word}");
    }
}

#[test]
fn each_rule_that_is_included_exists() {
    let grammar = json("syntaxes/st.tmLanguage.json");
    let text = grammar.to_string();
    let included =
        text.split(r##""include":"#"##).skip(1).filter_map(|rest| rest.split('"').next());
    for name in included {
        assert!(grammar["repository"].get(name).is_some(), "{name}");
    }
}
