//! The place of an image has a whole one at each instant.

use std::env;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::process::{Command, Stdio};
use std::thread;

use super::*;

const CHILD: &str = "TAKT_TEST_KEEP";
const BYTES: usize = 200_000;

/// The content of a version: its number, so often that a write takes some time.
fn content(version: u8) -> Vec<u8> {
    vec![version; BYTES]
}

/// The version that a file is, if it is whole.
fn whole(path: &Path) -> Option<u8> {
    let bytes = fs::read(path).ok()?;
    let first = *bytes.first()?;
    (bytes.len() == BYTES && bytes.iter().all(|byte| *byte == first)).then_some(first)
}

#[test]
fn the_old_content_stays_beside_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let [path, link] = ["a.plc", "link.plc"].map(|name| folder.path().join(name));
    fs::write(&path, content(1)).unwrap();
    fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).unwrap();
    symlink(&path, &link).unwrap();
    for version in 2..5 {
        let previous = replace(&link, &content(version)).unwrap();
        assert_eq!((whole(&path), whole(&previous)), (Some(version), Some(version - 1)));
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }
}

/// The user and the group that own no file of a system.
const OVERFLOW: u32 = 65534;

/// Whether the test may give files away, as root may.
fn may_give_away(folder: &Path) -> bool {
    let file = folder.join("given");
    let given = fs::write(&file, []).and_then(|()| chown(&file, Some(OVERFLOW), None));
    fs::remove_file(&file).unwrap();
    given.is_ok()
}

/// A folder with an image; `None`, and a word, if the test may not give it away.
fn image_to_give_away() -> Option<(tempfile::TempDir, PathBuf)> {
    let folder = tempfile::tempdir().unwrap();
    if !may_give_away(folder.path()) {
        println!("not tested: only root can");
        return None;
    }
    let path = folder.path().join("a.plc");
    fs::write(&path, content(1)).unwrap();
    Some((folder, path))
}

#[test]
fn the_new_content_belongs_to_the_owner_of_the_old_one() {
    let Some((_folder, path)) = image_to_give_away() else { return };
    chown(&path, Some(OVERFLOW), Some(OVERFLOW)).unwrap();
    fs::set_permissions(&path, PermissionsExt::from_mode(0o640)).unwrap();
    replace(&path, &content(2)).unwrap();
    let found = fs::metadata(&path).unwrap();
    assert_eq!((found.uid(), found.gid(), found.mode() & 0o7777), (OVERFLOW, OVERFLOW, 0o640));
    assert_eq!(whole(&path), Some(2));
}

#[test]
fn a_content_that_could_not_belong_to_the_owner_is_refused() {
    let Some((folder, path)) = image_to_give_away() else { return };
    // Another user may write to the folder, and so could move files in it.
    fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o777)).unwrap();
    fs::set_permissions(&path, PermissionsExt::from_mode(0o666)).unwrap();
    let place = path.clone();
    let other_user = thread::spawn(move || {
        // SAFETY: the call takes numbers only. It changes the user of this thread, which ends soon: that of the process
        // is changed by the function of the C library, which asks all threads.
        let changed = unsafe { libc::syscall(libc::SYS_setresuid, -1, OVERFLOW, -1) };
        assert_eq!(changed, 0);
        replace(&place, &content(2)).unwrap_err()
    });
    let error = other_user.join().unwrap();
    assert!(matches!(error, Unwritten::Owner { user: 0, group: 0, .. }), "{error:?}");
    assert!(error.to_string().starts_with("it would not belong to user 0 and group 0 any more: "));
    assert_eq!(whole(&path), Some(1));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn clients_that_replace_a_file_at_the_same_time_put_whole_ones_in_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.plc");
    fs::write(&path, content(0)).unwrap();
    let previous = replace(&path, &content(1)).unwrap();
    let clients: Vec<_> = (1..=4)
        .map(|client| {
            let path = path.clone();
            thread::spawn(move || {
                for _ in 0..25 {
                    // The old content can be gone before it gets its second name. Then nothing is replaced.
                    let replaced = replace(&path, &content(client)).map(drop);
                    match replaced {
                        Ok(()) => {}
                        Err(Unwritten::Step(error)) if error.kind() == io::ErrorKind::NotFound => {}
                        Err(error) => panic!("{error}"),
                    }
                }
            })
        })
        .collect();
    while clients.iter().any(|client| !client.is_finished()) {
        assert!(whole(&path).is_some() && whole(&previous).is_some());
    }
    clients.into_iter().for_each(|client| client.join().unwrap());
    assert!(whole(&path).is_some() && whole(&previous).is_some());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn a_replacement_that_fails_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.plc");
    fs::write(&path, content(1)).unwrap();
    fs::create_dir(folder.path().join("a.plc.previous")).unwrap();
    replace(&path, &content(2)).unwrap_err();
    assert_eq!(whole(&path), Some(1));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

/// Replaces the file that is named by the environment for ever. It is no test of its own.
#[test]
fn replace_until_killed() {
    let Some(path) = env::var_os(CHILD).map(PathBuf::from) else { return };
    for version in (1..=u8::MAX).cycle() {
        println!("\nnext {version}");
        replace(&path, &content(version)).unwrap();
    }
}

#[test]
fn at_each_of_200_instants_at_which_it_is_killed_the_old_or_the_new_content_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.plc");
    fs::write(&path, content(0)).unwrap();
    let mut between = 0;
    for round in 0..200u32 {
        let mut child = Command::new(env::current_exe().unwrap())
            .args(["--exact", "commands::keep::tests::replace_until_killed", "--nocapture"])
            .env(CHILD, &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        // It is killed some instructions behind one of its lines.
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut seen = lines.map_while(Result::ok).filter(|line| line.starts_with("next "));
        assert!(seen.nth(round as usize % 5).is_some(), "it replaces the file");
        for instruction in 0..round * 7_919 % 200_000 {
            std::hint::black_box(instruction);
        }
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(whole(&path).is_some(), "round {round}");
        let previous = folder.path().join("a.plc.previous");
        // It is not there before the first step of the first replacement.
        assert!(whole(&previous).is_some() || !previous.exists(), "round {round}");
        between += u32::from(whole(&previous) == whole(&path));
    }
    // How many it is depends on the machine.
    println!("{between} of 200 kills came between the two renames");
    replace(&path, &content(7)).unwrap();
    assert_eq!(whole(&path), Some(7));
}
