//! Passes the linker what makes a block of bytes without a C runtime, at the address of `link.ld`.

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
        "-Wl,--oformat=binary",
    ];
    for flag in flags {
        println!("cargo:rustc-link-arg-bins={flag}");
    }
    println!("cargo:rustc-link-arg-bins=-T{SCRIPT}");
}
