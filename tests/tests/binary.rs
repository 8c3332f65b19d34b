//! The program as it was linked: nothing that is called is missing, and no hook of tests is in it.
//!
//! The standard library declares some functions of the C library weak, for systems that lack them, and
//! looks whether they are there before it calls them. With optimisation across all crates one such
//! declaration may be all that is left of a function that Takt itself calls without looking. The linker
//! takes nothing out of a static library for a weak name, so the function is at address 0.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::root;

/// Weak names of the standard library (`std::sys::pal::unix::weak`), which it calls if they are there.
const LOOKED_FOR: [&str; 9] = [
    "gettid",
    "gnu_get_libc_version",
    "pidfd_getpid",
    "pidfd_spawnp",
    "posix_spawn_file_actions_addchdir",
    "posix_spawn_file_actions_addchdir_np",
    "copy_file_range",
    "getrandom",
    "statx",
];

/// Takt, which is the same for each suite of Debian.
fn takt(build: &str) -> PathBuf {
    root().join("target/x86_64-unknown-linux-gnu").join(build).join("takt")
}

#[test]
fn what_is_not_linked_is_only_what_is_looked_for_before_it_is_called() {
    let program = takt("release");
    let output = Command::new("nm").arg(&program).output().expect("nm (binutils) starts");
    assert!(output.status.success(), "{output:?}");
    let names = String::from_utf8(output.stdout).unwrap();
    assert!(names.lines().count() > 1000, "it has no symbols left to look at");
    let missing = names.lines().filter_map(|line| {
        let (kind, name) = line.trim_start().split_once(' ')?;
        ["w", "v", "U"].contains(&kind).then_some(name)
    });
    let unknown: Vec<&str> = missing
        // These are the C library's and the compiler's own, which look before they call.
        .filter(|name| !name.starts_with('_'))
        .filter(|name| !LOOKED_FOR.contains(name))
        .collect();
    assert!(unknown.is_empty(), "called or not, these are at address 0: {unknown:?}");
}

#[test]
fn no_source_calls_what_the_standard_library_declares_weak() {
    let mut sources = 0;
    for folder in ["vmm", "scheduler", "devices"] {
        check(&root().join(folder), &mut sources);
    }
    assert!(sources > 200, "only {sources} sources");
}

/// What finds the hooks of `vmm/src/hooks/present.rs` in a program: an option, a word or a message of each.
const HOOKS: [&str; 9] = [
    "without-kick",
    "loud-windows",
    "more-processors",
    "panic-after",
    "late-wake-up",
    "provoke-syscall",
    "fail-at",
    "TAKT_STEERED",
    "TEST: ",
];

#[test]
fn what_users_get_has_no_hook_of_tests() {
    let has = |build: &str, name: &str| {
        let program = fs::read(takt(build)).unwrap();
        program.windows(name.len()).any(|bytes| bytes == name.as_bytes())
    };
    let in_release: Vec<&str> = HOOKS.into_iter().filter(|name| has("release", name)).collect();
    assert!(in_release.is_empty(), "{in_release:?}");
    // The names are what one has to look for.
    let unknown: Vec<&str> = HOOKS.into_iter().filter(|name| !has("hooks", name)).collect();
    assert!(unknown.is_empty(), "{unknown:?}");
}

fn check(folder: &Path, sources: &mut usize) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            check(&path, sources);
        } else if path.extension().is_some_and(|e| e == "rs") {
            *sources += 1;
            let text = fs::read_to_string(&path).unwrap();
            for name in LOOKED_FOR {
                let called = text.contains(&format!("libc::{name}("));
                assert!(!called, "{} calls libc::{name}: use libc::syscall", path.display());
            }
        }
    }
}
