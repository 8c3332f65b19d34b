//! The text of a project file, key by key. A mistake in one hides none in another.

use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use takt_program::Version;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{Project, is_program_name};
use crate::diagnostic::{Code, Diagnostic};
use crate::files;
use crate::source::{FileId, Span};

const KEYS: [&str; 7] =
    ["name", "version", "category", "sources", "libraries", "tests", "previous"];
/// Those that say where sources are.
const PLACES: [&str; 3] = ["sources", "libraries", "tests"];
/// Messages about one file.
const MOST: usize = 100;

/// The file while it is read.
struct Reader<'a> {
    file: FileId,
    folder: &'a Path,
    diagnostics: Vec<Diagnostic>,
    /// Whether a key was meant that says where sources are.
    misspelt: bool,
}

/// The project that a file describes, and all that is wrong with it, by place. Beside mistakes the project is there if
/// what is understood tells where all sources are.
pub(super) fn project(
    file: FileId,
    text: &str,
    folder: &Path,
) -> (Option<Project>, Vec<Diagnostic>) {
    let mut reader = Reader { file, folder, diagnostics: Vec::new(), misspelt: false };
    let (table, errors) = DeTable::parse_recoverable(text);
    for error in &errors {
        let message = error.message().lines().next().unwrap_or_default().to_owned();
        let allowed = format!("TOML with the keys {}", KEYS.join(", "));
        let place = error.span().unwrap_or(0..0);
        // At the end of a line nothing could be marked.
        reader.wrong(place.start.min(text.len())..place.end.min(text.len()), message, allowed);
        // TOML has no bare words; what begins like one of its own is told as that.
        if let (Some(word), Some(one)) = (text.get(place), reader.diagnostics.last_mut())
            && word.starts_with(|c: char| c.is_alphabetic())
        {
            one.hint = Some("a text stands in quotation marks".to_owned());
        }
    }
    let whole = errors.is_empty();
    let project = reader.table(table.get_ref(), whole);
    // A key that says where sources are may be in what is not understood.
    let hidden = |key: &&str| {
        table.get_ref().get(*key).is_none()
            && text.lines().any(|line| line.trim_start().starts_with(*key))
    };
    let misspelt = reader.misspelt;
    let project = project.filter(|_| !misspelt && (whole || !PLACES.iter().any(hidden)));
    reader.diagnostics.sort_by_key(|one| (one.span.start, one.span.end));
    reader.diagnostics.truncate(MOST);
    (project, reader.diagnostics)
}

type Value<'t> = Spanned<DeValue<'t>>;

