//! Ends that are a file.
//!
//! A recording outlives the run, and a file to send from makes a run repeatable. Both have the
//! same form, header and message one behind the other, so that a recording can be sent again.
//!
//! The event thread reads and writes the files itself. A slow disk makes it late, which it may be.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use takt_scheduler::time::{Timebase, Tsc};
use thiserror::Error;

use super::budget::Budget;
use super::ends::{Destination, Source};
use super::packet::{HEADER, Header};

/// Why a file's part in the run is over before the run is.
#[derive(Debug, Error)]
pub enum Broken {
    /// The disk is full, or worse.
    #[error("cannot write any more: {0}")]
    Write(io::Error),
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

/// A destination whose messages are appended to a file.
pub struct FileDestination {
    end: Destination,
    /// `None` once it is broken.
    file: Option<File>,
    /// There is a sample that the file has not got.
    behind: bool,
    /// Records that were written.
    pub messages: u64,
}

impl FileDestination {
    /// Opens the file, or makes it, for its owner only (mode 0600).
    ///
    /// # Errors
    /// If it is none that can be appended to.
    pub fn open(end: Destination, path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        // Opening a pipe would wait for its reader.
        options.append(true).create(true).mode(0o600).custom_flags(libc::O_NONBLOCK);
        let file = options.open(path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::new(ErrorKind::InvalidInput, "it is not a regular file"));
        }
        Ok(Self { end, file: Some(file), behind: false, messages: 0 })
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Destination {
        &mut self.end
    }

    /// Writes what is new, within the budget.
    ///
    /// # Errors
    /// Once, when the file cannot be written. What was there before stays whole.
    pub fn serve(&mut self, budget: &mut Budget, clock: &Timebase, now: Tsc) -> Result<(), Broken> {
        while budget.is_left() {
            let Some(file) = &mut self.file else { return Ok(()) };
            self.behind |= self.end.has_news();
            if !self.behind || !self.end.take(clock, now) {
                return Ok(());
            }
            self.behind = false;
            if let Err(error) = append(file, self.end.packet()) {
                self.file = None;
                return Err(Broken::Write(error));
            }
            budget.spend(self.end.packet().len());
            self.messages += 1;
        }
        Ok(())
    }
}

/// Appends the whole record or none of it.
fn append(file: &mut File, record: &[u8]) -> io::Result<()> {
    let before = file.metadata()?.len();
    file.write_all(record).inspect_err(|_| {
        // If this fails too, the last record is cut off, which its reader is told.
        let _ = file.set_len(before);
    })
}

/// A source whose messages come from a file.
pub struct FileSource {
    end: Source,
    /// `None` once it has come to its end.
    file: Option<BufReader<File>>,
    /// As long as the longest message.
    buffer: Vec<u8>,
    /// Records that were sent.
    pub messages: u64,
}

impl FileSource {
    /// Sends from `file` messages of at most `maximum` bytes.
    #[must_use]
    pub fn new(end: Source, file: File, maximum: usize) -> Self {
        Self { end, file: Some(BufReader::new(file)), buffer: vec![0; maximum], messages: 0 }
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Source {
        &mut self.end
    }

    /// Sends the next messages, within the budget: one on a sampling channel, where the next one
    /// would make it void; on a queuing one as many as there is room for, whatever its policy.
    ///
    /// # Errors
    /// Once, when the file cannot be read or has a record that cannot be.
    pub fn serve(&mut self, budget: &mut Budget, now: Tsc) -> Result<(), Broken> {
        while budget.is_left() && self.end.has_room(true) {
            let Some(file) = &mut self.file else { return Ok(()) };
            match read(file, &mut self.buffer, self.messages + 1) {
                Ok(Some(message)) => {
                    budget.spend(message.len());
                    self.end.send(message, now);
                    self.messages += 1;
                }
                Ok(None) => self.file = None,
                Err(broken) => {
                    self.file = None;
                    return Err(broken);
                }
            }
            if self.end.is_sampling() {
                return Ok(());
            }
        }
        Ok(())
    }
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
    use super::*;
    use crate::config::{HostPort, WhenFull};
    use crate::host_ports::tests::{Bench, queuing};

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
    fn a_file_that_cannot_be_written_is_told_of_once_and_then_nothing_is_taken() {
        let bench = Bench::new(queuing(8, WhenFull::Refuse), 8, HostPort::File, false);
        let end = Destination::open(bench.regions(), bench.clock.frequency).unwrap();
        let mut port = FileDestination::open(end, &bench.path()).unwrap();
        let mut guest = bench.queuing_source();
        let mut serve = |port: &mut FileDestination| {
            guest.send(b"message", bench.stamp()).unwrap();
            port.serve(&mut { Budget::TICK }, &bench.clock, bench.clock.epoch)
        };
        assert!(serve(&mut port).is_ok());
        let length = || std::fs::metadata(bench.path()).unwrap().len();
        let before = length();
        port.file = Some(File::open(bench.path()).unwrap());
        assert!(matches!(serve(&mut port), Err(Broken::Write(_))));
        assert!(serve(&mut port).is_ok());
        assert_eq!((port.messages, length()), (1, before));
        // One went into the failure, the other one waits.
        assert_eq!(guest.status().waiting, 1);
    }
}
