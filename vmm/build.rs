//! Builds what is embedded in `takt`: two PLC guests, the demonstration and the kernel that runs program images,
//! and the system calls that its threads may make.
//!
//! Guests are freestanding and have their own profile and link flags, so they cannot be members of
//! this workspace: they are built by a second cargo, for the same target and with the same toolchain,
//! into this crate's own output folder. Whoever builds `takt` has thereby built the guest.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

#[path = "seccomp/compile.rs"]
mod seccomp;

const TARGET: &str = "x86_64-unknown-linux-gnu";

fn main() {
    let Some(out) = env::var_os("OUT_DIR").map(PathBuf::from) else {
        panic!("OUT_DIR is not set: this is a cargo build script");
    };
    seccomp::compile(Path::new("seccomp"), &out);
    let guest = Path::new("../plc-guest");
    let crates = [
        "../devices/abi",
        "../devices/channel",
        "../devices/sja1000",
        "../plc-guest/kernel",
        "../plc-guest/program",
    ];
    for watched in crates.map(Path::new).into_iter().chain([guest]) {
        for inner in ["src", "build.rs", "Cargo.toml", "Cargo.lock", "link.ld", ".cargo"] {
            let path = watched.join(inner);
            if path.exists() {
                println!("cargo::rerun-if-changed={}", path.display());
            }
        }
    }

    let target_dir = out.join("plc-guest");
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(guest).args(["build", "--release", "--offline", "--workspace"]);
    cargo.args(["--bin", "demo", "--bin", "kernel"]);
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
        Ok(status) => panic!("building the PLC guest failed: {status}"),
        Err(error) => panic!("cannot run cargo for the PLC guest: {error}"),
    }
    let images = target_dir.join(TARGET).join("release");
    println!("cargo::rustc-env=TAKT_PLC_DEMO={}", images.join("demo").display());
    println!("cargo::rustc-env=TAKT_PLC_KERNEL={}", images.join("kernel").display());
}
