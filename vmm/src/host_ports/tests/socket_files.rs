//! The socket as a file: whose it is, and what it may replace.

use super::*;

#[test]
fn the_socket_is_its_owners_and_goes_with_the_run() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let ports = bench.open();
    let mode = fs::symlink_metadata(bench.path()).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o600);
    drop(ports);
    assert!(!bench.path().exists());
    assert!(fs::read_dir(bench.folder.as_path()).unwrap().next().is_none());
}

#[test]
fn a_socket_that_was_left_behind_is_replaced_and_one_in_use_is_not() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let taken = |bench: &Bench| {
        let error =
            HostPorts::open(bench.channels, bench.clock.frequency, None, &spawn).err().unwrap();
        error.to_string().contains("another program listens there")
    };
    leave_behind(&bench.path());
    let ports = bench.open();
    assert!(taken(&bench), "a second Takt has taken the socket of the first");
    assert!(connect(&bench.path()).is_ok());
    drop(ports);
}

/// What a Takt that was killed leaves.
fn leave_behind(path: &Path) {
    let aside = path.with_extension("aside");
    let listener = Listener::bind(path, SocketKind::Packets).unwrap();
    fs::rename(path, &aside).unwrap();
    drop(listener);
    fs::rename(&aside, path).unwrap();
}
