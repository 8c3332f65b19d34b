//! What the manual shows of partition files is what Takt takes.

use std::fs;
use std::path::Path;

use super::super::{load, syntax};

/// A line that stands for keys which an example leaves out.
const LEFT_OUT: &str = "# ...\n";
/// Those that have to be there, of a system and of a partition.
const OF_A_SYSTEM: [&str; 2] = ["name = \"plant\"", "major_frame = \"1ms\""];
const OF_A_PARTITION: [&str; 4] =
    ["name = \"plc\"", "kind = \"plc\"", "cpu = 0", "memory = \"4MiB\""];

/// A block of TOML in the manual.
struct Example {
    /// Page and line.
    place: String,
    text: String,
}

/// All of them that are parts of partition files.
fn examples() -> Vec<Example> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let pages = fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|path| path.extension().is_some_and(|end| end == "md"));
    let mut examples = Vec::new();
    for page in pages.chain([root.join("README.md")]) {
        let text = fs::read_to_string(&page).unwrap();
        let mut line = 1;
        for (part, block) in text.split("```").enumerate() {
            // What is not between fences is every other part.
            if let Some(block) = block.strip_prefix("toml\n").filter(|_| part % 2 == 1) {
                let place = format!("{}:{line}", page.display());
                examples.push(Example { place, text: block.to_owned() });
            }
            line += block.matches('\n').count();
        }
    }
    // The file of a project in Structured Text has no tables.
    examples.retain(|example| example.text.contains("\n[") || example.text.starts_with('['));
    examples
}

impl Example {
    /// As a file: with what comes before the table that it begins with, and the keys that it says it leaves out.
    fn as_file(&self) -> String {
        let own = &self.text;
        if own.starts_with("version") {
            return own.clone();
        }
        let keys = |keys: &[&str]| {
            let named = |key: &&&str| key.split(' ').next().is_some_and(|name| names(own, name));
            let lines = keys.iter().filter(|key| !named(key));
            lines.flat_map(|key| [*key, "\n"]).collect::<String>()
        };
        let mut before = "version = 1\n".to_owned();
        if own.starts_with("[system]") {
            return before + &own.replace(LEFT_OUT, &keys(&OF_A_SYSTEM));
        }
        before += &format!("[system]\n{}\n", OF_A_SYSTEM.join("\n"));
        if own.starts_with("[[partition.") {
            before += &format!("[[partition]]\n{}\n", OF_A_PARTITION.join("\n"));
        }
        before + &own.replace(LEFT_OUT, &keys(&OF_A_PARTITION))
    }

    /// Whether it is a whole file, or a whole Linux.
    fn is_whole(&self) -> bool {
        let begins = |words| self.text.starts_with(words);
        (begins("version") || begins("[[partition]]")) && !self.text.contains(LEFT_OUT)
    }
}

/// Whether a line gives a value to the key.
fn names(text: &str, key: &str) -> bool {
    text.lines().any(|line| line.split(" = ").next() == Some(key))
}

#[test]
fn each_example_has_known_keys_and_all_that_are_required() {
    let examples = examples();
    assert!(examples.len() >= 25, "where are the examples? There are {}", examples.len());
    for example in examples {
        let text = example.as_file();
        if let Err(defect) = syntax::parse(&text) {
            panic!("{}: {defect:?}\n{text}", example.place);
        }
    }
}

#[test]
fn whole_examples_lack_only_the_files_that_they_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant.toml");
    let whole: Vec<Example> = examples().into_iter().filter(Example::is_whole).collect();
    assert!(whole.len() >= 4, "where are the whole examples? There are {}", whole.len());
    for example in whole {
        let mut text = example.as_file();
        if !text.contains("[[schedule]]") {
            text += "[[schedule]]\nname = \"normal\"\n";
        }
        fs::write(&path, &text).unwrap();
        let message = load(&path, None).err().map(|error| error.to_string()).unwrap_or_default();
        let missing = message.lines().next().unwrap_or_default();
        assert!(
            missing.ends_with("No such file or directory (os error 2)"),
            "{}: {message}",
            example.place
        );
    }
}