impl Reader<'_> {
    /// What the keys say, if those are good that say where sources are. Where the text is no TOML, a key that seems to
    /// be missing may be there.
    fn table(&mut self, table: &DeTable<'_>, whole: bool) -> Option<Project> {
        for (key, _) in table {
            let name = key.get_ref();
            self.misspelt |= PLACES.iter().any(|known| *known != name && is_near(known, name));
            if !KEYS.contains(&&**name) {
                let found = format!("unknown key `{}`", name.escape_debug());
                let similar = KEYS.iter().find(|known| is_near(known, name));
                self.wrong(key.span(), found, KEYS.join(", "));
                if let (Some(similar), Some(one)) = (similar, self.diagnostics.last_mut()) {
                    one.hint = Some(format!("did you mean `{similar}`?"));
                }
            }
        }
        let value = |key: &str| table.get(key);
        if value("name").is_none() && whole {
            self.wrong(0..0, "missing key `name`", "`name = \"tank\"`, the program's name");
        }
        // All of them before any is given up.
        let name = value("name").map(|it| self.name(it));
        let version = value("version").map(|it| self.version(it));
        let category = value("category").map(|it| self.category(it));
        let previous = value("previous").map(|it| self.image(it));
        let sources = value("sources").map(|it| self.paths(it));
        let libraries = value("libraries").map(|it| self.paths(it));
        let tests = value("tests").map(|it| self.tests(it));
        let usual = self.folder.join("tests");
        Some(Project {
            folder: self.folder.to_owned(),
            name: name.flatten().unwrap_or_default(),
            version: version.flatten().unwrap_or_default(),
            category: category.flatten().unwrap_or_default(),
            previous: previous.flatten(),
            sources: sources.unwrap_or_else(|| Some(vec![self.folder.to_owned()]))?,
            libraries: libraries.unwrap_or_else(|| Some(Vec::new()))?,
            tests: match tests {
                Some(tests) => tests?,
                None if usual.is_dir() => vec![usual],
                None => Vec::new(),
            },
        })
    }

    fn wrong(&mut self, at: Range<usize>, found: impl Into<String>, allowed: impl Into<String>) {
        let span = Span { file: self.file, start: at.start as u32, end: at.end as u32 };
        // What is no TOML is no value of a wrong type as well.
        if self.diagnostics.iter().any(|one| one.span.start < span.end && span.start < one.span.end)
        {
            return;
        }
        self.diagnostics.push(Diagnostic::new(Code::ProjectFile, span, found).allowed(allowed));
    }

    /// A value of another type than the key's.
    fn other_type(&mut self, value: &Value<'_>, allowed: &str) {
        let found = match value.get_ref() {
            DeValue::String(text) => format!("the string `{}`", text.escape_debug()),
            DeValue::Integer(number) => format!("the number {number}"),
            DeValue::Float(number) => format!("the number {number}"),
            DeValue::Boolean(truth) => format!("`{truth}`"),
            DeValue::Datetime(_) => "a date".to_owned(),
            DeValue::Array(_) => "a list".to_owned(),
            DeValue::Table(_) => "a table".to_owned(),
        };
        self.wrong(value.span(), found, allowed);
    }

    fn text<'t>(&mut self, value: &'t Value<'_>, allowed: &str) -> Option<&'t str> {
        if let DeValue::String(text) = value.get_ref() {
            return Some(text);
        }
        self.other_type(value, allowed);
        None
    }

    fn name(&mut self, value: &Value<'_>) -> Option<String> {
        let text = self.text(value, "a name in quotation marks")?;
        if is_program_name(text) {
            return Some(text.to_owned());
        }
        let found = format!("the name `{}`", text.escape_debug());
        self.wrong(value.span(), found, "1 to 64 letters A to Z, digits, `_`, `-` and `.`");
        None
    }

    fn version(&mut self, value: &Value<'_>) -> Option<Version> {
        const ALLOWED: &str = "three numbers up to 65535, such as `\"1.2.0\"`";
        let text = self.text(value, ALLOWED)?;
        let numbers: Option<Vec<u16>> = text.split('.').map(|number| number.parse().ok()).collect();
        if let Some(&[major, minor, patch]) = numbers.as_deref() {
            return Some(Version { major, minor, patch });
        }
        self.wrong(value.span(), format!("the version `{}`", text.escape_debug()), ALLOWED);
        None
    }

    fn category(&mut self, value: &Value<'_>) -> Option<u32> {
        const ALLOWED: &str = "a number, 0 to 4294967295";
        let DeValue::Integer(number) = value.get_ref() else {
            self.other_type(value, ALLOWED);
            return None;
        };
        let category = u32::from_str_radix(number.as_str(), number.radix()).ok();
        if category.is_none() {
            self.wrong(value.span(), format!("the category {number}"), ALLOWED);
        }
        category
    }

    fn paths(&mut self, value: &Value<'_>) -> Option<Vec<PathBuf>> {
        let DeValue::Array(list) = value.get_ref() else {
            self.other_type(value, "a list of paths in square brackets: `[\"src\"]`");
            return None;
        };
        let paths: Vec<Option<PathBuf>> = list.iter().map(|path| self.path(path)).collect();
        paths.into_iter().collect()
    }

    /// Paths to tests: none that would never run.
    fn tests(&mut self, value: &Value<'_>) -> Option<Vec<PathBuf>> {
        let paths = self.paths(value)?;
        let entries = value.get_ref().as_array().into_iter().flatten();
        for (path, entry) in paths.iter().zip(entries) {
            let is_test = ["st", "csv"].iter().any(|one| files::has_extension(path, one));
            if !is_test && !path.as_os_str().is_empty() && !path.is_dir() {
                let text = entry.get_ref().as_str().unwrap_or_default();
                let found = format!("`{}` is no test", text.escape_debug());
                let allowed = "folders, and files that end with .st or .csv";
                self.wrong(entry.span(), found, allowed);
            }
        }
        Some(paths)
    }

    /// A path to a program image. What is in the file is seen when it is used.
    fn image(&mut self, value: &Value<'_>) -> Option<PathBuf> {
        let path = self.path(value)?;
        if !path.as_os_str().is_empty() && !path.is_dir() {
            return Some(path);
        }
        self.wrong(value.span(), "a folder", "a program image, such as `\"running.plc\"`");
        None
    }

    /// A path from the project's folder to something that is there.
    fn path(&mut self, value: &Value<'_>) -> Option<PathBuf> {
        const ALLOWED: &str = "a path from the folder of this file, in quotation marks";
        let text = self.text(value, ALLOWED)?;
        let shown = text.escape_debug();
        if Path::new(text).is_absolute() || text.is_empty() {
            self.wrong(value.span(), format!("the path `{shown}`"), ALLOWED);
            return None;
        }
        let whole: PathBuf = self.folder.join(text);
        let whole: PathBuf = whole.components().filter(|part| *part != Component::CurDir).collect();
        // The project's own folder is the current one if nothing is left.
        let there = if whole.as_os_str().is_empty() { Path::new(".") } else { &whole };
        if !there.exists() {
            let found = format!("there is no `{shown}` in this folder");
            self.wrong(value.span(), found, "a file or a folder that is there");
            return None;
        }
        Some(whole)
    }
}

/// Whether a key was probably meant: it differs in one letter that is missing, too many or another.
fn is_near(known: &str, written: &str) -> bool {
    let same = |pair: &(char, char)| pair.0 == pair.1;
    let front = known.chars().zip(written.chars()).take_while(same).count();
    let back = known.chars().rev().zip(written.chars().rev()).take_while(same).count();
    let longer = known.chars().count().max(written.chars().count());
    known.len().abs_diff(written.len()) <= 1 && front + back + 1 >= longer
}
