//! The socket: when it is there, for whom, and when it goes.

use std::io::{BufRead, BufReader, Write};
use std::sync::mpsc;
use std::thread;

use super::*;
use crate::inside;

/// A folder of its own.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("takt-carry-{}-{name}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).unwrap();
    path
}

#[test]
fn only_a_socket_without_a_listener_is_replaced() {
    let folder = folder("replace");
    let (line, socket) = (folder.join("line"), folder.join("takt.sock"));
    fs::write(&socket, "a file").unwrap();
    let error = prepare(&line, &socket).unwrap_err().to_string();
    assert!(error.ends_with("there is a file that is no socket"), "{error}");
    assert!(!line.exists());
    fs::remove_file(&socket).unwrap();

    let listener = UnixListener::bind(&socket).unwrap();
    let error = prepare(&line, &socket).unwrap_err().to_string();
    assert!(error.ends_with("another program listens there"), "{error}");
    drop(listener);
    prepare(&line, &socket).unwrap();
    assert!(!socket.exists() && line.exists());
    // The next run has a line of its own.
    assert!(prepare(&line, &socket).unwrap_err().to_string().starts_with("cannot make the line"));
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_file_that_is_no_line_is_refused() {
    let folder = folder("line");
    let line = folder.join("line");
    fs::write(&line, vec![0; crate::BYTES]).unwrap();
    let error = Line::open(&line, Side::Inside).err().unwrap().to_string();
    assert!(error.contains("none of this version"), "{error}");
    fs::write(&line, "short").unwrap();
    assert!(matches!(Line::open(&line, Side::Inside), Err(LineError::Short { .. })));
    fs::remove_dir_all(folder).unwrap();
}

/// A Takt that answers each line with the line, at once.
fn takt(socket: &Path) -> thread::JoinHandle<()> {
    let listener = UnixListener::bind(socket).unwrap();
    thread::spawn(move || {
        // The inside end, and a client.
        let clients: Vec<_> = (0..2)
            .map(|_| {
                let (stream, _) = listener.accept().unwrap();
                thread::spawn(move || {
                    let mut answers = stream.try_clone().unwrap();
                    for line in BufReader::new(stream).lines() {
                        let line = line.unwrap();
                        if line == "end" {
                            return;
                        }
                        if answers.write_all((line + "\n").as_bytes()).is_err() {
                            return;
                        }
                    }
                })
            })
            .collect();
        drop(listener);
        let mut clients = clients.into_iter();
        let pace = clients.next();
        // The client first: with it Takt ends.
        clients.for_each(|client| client.join().unwrap());
        drop(pace);
    })
}

#[test]
fn an_end_that_opens_the_line_late_is_told_that_takt_answers() {
    let folder = folder("late");
    let (line, socket) = (folder.join("line"), folder.join("outside.sock"));
    let takts = folder.join("takt.sock");
    prepare(&line, &socket).unwrap();
    let takt = UnixListener::bind(&takts).unwrap();
    let inside = thread::spawn({
        let line = line.clone();
        move || inside::run(&line, &takts)
    });
    let (mut pace, _) = takt.accept().unwrap();
    let mut pings = BufReader::new(pace.try_clone().unwrap()).lines();
    let mut answer = || pace.write_all((pings.next().unwrap().unwrap() + "\n").as_bytes()).unwrap();
    // With the third ping the turn after the first is over, and all that the inside end says by itself is said.
    (0..3).for_each(|_| answer());
    let (end, ends) = UnixStream::pair().unwrap();
    let outside = thread::spawn({
        let (mut end, socket) = (end, socket.clone());
        move || run(&line, &socket, &mut end)
    });
    while !socket.exists() {
        assert!(!outside.is_finished(), "the outside end has ended");
        answer();
    }
    drop(ends);
    outside.join().unwrap().unwrap();
    drop((pace, pings));
    inside.join().unwrap().unwrap();
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn both_ends_carry_a_client_to_takt_and_the_socket_goes_at_the_end() {
    let folder = folder("both");
    let (line, socket) = (folder.join("line"), folder.join("outside.sock"));
    let takts = folder.join("takt.sock");
    prepare(&line, &socket).unwrap();
    let (end, ends) = UnixStream::pair().unwrap();
    let (told, result) = mpsc::channel();
    let outside = thread::spawn({
        let (line, socket) = (line.clone(), socket.clone());
        move || {
            let mut end = end;
            told.send(run(&line, &socket, &mut end)).unwrap();
        }
    });
    assert!(!socket.exists(), "no Takt answers yet");
    let takt = takt(&takts);
    thread::spawn({
        let line = line.clone();
        move || inside::run(&line, &takts)
    });
    // The socket is there as soon as Takt has answered.
    let mut client = loop {
        match UnixStream::connect(&socket) {
            Ok(client) => break client,
            Err(_) => {
                assert!(result.try_recv().is_err(), "the outside end has ended");
                thread::yield_now();
            }
        }
    };
    client.write_all(b"hello\n").unwrap();
    let mut lines = BufReader::new(client.try_clone().unwrap());
    let mut answer = String::new();
    lines.read_line(&mut answer).unwrap();
    assert_eq!(answer, "hello\n");
    client.write_all(b"end\n").unwrap();
    answer.clear();
    assert_eq!(lines.read_line(&mut answer).unwrap(), 0, "Takt has ended: {answer}");
    takt.join().unwrap();

    drop(ends);
    outside.join().unwrap();
    result.recv().unwrap().unwrap();
    assert!(!socket.exists());
    fs::remove_dir_all(folder).unwrap();
}
