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
    // Of another kind, but somebody listens.
    let other = std::os::unix::net::UnixListener::bind(bench.path()).unwrap();
    let taken = |bench: &Bench| {
        let error = HostPorts::open(bench.channels, bench.clock.frequency, None).err().unwrap();
        error.to_string().contains("is there already")
    };
    assert!(taken(&bench));
    drop(other);
    fs::remove_file(bench.path()).unwrap();
    leave_behind(&bench.path());
    let ports = bench.open();
    assert!(taken(&bench), "a second Takt has taken the socket of the first");
    assert!(connect(&bench.path()).is_ok());
    drop(ports);
}

/// What a Takt that was killed leaves.
fn leave_behind(path: &Path) {
    let aside = path.with_extension("aside");
    let listener = Listener::bind(path).unwrap();
    fs::rename(path, &aside).unwrap();
    drop(listener);
    fs::rename(&aside, path).unwrap();
}

#[test]
fn nothing_else_that_has_the_path_is_touched() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let path = bench.path();
    let target = path.with_extension("target");
    let makers: [fn(&Path, &Path); 4] = [
        |path, _| fs::write(path, "precious").unwrap(),
        |path, _| fs::create_dir(path).unwrap(),
        |path, target| symlink(target, path).unwrap(),
        |path, target| {
            fs::remove_file(target).unwrap();
            leave_behind(target);
            symlink(target, path).unwrap();
        },
    ];
    fs::write(&target, "precious").unwrap();
    for make in makers {
        make(&path, &target);
        let before = fs::symlink_metadata(&path).unwrap().file_type();
        let error = HostPorts::open(bench.channels, bench.clock.frequency, None).err().unwrap();
        assert!(error.to_string().contains("is there already"), "{error}");
        assert_eq!(fs::symlink_metadata(&path).unwrap().file_type(), before);
        if before.is_dir() { fs::remove_dir(&path) } else { fs::remove_file(&path) }.unwrap();
    }
    assert!(target.exists());
}

#[test]
fn the_socket_of_somebody_else_is_not_removed_at_the_end() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let ports = bench.open();
    fs::remove_file(bench.path()).unwrap();
    fs::write(bench.path(), "precious").unwrap();
    drop(ports);
    assert_eq!(fs::read(bench.path()).unwrap(), b"precious");
}
