//! Builds what is embedded in `takt`: two PLC guests, the demonstration and the kernel that runs program images,
//! and the system calls that its threads may make.
//!
//! Guests are freestanding: a second cargo builds them, for the same target and with the same toolchain,
//! into this crate's own output folder. So a build of `takt` builds its guests too.

use std::path::Path;

#[path = "seccomp/compile.rs"]
mod seccomp;
#[path = "../plc-guest/second_cargo.rs"]
mod second_cargo;

fn main() {
    let out = second_cargo::out_folder();
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

    let arguments = ["--workspace", "--bin", "demo", "--bin", "kernel"];
    let images = second_cargo::build_in(guest, &out.join("plc-guest"), &arguments);
    println!("cargo::rustc-env=TAKT_PLC_DEMO={}", images.join("demo").display());
    println!("cargo::rustc-env=TAKT_PLC_KERNEL={}", images.join("kernel").display());
}
