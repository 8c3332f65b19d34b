//! `takt plc new`: a project that stands anywhere and needs nothing of the network.
//!
//! The SDK is written into the project. A dependency on a registry or on a repository would need the network, and one
//! on the place where Takt was built would break with it.

use std::fs;
use std::path::{Path, PathBuf};

use super::output::folder;
use crate::Failure;

/// Arguments of `new`.
#[derive(clap::Args)]
pub struct New {
    /// The folder to make; its last part is the program's name.
    path: PathBuf,
    /// The language.
    #[arg(long, value_enum)]
    lang: Language,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Language {
    Rust,
    C,
    /// IEC 61131-3 Structured Text.
    St,
}

/// A file of a project: its path, and its text with NAME where the program's name goes.
type File = (&'static str, &'static str);

const RUST: &[File] = &[
    ("Cargo.toml", include_str!("../templates/rust/Cargo.toml.in")),
    ("Makefile", include_str!("../templates/rust/Makefile")),
    ("src/lib.rs", include_str!("../templates/rust/lib.rs.in")),
    ("tests/tank.csv", include_str!("../templates/tank.csv")),
    (".gitignore", "/target\n*.plc\n*.key\n"),
    ("README.md", include_str!("../templates/rust/README.md")),
    ("takt-sdk/Cargo.toml", include_str!("../../../sdk/Cargo.toml")),
    ("takt-sdk/src/lib.rs", include_str!("../../../sdk/src/lib.rs")),
    ("takt-sdk/src/call.rs", include_str!("../../../sdk/src/call.rs")),
    ("takt-sdk/src/declaration.rs", include_str!("../../../sdk/src/declaration.rs")),
    ("takt-sdk/src/job.rs", include_str!("../../../sdk/src/job.rs")),
    ("takt-sdk/src/line.rs", include_str!("../../../sdk/src/line.rs")),
    ("takt-sdk/src/local.rs", include_str!("../../../sdk/src/local.rs")),
    ("takt-sdk/src/macros.rs", include_str!("../../../sdk/src/macros.rs")),
    ("takt-sdk/src/object.rs", include_str!("../../../sdk/src/object.rs")),
    ("takt-sdk/src/point.rs", include_str!("../../../sdk/src/point.rs")),
    ("takt-sdk/src/runtime.rs", include_str!("../../../sdk/src/runtime.rs")),
    ("takt-sdk/src/task.rs", include_str!("../../../sdk/src/task.rs")),
    ("takt-sdk/src/text.rs", include_str!("../../../sdk/src/text.rs")),
    ("takt-sdk/src/time.rs", include_str!("../../../sdk/src/time.rs")),
    ("takt-blocks/Cargo.toml", include_str!("../../../blocks/Cargo.toml")),
    ("takt-blocks/src/alarm.rs", include_str!("../../../blocks/src/alarm.rs")),
    ("takt-blocks/src/biquad.rs", include_str!("../../../blocks/src/biquad.rs")),
    ("takt-blocks/src/bistable.rs", include_str!("../../../blocks/src/bistable.rs")),
    ("takt-blocks/src/counter.rs", include_str!("../../../blocks/src/counter.rs")),
    ("takt-blocks/src/dead_band.rs", include_str!("../../../blocks/src/dead_band.rs")),
    ("takt-blocks/src/delay.rs", include_str!("../../../blocks/src/delay.rs")),
    ("takt-blocks/src/edge.rs", include_str!("../../../blocks/src/edge.rs")),
    ("takt-blocks/src/fft.rs", include_str!("../../../blocks/src/fft.rs")),
    ("takt-blocks/src/fir.rs", include_str!("../../../blocks/src/fir.rs")),
    ("takt-blocks/src/hysteresis.rs", include_str!("../../../blocks/src/hysteresis.rs")),
    ("takt-blocks/src/lag.rs", include_str!("../../../blocks/src/lag.rs")),
    ("takt-blocks/src/lib.rs", include_str!("../../../blocks/src/lib.rs")),
    ("takt-blocks/src/limit.rs", include_str!("../../../blocks/src/limit.rs")),
    ("takt-blocks/src/math.rs", include_str!("../../../blocks/src/math.rs")),
    ("takt-blocks/src/multiplexer.rs", include_str!("../../../blocks/src/multiplexer.rs")),
    ("takt-blocks/src/pid.rs", include_str!("../../../blocks/src/pid.rs")),
    ("takt-blocks/src/ramp.rs", include_str!("../../../blocks/src/ramp.rs")),
    ("takt-blocks/src/scale.rs", include_str!("../../../blocks/src/scale.rs")),
    ("takt-blocks/src/second_order.rs", include_str!("../../../blocks/src/second_order.rs")),
    ("takt-blocks/src/statistics.rs", include_str!("../../../blocks/src/statistics.rs")),
    ("takt-blocks/src/time.rs", include_str!("../../../blocks/src/time.rs")),
    ("takt-blocks/src/timer.rs", include_str!("../../../blocks/src/timer.rs")),
];

const C: &[File] = &[
    ("Makefile", include_str!("../templates/c/Makefile.in")),
    ("tank.c", include_str!("../templates/c/tank.c.in")),
    ("tests/tank.csv", include_str!("../templates/tank.csv")),
    (".gitignore", "/build\n*.plc\n*.key\n"),
    ("README.md", include_str!("../templates/c/README.md")),
    ("takt-sdk/takt.h", include_str!("../../../sdk/c/takt.h")),
    ("takt-sdk/takt.c", include_str!("../../../sdk/c/takt.c")),
    ("takt-sdk/takt_math.c", include_str!("../../../sdk/c/takt_math.c")),
    ("takt-sdk/takt.mk", include_str!("../../../sdk/c/takt.mk")),
    ("takt-sdk/blocks.h", include_str!("../../../blocks/c/blocks.h")),
];

const STRUCTURED_TEXT: &[File] = &[
    ("main.st", include_str!("../templates/st/main.st")),
    ("takt-plc.toml", include_str!("../templates/st/takt-plc.toml")),
    ("tests/pi_test.st", include_str!("../templates/st/pi_test.st")),
    ("tests/tank.csv", include_str!("../templates/st/tank.csv")),
    (".gitignore", "*.plc\n*.key\n"),
    ("README.md", include_str!("../templates/st/README.md")),
];

impl New {
    pub fn run(self) -> Result<(), Failure> {
        let files = match self.lang {
            Language::Rust => RUST,
            Language::C => C,
            Language::St => STRUCTURED_TEXT,
        };
        let name = self.path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if !name.starts_with(|c: char| c.is_ascii_lowercase()) || !name.chars().all(good) {
            let allowed = "a name has small letters, digits and -, and begins with a letter";
            return Err(Failure::input(format!("found `{name}`; {allowed}")));
        }
        if self.path.exists() {
            return Err(Failure::input(format!("{} is there already", self.path.display())));
        }
        let around = self.path.parent().unwrap_or(Path::new(""));
        fs::create_dir_all(around).map_err(|error| {
            Failure::input(format!("cannot make {}: {error}", around.display()))
        })?;
        folder(&self.path, || {
            files.iter().try_for_each(|(file, text)| {
                // The SDK is taken as it is.
                let text = if file.starts_with("takt-sdk/") {
                    (*text).into()
                } else {
                    text.replace("NAME", name)
                };
                write(&self.path.join(file), &text)
            })
        })?;
        println!("{}: see README.md there", self.path.display());
        Ok(())
    }
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    // In the repository the SDK is a member of a workspace that the project is not in, and has tests.
    let mut tests = false;
    let text: String = text
        .lines()
        .filter(|line| {
            if line.starts_with('[') {
                tests = *line == "[dev-dependencies]";
            }
            !tests && !line.starts_with("workspace = ")
        })
        .flat_map(|line| [line, "\n"])
        .collect();
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)
        .and_then(|()| fs::write(path, text))
        .map_err(|error| Failure::input(format!("cannot write {}: {error}", path.display())))
}
