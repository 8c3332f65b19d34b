//! Ends that are a file.
//!
//! A recording outlives the run, and a file to send from makes a run repeatable. Both have the
//! same form, header and message one behind the other, so that a recording can be sent again.
//!
//! A disk may take its time, for ever if it likes, so each file has a thread that reads or writes it. What
//! is to be written waits in an [`Outlet`]; without room there the message stays in its channel, whose own
//! rules then say what is overwritten or refused, and count it. What is to be sent is read ahead, as
//! much as one tick can send.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

use takt_scheduler::time::Timebase;
use thiserror::Error;

use super::budget::{self, Budget};
use super::ends::{Destination, Now, Source};
use super::packet::{HEADER, Header};
use crate::outlet::{Outlet, Sink};

/// Why a file's part in the run is over before the run is.
#[derive(Debug, Error)]
pub enum Broken {
    /// The disk is full, or worse.
    #[error("cannot write any more: {0}")]
    Write(io::Error),
    /// The disk takes nothing more, for now or for ever.
    #[error("the disk takes too long: {0} records are not in the file")]
    Stalled(u64),
    /// The disk fails.
    #[error("cannot read any more: {0}")]
    Read(io::Error),
    /// A record says that its message has a length that no message of the channel has.
    #[error("record {number} says that its message has {length} bytes; allowed are 1 to {maximum}")]
    Length {
        /// Counted from 1.
        number: u64,
        /// What it says, in bytes.
        length: u32,
        /// What is allowed.
        maximum: usize,
    },
    /// The file ends within a record.
    #[error("record {0} is cut off")]
    Cut(u64),
}

/// The lane of an outlet that has one.
const LANE: usize = 0;
/// Records that wait for a disk: two ticks' worth, or some of the longest.
const RECORDS_BYTES: usize = 512 << 10;

/// Where the length is in a record's header, as its last part.
const LENGTH_AT: u64 = HEADER as u64 - 4;
/// Longest recording that is looked through at the start of a run, which waits for that: some seconds.
const LOOKED_THROUGH_BYTES: u64 = 256 << 20;

/// A file that records are appended to, each whole or not at all.
pub struct Recording {
    file: File,
    /// Up to where it is whole.
    length: u64,
}

impl Recording {
    /// Opens the file, or makes it, for its owner only (mode 0600).
    ///
    /// # Errors
    /// If it is none that can be appended to.
    pub fn open(path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        // Opening a pipe would wait for its reader.
        options.append(true).create(true).mode(0o600).custom_flags(libc::O_NONBLOCK);
        let file = options.open(path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Err(io::Error::new(ErrorKind::InvalidInput, "it is not a regular file"));
        }
        Ok(Self { file, length: metadata.len() })
    }

    /// As [`open`](Self::open), for records with messages of at most `maximum` bytes. A run that was cut off may have left a
    /// part of a record, or zeros in its place: that is taken away, since a later one must not lie behind it. Gives how many bytes
    /// it had; `None` if the file is too long to be looked through.
    ///
    /// # Errors
    /// Also if the file has other things than such records; then nothing is taken away.
    pub fn open_records(path: &Path, maximum: usize) -> io::Result<(Self, Option<u64>)> {
        let mut this = Self::open(path)?;
        if this.length > LOOKED_THROUGH_BYTES {
            return Ok((this, None));
        }
        let mut records = BufReader::new(OpenOptions::new().read(true).open(path)?);
        let (mut buffer, mut whole) = (vec![0; maximum], 0);
        for number in 1.. {
            match read(&mut records, &mut buffer, number) {
                Ok(Some(message)) => whole += (HEADER + message.len()) as u64,
                Ok(None) | Err(Broken::Cut(_)) => break,
                Err(Broken::Length { length: 0, .. }) if is_zero(path, whole + LENGTH_AT)? => break,
                Err(broken) => return Err(io::Error::other(broken)),
            }
        }
        let cut = this.length.saturating_sub(whole);
        if cut > 0 {
            this.file.set_len(whole)?;
            this.length = whole;
        }
        Ok((this, Some(cut)))
    }

    /// Room for what waits for it, if a message has so many bytes at most.
    #[must_use]
    pub fn quota(maximum: usize) -> usize {
        RECORDS_BYTES.max(4 * (HEADER + maximum))
    }
}

impl Sink for Recording {
    fn put(&mut self, record: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
        self.file.write_all(record).inspect_err(|_| {
            // If this fails too, the last record is cut off, which its reader is told.
            let _ = self.file.set_len(self.length);
        })?;
        self.length += record.len() as u64;
        written(record.len());
        Ok(())
    }

