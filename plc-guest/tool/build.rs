//! Builds the object file with mathematical functions that the tool links into control programs in C.

use std::path::Path;

#[path = "../second_cargo.rs"]
mod second_cargo;

/// The archive has the whole of Rust's core library. The object file has only what the functions need.
const OBJECT: &str = r#"target.x86_64-unknown-linux-gnu.rustflags=["--emit=obj"]"#;

fn main() {
    println!("cargo::rerun-if-changed=math");
    println!("cargo::rerun-if-changed=../.cargo");
    let target = second_cargo::out_folder().join("math");
    let arguments = ["--locked", "--config", OBJECT];
    let built = second_cargo::build_in(Path::new("math"), &target, &arguments);
    let parts = std::fs::read_dir(built.join("deps")).into_iter().flatten().flatten();
    let objects = parts.map(|part| part.path()).filter(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("takt_math-") && name.ends_with(".o")
    });
    // Of an older compiler there may be another one.
    let newest = objects.max_by_key(|path| path.metadata().and_then(|data| data.modified()).ok());
    let Some(object) = newest else {
        panic!("no object file of takt-math is in {}", built.display());
    };
    println!("cargo::rustc-env=TAKT_MATH={}", object.display());
}
