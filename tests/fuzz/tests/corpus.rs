//! Goes through the kept inputs of every target, as they are and cut short at each of some places.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use takt_fuzz::TARGETS;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let path = folder().join(name).with_extension("tar");
    let file = File::open(&path).unwrap_or_else(|error| panic!("{path:?}: {error}"));
    let read = |entry: Result<tar::Entry<'_, File>, _>| {
        let mut bytes = Vec::new();
        entry.unwrap().read_to_end(&mut bytes).unwrap();
        bytes
    };
    tar::Archive::new(file).entries().unwrap().map(read).collect()
}

#[test]
fn nothing_kept_breaks_its_target() {
    for target in TARGETS {
        let inputs = corpus(target.name);
        assert!(!inputs.is_empty(), "{} has no corpus", target.name);
        for input in inputs {
            for part in [input.len(), input.len() / 2, input.len() / 3, 1, 0] {
                (target.run)(&input[..part.min(input.len())]);
            }
        }
    }
}

#[test]
fn every_archive_of_the_corpus_has_a_target() {
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        assert_eq!(path.extension().and_then(|e| e.to_str()), Some("tar"), "{}", path.display());
        let name = path.file_stem().unwrap().to_str().unwrap();
        assert!(takt_fuzz::target(name).is_some(), "no target {name}");
    }
}
