//! A build script that needs a freestanding program builds it by a second cargo, and includes this file.
//!
//! Such a program has its own profile and link flags, so it cannot be a member of the workspace.

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

const TARGET: &str = "x86_64-unknown-linux-gnu";

/// The folder for what a build script makes.
pub fn out_folder() -> PathBuf {
    let Some(out) = env::var_os("OUT_DIR") else {
        panic!("OUT_DIR is not set: this is a cargo build script");
    };
    out.into()
}

/// Builds what `arguments` select of the cargo project in `folder`, in release, with this toolchain and without the
/// network. Returns the folder with the executable files, which is below `target`.
pub fn build_in(folder: &Path, target: &Path, arguments: &[&str]) -> PathBuf {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(folder).args(["build", "--release", "--offline"]).args(arguments);
    cargo.args(["--target", TARGET, "--target-dir"]).arg(target);
    // What this cargo tells its build scripts must not reach the other one: its flags and
    // wrappers are for the host's program, its CARGO_* variables for this crate.
    for (name, _) in env::vars_os().filter(|(name, _)| is_of_this_cargo(name)) {
        cargo.env_remove(name);
    }
    match cargo.status() {
        Ok(status) if status.success() => target.join(TARGET).join("release"),
        Ok(status) => panic!("the build in {} failed: {status}", folder.display()),
        Err(error) => panic!("cannot run cargo in {}: {error}", folder.display()),
    }
}

fn is_of_this_cargo(name: &OsString) -> bool {
    let text = name.to_string_lossy();
    let inherited = text.starts_with("CARGO") && text != "CARGO_HOME";
    inherited || text.starts_with("RUSTC") || text == "RUSTFLAGS" || text == "CLIPPY_ARGS"
}