    fn goes_on(&self) -> bool {
        false
    }
}

/// A destination whose messages are appended to a file.
pub struct FileDestination {
    end: Destination,
    outlet: Outlet,
    /// There is a sample that the file has not got.
    behind: bool,
    /// Records that were taken from the channel.
    pub taken: u64,
}

impl FileDestination {
    /// Of `end`; the outlet leads to a [`Recording`].
    #[must_use]
    pub fn new(end: Destination, outlet: Outlet) -> Self {
        Self { end, outlet, behind: false, taken: 0 }
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Destination {
        &mut self.end
    }

    /// Records that are in the file.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.outlet.pieces()
    }

    /// Takes what is new, within the budget and as far as there is room.
    ///
    /// # Errors
    /// Once, when the file cannot be written. What was there before stays whole.
    pub fn serve(
        &mut self,
        budget: &mut Budget,
        clock: &Timebase,
        now: Now<'_>,
    ) -> Result<(), Broken> {
        if let Some(error) = self.outlet.take_error() {
            return Err(Broken::Write(error));
        }
        while budget.is_left() && !self.outlet.has_ended() {
            self.behind |= self.end.has_news();
            let room = self.outlet.room(LANE) >= self.end.longest();
            if !self.behind || !room || !self.end.take(clock, now) {
                return Ok(());
            }
            self.behind = false;
            // There is room, so it fails only if the file has, which is told at the next turn.
            let _ = self.outlet.push(LANE, self.end.packet());
            budget.spend(self.end.packet().len());
            self.taken += 1;
        }
        Ok(())
    }

    /// Waits until the file has all that was taken, as [`Outlet::settle`] does.
    ///
    /// # Errors
    /// If it has not.
    pub fn settle(&mut self, patience: Duration, most: Duration) -> Result<(), Broken> {
        if self.outlet.settle(patience, most) {
            return self.outlet.take_error().map_or(Ok(()), |error| Err(Broken::Write(error)));
        }
        Err(Broken::Stalled(self.taken - self.messages()))
    }
}

/// A source whose messages come from a file.
pub struct FileSource {
    end: Source,
    /// `None` once it has come to its end.
    messages_ahead: Option<Receiver<Result<Vec<u8>, Broken>>>,
    /// Records that were sent.
    pub messages: u64,
}

/// What reads a file ahead: the messages, and what its thread has to do. Messages have at most `maximum`
/// bytes.
pub fn read_ahead(
    file: File,
    maximum: usize,
) -> (Receiver<Result<Vec<u8>, Broken>>, impl FnOnce() + Send) {
    let (ahead, messages) = sync_channel(budget::messages_of(maximum));
    let work = move || {
        let mut file = BufReader::new(file);
        let mut buffer = vec![0; maximum];
        for number in 1.. {
            let message = match read(&mut file, &mut buffer, number) {
                Ok(Some(message)) => Ok(message.to_vec()),
                Ok(None) => return,
                Err(broken) => Err(broken),
            };
            let last = message.is_err();
            // The receiver is gone once the run is over.
            if ahead.send(message).is_err() || last {
                return;
            }
        }
    };
    (messages, work)
}

