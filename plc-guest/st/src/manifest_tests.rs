//! The manifest of a project, and each mistake in it.

use super::*;

fn folder_with(text: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE), text).unwrap();
    folder
}

fn refused(text: &str) -> String {
    let folder = folder_with(text);
    let message = Project::read(folder.path()).unwrap_err().to_string();
    message.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn a_name_is_enough() {
    let folder = folder_with("name = \"tank\"\n");
    let project = Project::read(folder.path()).unwrap();
    assert_eq!((project.name.as_str(), project.category), ("tank", 0));
    assert_eq!(project.version, Version::default());
    assert_eq!(project.sources, [folder.path()]);
}

#[test]
fn sources_libraries_and_tests_are_told_apart_and_each_is_taken_once() {
    let folder = folder_with("name = \"tank\"\nversion = \"1.2.3\"\nlibraries = [\"lib\"]\n");
    for (name, text) in [
        ("main.st", "PROGRAM Main\nEND_PROGRAM\n"),
        ("lib/filters.st", "FUNCTION f : INT\nf := 1;\nEND_FUNCTION\n"),
        ("tests/a.st", "TEST 'a'\nEND_TEST\n"),
        ("tests/a.csv", "x\n1\n"),
    ] {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let project = Project::read(folder.path()).unwrap();
    assert_eq!(project.version.to_string(), "1.2.3");
    let sources = project.sources();
    let shown: Vec<(String, bool)> = sources
        .iter()
        .map(|(file, source)| {
            let name = Path::new(source.name()).strip_prefix(folder.path()).unwrap();
            (name.display().to_string(), sources.is_of_library(file))
        })
        .collect();
    let expected = [("main.st", false), ("tests/a.st", false), ("lib/filters.st", true)];
    assert_eq!(shown, expected.map(|(name, library)| (name.to_owned(), library)));
    assert_eq!(project.tables().unwrap(), [folder.path().join("tests/a.csv")]);
    // A library is not the author's, also where it is within the sources.
    let own = ["main.st", "tests/a.st"].map(|name| folder.path().join(name));
    assert_eq!(project.own_files().unwrap(), own);
}

#[test]
fn each_mistake_is_told_with_its_place() {
    for (text, says) in [
        ("", "takt-plc.toml:1:1: missing key `name`"),
        ("name = \"two words\"\n", "takt-plc.toml:1:8: the name `two words`"),
        ("name = 7\n", "takt-plc.toml:1:8: the number 7"),
        ("name = \"a\"\nversion = \"1\"\n", "takt-plc.toml:2:11: the version `1`"),
        ("name = \"a\"\ncategory = -1\n", "takt-plc.toml:2:12: the category -1"),
        ("name = \"a\"\nsource = [\".\"]\n", "takt-plc.toml:2:1: unknown key `source`"),
        ("name = \"a\"\nsources = [\"src\"]\n", "takt-plc.toml:2:12: there is no `src`"),
        ("name = \"a\"\nlibraries = [\"/lib\"]\n", "takt-plc.toml:2:14: the path `/lib`"),
        ("name = \"a\"\ntests = \"t\"\n", "takt-plc.toml:2:9: the string `t`"),
        (
            "name = \"a\"\ntests = [\".\", \"takt-plc.toml\"]\n",
            "takt-plc.toml:2:15: `takt-plc.toml` is no test",
        ),
        ("name = \"a\n", "takt-plc.toml:1:"),
        ("name = tank\n", "hint: a text stands in quotation marks"),
        ("name = \"a\"\nprevious = \".\"\n", "takt-plc.toml:2:12: a folder"),
    ] {
        let message = refused(text);
        assert!(message.contains(says), "{text}: {message}");
        assert!(message.contains("allowed: "), "{text}: {message}");
    }
}

#[test]
fn all_mistakes_are_told_at_once_by_place_with_hints() {
    let message = refused(
        "name = \"two words\"\nsorces = [\".\"]\nversion = 1.5\ncategory = \"7\"\nlibraries = [\"none\", 3]\n\
         previous = true\ntests = { a = 1 }\n",
    );
    let told: Vec<&str> = message.lines().filter(|line| line.starts_with("error[")).collect();
    let expected = [
        "1:8: the name `two words`",
        "2:1: unknown key `sorces`",
        "3:11: the number 1.5",
        "4:12: the string `7`",
        "5:14: there is no `none` in this folder",
        "5:22: the number 3",
        "6:12: `true`",
        "7:9: a table",
    ];
    assert_eq!(told, expected.map(|text| format!("error[project-file]: takt-plc.toml:{text}")));
    assert!(message.contains("  hint: did you mean `sources`?"), "{message}");
    assert_eq!(message.matches("  allowed: ").count(), 8, "{message}");
    // No TOML, and what else is wrong as far as it can be read.
    let message = refused("name = \"a\ncategory = -1\nversion = \"1\"\n");
    assert!(message.contains("takt-plc.toml:1:"), "{message}");
    assert!(message.contains("takt-plc.toml:2:12: the category -1"), "{message}");
    assert!(message.contains("takt-plc.toml:3:11: the version `1`"), "{message}");
    assert!(!message.contains("missing key"), "{message}");
}

#[test]
fn what_stands_in_a_folder_and_cannot_be_read_is_told() {
    use std::os::unix::{fs::symlink, net::UnixListener};
    let folder = folder_with("name = \"tank\"\n");
    std::fs::create_dir(folder.path().join("tests")).unwrap();
    std::fs::write(folder.path().join("main.st"), "PROGRAM Main\nEND_PROGRAM\n").unwrap();
    // The mark of an editor that changes a file.
    symlink("someone@somewhere.1:2", folder.path().join(".#main.st")).unwrap();
    let project = Project::read(folder.path()).unwrap();
    assert_eq!(project.sources().refused().len(), 0);
    symlink("nowhere", folder.path().join("x.st")).unwrap();
    symlink("nowhere", folder.path().join("tests/x.csv")).unwrap();
    let _listener = UnixListener::bind(folder.path().join("y.st")).unwrap();
    let sources = project.sources();
    let told: Vec<&str> = sources.refused().iter().map(|one| one.code.name()).collect();
    assert_eq!(told, ["cannot-read", "no-source"]);
    assert!(project.tables().is_err());
}
