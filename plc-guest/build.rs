//! Passes the linker what makes an image without a C runtime, at the addresses of `link.ld`.
//!
//! The flags are given for binaries only, so that the library's tests link as ordinary host
//! programs. The kernel, a package below this one, is linked in the same way.

use std::env;
use std::path::PathBuf;

fn main() {
    // Asked for when it runs: a folder that was moved, or is built elsewhere, is not where it was compiled.
    let Some(package) = env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from) else {
        panic!("CARGO_MANIFEST_DIR is not set: this is a cargo build script");
    };
    let script = package.ancestors().map(|folder| folder.join("link.ld")).find(|s| s.exists());
    let Some(script) = script else {
        panic!("no link.ld in {} or above", package.display());
    };
    println!("cargo:rerun-if-changed={}", script.with_file_name("build.rs").display());
    let script = script.display();
    println!("cargo:rerun-if-changed={script}");
    let flags = [
        "-nostdlib",
        "-nostartfiles",
        "-static",
        "-no-pie",
        "-Wl,--build-id=none",
        "-Wl,--gc-sections",
        "-Wl,-z,norelro",
        "-Wl,-z,max-page-size=0x1000",
    ];
    for flag in flags {
        println!("cargo:rustc-link-arg-bins={flag}");
    }
    println!("cargo:rustc-link-arg-bins=-T{script}");
}
