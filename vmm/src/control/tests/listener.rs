use std::fs;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::UnixListener;

use super::super::listener::{PATH_MAX, SocketError};
use super::{Folder, Listener};

#[test]
fn the_socket_is_its_owners_alone_and_goes_with_the_listener() {
    let folder = Folder::new();
    let listener = Listener::bind(&folder.socket()).unwrap();
    let file = fs::symlink_metadata(folder.socket()).unwrap();
    assert!(file.file_type().is_socket());
    assert_eq!(file.permissions().mode() & 0o777, 0o600);
    assert!(listener.accept().is_none(), "it waits for nobody");
    drop(listener);
    assert!(!folder.socket().exists());
}

#[test]
fn what_a_dead_process_left_is_replaced_and_nothing_else() {
    let folder = Folder::new();
    // The standard library does not remove the file.
    drop(UnixListener::bind(folder.socket()).unwrap());
    assert!(folder.socket().exists());
    let listener = Listener::bind(&folder.socket()).unwrap();
    let refused = Listener::bind(&folder.socket()).map(drop);
    assert!(matches!(refused, Err(SocketError::InUse(_))), "{refused:?}");
    drop(listener);

    fs::write(folder.socket(), "valuable").unwrap();
    let refused = Listener::bind(&folder.socket()).map(drop);
    assert!(matches!(refused, Err(SocketError::NotASocket(_))), "{refused:?}");
    assert_eq!(fs::read(folder.socket()).unwrap(), b"valuable");
    let refused = Listener::bind(&folder.0).map(drop);
    assert!(matches!(refused, Err(SocketError::NotASocket(_))), "{refused:?}");
}

#[test]
fn the_socket_of_another_is_not_removed_at_the_end() {
    let folder = Folder::new();
    let first = Listener::bind(&folder.socket()).unwrap();
    fs::remove_file(folder.socket()).unwrap();
    let _second = Listener::bind(&folder.socket()).unwrap();
    drop(first);
    assert!(folder.socket().exists());
}

#[test]
fn a_path_that_cannot_be_is_an_error() {
    let folder = Folder::new();
    let long = folder.0.join("x".repeat(PATH_MAX));
    for path in [long, folder.0.join("no/such/folder")] {
        let refused = Listener::bind(&path).map(drop);
        assert!(matches!(refused, Err(SocketError::Host { .. })), "{refused:?}");
    }
}
