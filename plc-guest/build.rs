//! Passes the linker what makes an image without a C runtime, at the addresses of `link.ld`.
//!
//! The flags are given for binaries only, so that the library's tests link as ordinary host
//! programs. The kernel, a package below this one, is linked in the same way.

use std::path::Path;

fn main() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let script = package.ancestors().map(|folder| folder.join("link.ld")).find(|s| s.exists());
    let Some(script) = script else {
        panic!("no link.ld in {} or above", package.display());
    };
    let script = script.display();
    println!("cargo:rerun-if-changed=build.rs");
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
