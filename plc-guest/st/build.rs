//! Builds the block of functions that compiled programs call and that `takt-st` embeds.
//!
//! It is freestanding and has its own flags, so a second cargo builds it, with the same toolchain,
//! into this crate's own output folder.

use std::env;
use std::path::PathBuf;
use std::process::Command;

const TARGET: &str = "x86_64-unknown-linux-gnu";

fn main() {
    let Some(out) = env::var_os("OUT_DIR").map(PathBuf::from) else {
        panic!("OUT_DIR is not set: this is a cargo build script");
    };
    println!("cargo::rerun-if-changed=runtime");
    println!("cargo::rerun-if-changed=../.cargo");
    let target_dir = out.join("runtime");
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir("runtime").args(["build", "--release", "--offline", "--locked"]);
    cargo.args(["--target", TARGET, "--target-dir"]).arg(&target_dir);
    // What this cargo tells its build scripts must not reach the other one: its flags and
    // wrappers are for the host's program, its CARGO_* variables for this crate.
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        let inherited = text.starts_with("CARGO") && text != "CARGO_HOME";
        if inherited || text.starts_with("RUSTC") || text == "RUSTFLAGS" || text == "CLIPPY_ARGS" {
            cargo.env_remove(&name);
        }
    }
    match cargo.status() {
        Ok(status) if status.success() => {}
        Ok(status) => panic!("building the runtime of Structured Text failed: {status}"),
        Err(error) => panic!("cannot run cargo for the runtime of Structured Text: {error}"),
    }
    let image = target_dir.join(TARGET).join("release/runtime");
    println!("cargo::rustc-env=TAKT_ST_RUNTIME={}", image.display());
}
