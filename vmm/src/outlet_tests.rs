//! Tests of outlets, with readers that stop and disks that fail.

use std::io::{PipeReader, Read};
use std::os::fd::OwnedFd;

use super::*;

/// An outlet into a pipe, and the pipe's other end. Its capacity is a page.
fn piped(quotas: &[usize]) -> (Outlet, PipeReader) {
    let (reader, writer) = io::pipe().unwrap();
    // SAFETY: changes the size of the pipe's buffer.
    let size = unsafe { libc::fcntl(writer.as_raw_fd(), libc::F_SETPIPE_SZ, 4096) };
    assert_eq!(size, 4096);
    let sink = StandardOutput(ManuallyDrop::new(File::from(OwnedFd::from(writer))));
    (started(quotas, sink), reader)
}

fn started(quotas: &[usize], sink: impl Sink) -> Outlet {
    let (outlet, work) = Outlet::new(quotas, sink);
    std::thread::spawn(work);
    outlet
}

/// Longer than any test may need; reached only if one fails.
const LONG: Duration = Duration::from_secs(60);

#[test]
fn a_push_never_waits_and_what_was_accepted_comes_in_order_and_whole() {
    let (outlet, mut reader) = piped(&[16 << 10, 16 << 10]);
    let (mut accepted, mut refused) = (Vec::new(), 0);
    // The other end is not read: this would not come to an end if a push waited.
    for n in 0..10_000u32 {
        let piece = format!("line {n}\n");
        match outlet.push((n % 2) as usize, piece.as_bytes()) {
            Ok(()) => accepted.extend(piece.into_bytes()),
            Err(Full) => refused += piece.len(),
        }
    }
    let all: usize = (0..10_000).map(|n| format!("line {n}\n").len()).sum();
    assert!(refused > 0);
    assert_eq!(accepted.len() + refused, all);
    // Two lanes, what the pipe holds, and the piece that is being written.
    assert!(accepted.len() < (32 << 10) + 4096 + STEP, "{}", accepted.len());
    let mut seen = vec![0; accepted.len()];
    reader.read_exact(&mut seen).unwrap();
    assert!(seen == accepted);
    assert!(outlet.settle(LONG, LONG));
    assert_eq!((outlet.waiting(), outlet.written()), (0, accepted.len() as u64));
}

#[test]
fn who_fills_a_lane_takes_nothing_of_another() {
    let (outlet, _reader) = piped(&[1000, 8192]);
    while outlet.push(1, &[b'x'; 512]).is_ok() {}
    assert!(outlet.push(1, &[b'x'; 512]).is_err());
    assert_eq!(outlet.room(0), 1000 - OVERHEAD);
    assert_eq!(outlet.push(0, &[b'y'; 1000 - OVERHEAD]), Ok(()));
    assert_eq!((outlet.push(0, b"y"), outlet.room(0)), (Err(Full), 0));
}

#[test]
fn small_pieces_are_bounded_too() {
    let (outlet, _reader) = piped(&[8192]);
    let mut accepted = 0;
    while accepted < 1_000_000 && outlet.push(0, b"x").is_ok() {
        accepted += 1;
    }
    // Those that the pipe has taken have left the queue.
    assert!(accepted <= 4096 + 8192 / OVERHEAD + 1, "{accepted}");
}

#[test]
fn the_end_waits_for_a_reader_that_reads_and_not_for_one_that_does_not() {
    let (outlet, mut reader) = piped(&[64 << 10]);
    for _ in 0..8 {
        outlet.push(0, &[b'x'; 4096]).unwrap();
    }
    let begun = Instant::now();
    assert!(!outlet.settle(Duration::from_millis(5), LONG));
    assert!(begun.elapsed() < LONG, "it waited for a reader that has stopped");
    assert!(outlet.waiting() > 0);
    let slow = std::thread::spawn(move || {
        let mut seen = [0; 8 * 4096];
        reader.read_exact(&mut seen).unwrap();
    });
    assert!(outlet.settle(LONG, LONG));
    slow.join().unwrap();
}