impl FileSource {
    /// Sends what [`read_ahead`] brings.
    #[must_use]
    pub fn new(end: Source, messages: Receiver<Result<Vec<u8>, Broken>>) -> Self {
        Self { end, messages_ahead: Some(messages), messages: 0 }
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Source {
        &mut self.end
    }

    /// Sends the next messages, within the budget: one on a sampling channel, where the next one
    /// would make it void; on a queuing one as many as there is room for, whatever its policy. What
    /// the disk has not brought yet comes later.
    ///
    /// # Errors
    /// Once, when the file cannot be read or has a record that cannot be.
    pub fn serve(&mut self, budget: &mut Budget, now: Now<'_>) -> Result<(), Broken> {
        while budget.is_left() && self.end.has_room(true) {
            let Some(ahead) = &self.messages_ahead else { return Ok(()) };
            match ahead.try_recv() {
                Ok(Ok(message)) => {
                    budget.spend(message.len());
                    self.end.send(&message, now);
                    self.messages += 1;
                }
                Ok(Err(broken)) => {
                    self.messages_ahead = None;
                    return Err(broken);
                }
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => self.messages_ahead = None,
            }
            if self.end.is_sampling() {
                return Ok(());
            }
        }
        Ok(())
    }

    /// True if all was sent.
    #[cfg(test)]
    pub(super) fn is_over(&self) -> bool {
        self.messages_ahead.is_none()
    }
}

/// Whether a file has only zeros from some byte on.
fn is_zero(path: &Path, from: u64) -> io::Result<bool> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(from))?;
    for byte in BufReader::new(file).bytes() {
        if byte? != 0 {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The message of the next record, which is the `number`th; `None` at the end of the file.
fn read<'b>(
    file: &mut impl Read,
    buffer: &'b mut [u8],
    number: u64,
) -> Result<Option<&'b [u8]>, Broken> {
    let mut header = [0; HEADER];
    let (first, rest) = header.split_at_mut(1);
    let cut = |error: io::Error| match error.kind() {
        ErrorKind::UnexpectedEof => Broken::Cut(number),
        _ => Broken::Read(error),
    };
    match file.read_exact(first) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(Broken::Read(error)),
        Ok(()) => file.read_exact(rest).map_err(cut)?,
    }
    let Header { length, .. } = Header::from_bytes(&header);
    let maximum = buffer.len();
    match buffer.get_mut(..length as usize) {
        Some(message) if length > 0 => {
            file.read_exact(message).map_err(cut)?;
            Ok(Some(message))
        }
        _ => Err(Broken::Length { number, length, maximum }),
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use vmm_sys_util::epoll::Epoll;

    use super::*;
    use crate::config::{HostPort, WhenFull};
    use crate::host_ports::tests::{Bench, queuing};
    use crate::host_ports::{HostPorts, Port, Way};

    fn record(length: u32, message: &[u8]) -> Vec<u8> {
        let header = Header { taken_ns: u64::MAX, age_ns: 7, flags: u32::MAX, length };
        [&header.to_bytes(), message].concat()
    }

    #[test]
    fn records_are_read_one_behind_the_other() {
        let bytes = [record(3, b"one"), record(4, b"four")].concat();
        let (mut file, mut buffer) = (&bytes[..], [0; 4]);
        assert_eq!(read(&mut file, &mut buffer, 1).unwrap(), Some(&b"one"[..]));
        assert_eq!(read(&mut file, &mut buffer, 2).unwrap(), Some(&b"four"[..]));
        assert_eq!(read(&mut file, &mut buffer, 3).unwrap(), None);
    }

    #[test]
    fn a_record_that_cannot_be_is_an_error_that_says_which() {
        for (bytes, expected) in [
            (record(0, b""), "record 9 says that its message has 0 bytes; allowed are 1 to 4"),
            (record(5, b"fives"), "record 9 says that its message has 5 bytes; allowed are 1 to 4"),
            (
                record(u32::MAX, b""),
                "record 9 says that its message has 4294967295 bytes; allowed are 1 to 4",
            ),
            (record(4, b"fou"), "record 9 is cut off"),
            (record(4, b""), "record 9 is cut off"),
            (record(4, b"")[..23].to_vec(), "record 9 is cut off"),
            (vec![1], "record 9 is cut off"),
        ] {
            let error = read(&mut &bytes[..], &mut [0; 4], 9).unwrap_err();
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn a_record_that_was_cut_off_is_taken_away_and_nothing_else_is() {
        let folder = vmm_sys_util::tempdir::TempDir::new().unwrap();
        let path = folder.as_path().join("records");
        let whole = [record(3, b"one"), record(4, b"four")].concat();
        for cut in [0, 1, HEADER, HEADER + 3] {
            let last = record(4, b"last");
            std::fs::write(&path, [&whole[..], &last[..cut]].concat()).unwrap();
            let (mut recording, taken) = Recording::open_records(&path, 4).unwrap();
            assert_eq!(taken, Some(cut as u64));
            recording.put(&last, &mut |_| {}).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), [&whole[..], &last[..]].concat());
        }
        // Some file systems leave zeros in the place of what was not written.
        for written in [0, 1, 16, HEADER - 4] {
            let zeros = [0; HEADER + 3];
            let last = record(4, b"last");
            std::fs::write(&path, [&whole[..], &last[..written], &zeros].concat()).unwrap();
            let taken = Recording::open_records(&path, 4).unwrap().1;
            assert_eq!(taken, Some((written + zeros.len()) as u64));
            assert_eq!(std::fs::read(&path).unwrap(), whole);
        }
        // Records of a channel with longer messages, or no records at all.
        let other = [record(5, b"fives"), record(4, b"fou")].concat();
        std::fs::write(&path, &other).unwrap();
        let refused = Recording::open_records(&path, 4).err().unwrap().to_string();
        assert!(refused.contains("record 1 says that its message has 5 bytes"), "{refused}");
        assert_eq!(std::fs::read(&path).unwrap(), other);
    }

    /// A disk that takes one record whenever it is told to.
    struct Slow(Receiver<()>);

    impl Sink for Slow {
        fn put(&mut self, record: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
            let told = self.0.recv();
            written(record.len());
            told.map_err(|_| ErrorKind::StorageFull.into())
        }

        fn goes_on(&self) -> bool {
            false
        }
    }

    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn a_disk_that_takes_nothing_holds_nothing_up_and_what_finds_no_room_stays_in_the_channel() {
        let bench = Bench::new(queuing(8, WhenFull::Refuse), 8, HostPort::File, false);
        let (go, told) = std::sync::mpsc::channel();
        let end = Destination::open(bench.regions(), bench.clock.frequency).unwrap();
        // Room for two: the one that is being written is among them.
        let (outlet, work) = Outlet::new(&[2 * (HEADER + 8 + 64)], Slow(told));
        std::thread::spawn(work);
        let mut port = FileDestination::new(end, outlet);
        let mut guest = bench.queuing_source();
        for n in 0..10u8 {
            let taken = guest.send(&[n; 8], bench.stamp());
            assert_eq!(taken.is_ok(), n < 8 + 2, "{n}");
            port.serve(&mut { Budget::TICK }, &bench.clock, &|| bench.clock.epoch).unwrap();
        }
        assert_eq!((port.taken, port.messages(), guest.status().waiting), (2, 0, 8));
        let stalled = port.settle(Duration::from_millis(1), LONG).unwrap_err();
        assert_eq!(stalled.to_string(), "the disk takes too long: 2 records are not in the file");
        // It goes on where it was.
        for _ in 0..3 {
            go.send(()).unwrap();
        }
        while port.messages() < 3 {
            port.serve(&mut { Budget::TICK }, &bench.clock, &|| bench.clock.epoch).unwrap();
        }
        // And it fails.
        drop(go);
        while port.serve(&mut { Budget::TICK }, &bench.clock, &|| bench.clock.epoch).is_ok() {}
        assert!(port.serve(&mut { Budget::TICK }, &bench.clock, &|| bench.clock.epoch).is_ok());
        let waiting = guest.status().waiting;
        assert!(port.serve(&mut { Budget::TICK }, &bench.clock, &|| bench.clock.epoch).is_ok());
        assert_eq!(guest.status().waiting, waiting, "a message was taken without a client");
    }

    #[test]
    fn what_found_no_room_is_written_at_the_end_or_told_of() {
        for works in [true, false] {
            let bench = Bench::new(queuing(8, WhenFull::Refuse), 8, HostPort::File, false);
            let (go, told) = std::sync::mpsc::channel();
            let end = Destination::open(bench.regions(), bench.clock.frequency).unwrap();
            let (outlet, work) = Outlet::new(&[2 * (HEADER + 8 + 64)], Slow(told));
            std::thread::spawn(work);
            let way = Way::FileDestination(FileDestination::new(end, outlet));
            let (channel, name) = ("levels".into(), "port".into());
            let port = Port { channel, name, budget: Budget::TICK, way };
            let epoll = Rc::new(Epoll::new().unwrap());
            let mut ports = HostPorts { ports: vec![port], epoll, news: Vec::new() };
            let mut guest = bench.queuing_source();
            for n in 0..10u8 {
                guest.send(&[n; 8], bench.stamp()).unwrap();
                ports.on_tick(&bench.clock, &|| bench.clock.epoch);
            }
            // The disk comes to itself when the run is over already.
            let disk = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(100));
                let count = if works { 10 } else { 1 };
                (0..count).for_each(|_| go.send(()).unwrap());
            });
            ports.finish(&bench.clock, &|| bench.clock.epoch);
            disk.join().unwrap();
            let news = ports.take_news();
            let account = ports.accounts().remove(0);
            if works {
                assert_eq!((account.messages, guest.status().waiting), (10, 0));
                assert!(news.is_empty(), "{news:?}");
            } else {
                assert_eq!(guest.status().waiting, 8);
                assert!(news[0].contains("cannot write any more"), "{news:?}");
                let left = "channel levels: messages that wait and are not in the file: 8";
                assert_eq!(news[1..], [left]);
            }
        }
    }

    #[test]
    fn a_record_that_cannot_be_written_whole_is_not_in_the_file() {
        let bench = Bench::new(queuing(8, WhenFull::Refuse), 8, HostPort::File, false);
        let mut recording = Recording::open(&bench.path()).unwrap();
        recording.put(b"one", &mut |_| {}).unwrap();
        recording.file = File::open(bench.path()).unwrap();
        assert!(recording.put(b"second", &mut |_| panic!("it counts as written")).is_err());
        assert_eq!(std::fs::read(bench.path()).unwrap(), b"one");
    }
}
