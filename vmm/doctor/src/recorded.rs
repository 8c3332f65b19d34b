//! Recorded hosts, for tests: `tests/hosts/record` makes them.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::host::Host;
use crate::steering::Steering;

/// The files of a host, by their paths, its kernel's log as `log`, and its clock's steering as `adjtimex`.
#[derive(Clone, Debug)]
pub struct Recorded {
    files: BTreeMap<String, String>,
}

impl Recorded {
    /// The record of this name.
    pub fn named(name: &str) -> Self {
        let path = format!("{}/tests/hosts/{name}.host", env!("CARGO_MANIFEST_DIR"));
        let text = fs::read_to_string(path).unwrap();
        let mut files = BTreeMap::new();
        for part in format!("\n{text}").split("\n== ").skip(1) {
            let (path, content) = part.split_once('\n').unwrap_or((part, ""));
            files.insert(path.to_owned(), content.to_owned());
        }
        Self { files }
    }

    /// With other content of a file.
    pub fn with(mut self, path: &str, content: &str) -> Self {
        self.files.insert(path.to_owned(), content.to_owned());
        self
    }

    /// Without a file.
    pub fn without(mut self, path: &str) -> Self {
        assert!(self.files.remove(path).is_some(), "{path}");
        self
    }

    /// The paths of all files.
    pub fn paths(&self) -> Vec<String> {
        self.files.keys().cloned().collect()
    }

    /// Writes it into a folder, and looks at that. The folder goes with the tree.
    pub fn unpack(&self) -> Tree {
        static TREES: AtomicUsize = AtomicUsize::new(0);
        let number = TREES.fetch_add(1, Ordering::Relaxed);
        let name = format!("takt-doctor-{}-{number}", std::process::id());
        let root = std::env::temp_dir().join(name);
        for (path, content) in &self.files {
            let path = root.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        let log = self.files.get("log").cloned().unwrap_or_default();
        let steering = self.files.get("adjtimex").and_then(|text| Steering::recorded(text));
        Tree { host: Host::recorded(&root, log).steered(steering), root }
    }
}

/// A host on disk.
pub struct Tree {
    pub host: Host,
    root: PathBuf,
}

impl Tree {
    /// Changes a file; returns what was in it.
    pub fn change(&self, path: &str, content: &str) -> String {
        let before = fs::read_to_string(self.root.join(path)).unwrap();
        fs::write(self.root.join(path), content).unwrap();
        before
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.root);
    }
}