#[test]
fn the_end_comes_also_if_the_reader_is_endlessly_slow() {
    let (outlet, mut reader) = piped(&[1 << 20]);
    while outlet.push(0, &[b'x'; 4096]).is_ok() {}
    let most = Duration::from_millis(100);
    let (stop, stopped) = channel::<()>();
    let slow = std::thread::spawn(move || {
        while stopped.recv_timeout(Duration::from_millis(2)) == Err(RecvTimeoutError::Timeout) {
            reader.read_exact(&mut [0; 16]).unwrap();
        }
    });
    assert!(!outlet.settle(LONG, most));
    drop(stop);
    slow.join().unwrap();
}

#[test]
fn a_reader_that_is_gone_costs_what_is_written_and_nothing_else() {
    let (outlet, reader) = piped(&[8192]);
    drop(reader);
    for _ in 0..100 {
        outlet.push(0, b"no reader takes this").unwrap();
        assert!(outlet.settle(LONG, LONG));
    }
    assert_eq!((outlet.waiting(), outlet.written()), (0, 0));
    assert_eq!(outlet.unwritten(), 100 * b"no reader takes this".len() as u64);
    assert_eq!(outlet.take_error().unwrap().kind(), ErrorKind::BrokenPipe);
}

#[test]
fn a_descriptor_that_does_not_wait_loses_nothing() {
    let (reader, writer) = io::pipe().unwrap();
    // SAFETY: makes writes to the pipe fail instead of waiting.
    let set = unsafe { libc::fcntl(writer.as_raw_fd(), libc::F_SETFL, libc::O_NONBLOCK) };
    assert_eq!(set, 0);
    let sink = StandardOutput(ManuallyDrop::new(File::from(OwnedFd::from(writer))));
    let outlet = started(&[1 << 20], sink);
    let bytes: Vec<u8> = (0..200_000u32).map(|n| n as u8).collect();
    outlet.push(0, &bytes).unwrap();
    let mut seen = vec![0; bytes.len()];
    (&reader).read_exact(&mut seen).unwrap();
    assert!(seen == bytes);
}

#[test]
fn a_file_ends_at_its_first_error() {
    let read_only = File::open("/dev/null").unwrap();
    let outlet = started(&[8192], read_only);
    outlet.push(0, b"one").unwrap();
    assert!(outlet.settle(LONG, LONG));
    assert!(outlet.take_error().is_some());
    assert!(outlet.has_ended());
    assert_eq!(outlet.push(0, b"two"), Err(Full));
    assert_eq!((outlet.unwritten(), outlet.pieces(), outlet.waiting()), (3, 0, 0));
}

#[test]
fn a_last_line_waits_for_no_reader() {
    let (mut reader, writer) = io::pipe().unwrap();
    let mut output = File::from(OwnedFd::from(writer));
    last_line(&mut output, "CPU 1 is back");
    let mut line = [0; 21];
    reader.read_exact(&mut line).unwrap();
    assert_eq!(&line, b"[takt] CPU 1 is back\n");
    // SAFETY: changes the size of the pipe's buffer.
    let size = unsafe { libc::fcntl(output.as_raw_fd(), libc::F_SETPIPE_SZ, 4096) };
    assert_eq!(size, 4096);
    output.write_all(&[b'x'; 4096]).unwrap();
    // This would not come to an end if it waited.
    last_line(&mut output, "CPU 2 is back");
    drop(output);
    let mut rest = Vec::new();
    reader.read_to_end(&mut rest).unwrap();
    assert_eq!(rest, [b'x'; 4096]);
}

#[test]
fn a_wait_for_room_goes_on_behind_signals() {
    use std::os::unix::thread::JoinHandleExt;
    crate::vcpu::kick::install().unwrap();
    let (mut reader, mut writer) = io::pipe().unwrap();
    // SAFETY: changes the size of the pipe's buffer.
    assert_eq!(unsafe { libc::fcntl(writer.as_raw_fd(), libc::F_SETPIPE_SZ, 4096) }, 4096);
    writer.write_all(&[0; 4096]).unwrap();
    let waits = std::thread::spawn(move || has_room_within(&writer, LONG));
    for _ in 0..1_000 {
        // SAFETY: the thread has not been joined, and the signal has a handler.
        assert_eq!(unsafe { libc::pthread_kill(waits.as_pthread_t(), libc::SIGURG) }, 0);
        std::thread::yield_now();
    }
    reader.read_exact(&mut [0; 4096]).unwrap();
    assert!(waits.join().unwrap());
}
