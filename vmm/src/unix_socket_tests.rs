//! The file of a socket: who may use it, and what is replaced or removed.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::net::UnixListener;

use vmm_sys_util::tempdir::TempDir;

use super::*;

/// A test for each kind of sockets, with a path in a folder of its own.
fn each_kind(test: impl Fn(&Path, SocketKind)) {
    for kind in [SocketKind::Stream, SocketKind::Packets] {
        let folder = TempDir::new().unwrap();
        test(&folder.as_path().join("takt.sock"), kind);
    }
}

/// What a process that was killed leaves.
fn leave_behind(path: &Path, kind: SocketKind) {
    let aside = path.with_extension("aside");
    let listener = Listener::bind(path, kind).unwrap();
    fs::rename(path, &aside).unwrap();
    drop(listener);
    fs::rename(&aside, path).unwrap();
}

#[test]
fn the_socket_is_its_owners_alone_and_goes_with_the_listener() {
    each_kind(|path, kind| {
        let listener = Listener::bind(path, kind).unwrap();
        let file = fs::symlink_metadata(path).unwrap();
        assert!(file.file_type().is_socket());
        assert_eq!(file.permissions().mode() & 0o777, 0o600);
        assert!(listener.accept().is_none(), "there is no client yet");
        let _client = connect(path, kind).unwrap();
        assert!(listener.accept().is_some());
        drop(listener);
        assert!(!path.exists());
    });
}

#[test]
fn what_a_dead_process_left_is_replaced_whatever_its_kind() {
    each_kind(|path, kind| {
        for left in [SocketKind::Stream, SocketKind::Packets] {
            leave_behind(path, left);
            drop(Listener::bind(path, kind).unwrap());
        }
    });
}

#[test]
fn what_somebody_listens_to_stays_whatever_its_kind() {
    each_kind(|path, kind| {
        let refused = || Listener::bind(path, kind).map(drop);
        let own = Listener::bind(path, kind).unwrap();
        assert!(matches!(refused(), Err(SocketError::InUse(_))), "{:?}", refused());
        // Nor is it taken for dead when it has no room for one more.
        let clients: Vec<_> = std::iter::from_fn(|| connect(path, kind).ok()).take(100).collect();
        assert!(clients.len() < 100);
        assert!(matches!(refused(), Err(SocketError::InUse(_))), "{:?}", refused());
        drop(own);
        let _other = UnixListener::bind(path).unwrap();
        assert!(matches!(refused(), Err(SocketError::InUse(_))), "{:?}", refused());
    });
}

#[test]
fn nothing_else_that_has_the_path_is_touched() {
    each_kind(|path, kind| {
        let refused = |path: &Path| {
            let refused = Listener::bind(path, kind).map(drop);
            assert!(matches!(refused, Err(SocketError::NotASocket(_))), "{refused:?}");
        };
        fs::write(path, "valuable").unwrap();
        refused(path);
        assert_eq!(fs::read(path).unwrap(), b"valuable");
        refused(path.parent().unwrap());
        let dead = path.with_extension("dead");
        leave_behind(&dead, kind);
        let link = path.with_extension("link");
        symlink(&dead, &link).unwrap();
        refused(&link);
        assert!(dead.exists() && link.is_symlink());
        fs::remove_file(&link).unwrap();
        symlink(path, &link).unwrap();
        refused(&link);
        assert!(link.is_symlink());
    });
}

#[test]
fn the_socket_of_another_is_not_removed_at_the_end() {
    each_kind(|path, kind| {
        let first = Listener::bind(path, kind).unwrap();
        fs::remove_file(path).unwrap();
        let _second = Listener::bind(path, kind).unwrap();
        drop(first);
        assert!(path.exists());
    });
}

#[test]
fn a_path_that_cannot_be_is_an_error() {
    each_kind(|path, kind| {
        let long = path.with_file_name("x".repeat(SOCKET_PATH_MAX));
        for path in [long, path.join("no/such/folder")] {
            let refused = Listener::bind(&path, kind).map(drop);
            assert!(matches!(refused, Err(SocketError::Host { .. })), "{refused:?}");
        }
    });
}
