//! The recorded run, and what draws it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_takt-jitter");

pub fn recorded(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recorded").join(name)
}

/// An empty folder for the test of this name.
pub fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Renders a report and samples into `out`.
pub fn render(report: &Path, samples: &Path, out: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(PROGRAM);
    command.arg("render").arg("--report").arg(report).arg("--samples").arg(samples);
    command.arg("--out").arg(out).args(more).output().unwrap()
}

pub fn render_recorded(out: &Path, more: &[&str]) -> Output {
    render(&recorded("report.json"), &recorded("samples.json"), out, more)
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

pub fn page(folder: &Path) -> String {
    fs::read_to_string(folder.join("report.html")).unwrap()
}

pub fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}
