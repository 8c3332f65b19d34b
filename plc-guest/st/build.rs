//! Builds the block of functions that compiled programs call and that `takt-st` embeds. It is freestanding.

use std::path::Path;

#[path = "../second_cargo.rs"]
mod second_cargo;

fn main() {
    println!("cargo::rerun-if-changed=runtime");
    println!("cargo::rerun-if-changed=../.cargo");
    let target = second_cargo::out_folder().join("runtime");
    let built = second_cargo::build_in(Path::new("runtime"), &target, &["--locked"]);
    println!("cargo::rustc-env=TAKT_ST_RUNTIME={}", built.join("runtime").display());
}
