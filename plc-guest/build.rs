//! Passes the linker what makes an image without a C runtime, at the addresses of `link.ld`.
//!
//! The flags are given for binaries only, so that the library's tests link as ordinary host
//! programs.

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/link.ld");

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed={SCRIPT}");
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
    println!("cargo:rustc-link-arg-bins=-T{SCRIPT}");
}
