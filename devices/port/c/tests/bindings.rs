//! The interface as its users have it: a program in C that is linked with the static library, and the Python package
//! over a shared library that is linked from it.

#[path = "../../tests/loopback/mod.rs"]
#[allow(dead_code, reason = "the damage to a folder is for other tests")]
mod loopback;

use std::path::{Path, PathBuf};
use std::process::Command;

use loopback::Loopback;

/// Cargo leaves the static library beside the test program.
fn library() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    let folder = program.parent().unwrap();
    let found = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let ours = found.filter(|path| {
        let name = path.file_name().unwrap().to_string_lossy();
        name.starts_with("libtakt_port_c") && name.ends_with(".a")
    });
    // Builds with other flags leave theirs.
    ours.max_by_key(|path| path.metadata().unwrap().modified().unwrap()).expect("the library")
}

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn run(command: &mut Command) {
    let output = command.output().expect("it starts");
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{told}", output.status);
}

/// Runs a program in C that is linked with the library, on such a folder.
fn c(program: &str, folder: &Loopback) {
    let source = here(program);
    let program = folder.path().join("program");
    let mut compile = Command::new("cc");
    compile.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-O1", "-I"]).arg(here("include"));
    compile.arg(source).arg(library()).arg("-o").arg(&program);
    run(compile.args(["-lpthread", "-ldl", "-lm", "-lgcc_s"]));
    run(Command::new(&program).arg(folder.path()));
}

#[test]
fn a_program_in_c_uses_all_of_it_and_is_refused_what_is_wrong() {
    c("tests/loopback.c", &Loopback::new());
}

/// Runs a program in Python with the package, on a folder whose ports have no owner yet.
fn python(program: &str, folder: &Loopback) {
    let shared = folder.path().join("libtakt_port.so");
    let mut link = Command::new("cc");
    link.args(["-shared", "-Wl,--whole-archive"]).arg(library()).arg("-Wl,--no-whole-archive");
    run(link.args(["-lpthread", "-ldl", "-lm", "-lgcc_s", "-o"]).arg(&shared));
    let mut python = Command::new("python3");
    python.arg(here(program)).arg(folder.path()).env("TAKT_PORT_LIBRARY", &shared);
    run(python.env("PYTHONPATH", here("../python")).env("PYTHONDONTWRITEBYTECODE", "1"));
}

#[test]
fn the_python_package_uses_all_of_it_and_is_refused_what_is_wrong() {
    python("tests/loopback.py", &Loopback::new());
}

#[test]
fn the_page_of_the_level_shows_nothing_old_as_good_and_no_browser_holds_up_another() {
    python("tests/level_page.py", &Loopback::new());
}

#[test]
fn a_port_with_the_longest_name_is_like_any_other() {
    let folder = Loopback::with_source(&"a".repeat(32));
    c("tests/long_name.c", &folder);
    python("tests/long_name.py", &folder);
}
