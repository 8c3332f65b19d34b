//! A guest that exchanges records with another of its kind, and checks each.
//!
//! It has four ports, `out` and `in` of sampling channels, `send` and `receive` of queuing
//! channels. In each cycle it writes a record and sends a message, reads and receives whatever is
//! there, and counts as wrong what is torn, goes back in time, was left out, or comes twice. It shows
//! that channels work, and that a hostile peer can do no more than send what is wrong.

#![no_std]
#![no_main]

use takt_plc_guest::channel::{self, Input, Output, Receiver, Sender};
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, port};

/// Bytes of a record: 64 words that are all the same number.
const BYTES: usize = 512;
/// Cycles between two lines on the console.
const REPORT: u64 = 1000;

/// Messages taken in one cycle, so that a hostile peer cannot make it endless.
const RECEIVED_MAX: u32 = 16;
/// Exit code if a port does not open.
const NOT_OPEN: u32 = 2;

struct Peer {
    output: Output,
    input: Input,
    sender: Sender,
    receiver: Receiver,
    /// Number of the record that is written next.
    next: u64,
    /// Messages that were refused, to be sent again.
    refused: u64,
    /// Number of the message that is sent next.
    to_send: u64,
    /// Number of the last sample.
    sample: u64,
    /// Number of the last message.
    message: u64,
    samples: u64,
    messages: u64,
    oldest: u64,
    wrong: u64,
}

impl Peer {
    fn read(&mut self) {
        let mut buffer = [0; BYTES];
        let now = takt_channel::Tsc(cycle::now());
        let Ok(sample) = self.input.read(&mut buffer, now) else { return };
        self.oldest = self.oldest.max(sample.age.0);
        match number(sample.bytes) {
            Some(n) if n >= self.sample => {
                self.samples += u64::from(n > self.sample);
                self.sample = n;
            }
            _ => self.wrong += 1,
        }
    }

    fn receive(&mut self) {
        let mut buffer = [0; BYTES];
        for _ in 0..RECEIVED_MAX {
            let Ok(received) = self.receiver.receive(&mut buffer) else { return };
            self.messages += 1;
            match number(received.bytes) {
                // The first one may follow others, which were sent before this end was open.
                Some(n) if self.message == 0 || n == self.message.wrapping_add(1) => {
                    self.message = n;
                }
                _ => self.wrong += 1,
            }
        }
    }
}

impl Program for Peer {
    fn scan(&mut self, cycle: &Cycle) {
        let stamp = takt_channel::Tsc(cycle::now());
        self.next += 1;
        // The length is right, and nothing else can go wrong.
        let _ = self.output.write(&record(self.next), stamp);
        match self.sender.send(&record(self.to_send), stamp) {
            Ok(()) => self.to_send += 1,
            Err(_) => self.refused += 1,
        }
        self.read();
        self.receive();
        if self.next.is_multiple_of(REPORT) {
            print(format_args!(
                "cycle {}, samples {}, oldest {}, messages {}, refused {}, wrong {}, hostile {}",
                cycle.release,
                self.samples,
                self.oldest,
                self.messages,
                self.refused,
                self.wrong,
                self.input.status().counters.hostile + self.receiver.status().counters.hostile,
            ));
        }
    }
}

fn record(number: u64) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    for word in bytes.as_chunks_mut::<8>().0 {
        *word = number.to_le_bytes();
    }
    bytes
}

/// The number of a record; `None` if it is torn or has another length.
fn number(bytes: &[u8]) -> Option<u64> {
    let words = bytes.as_chunks::<8>().0;
    let first = *words.first()?;
    (bytes.len() == BYTES && words.iter().all(|word| *word == first))
        .then(|| u64::from_le_bytes(first))
}

fn main() -> ! {
    let maximum = BYTES as u32;
    let ports = (
        channel::output("out", maximum),
        channel::input("in", maximum),
        channel::sender("send", maximum),
        channel::receiver("receive", maximum),
    );
    let (Ok(output), Ok(input), Ok(sender), Ok(receiver)) = ports else {
        print(format_args!("a port does not open"));
        port::exit(NOT_OPEN)
    };
    print(format_args!("peer, records of {BYTES} bytes each way"));
    cycle::run(Peer {
        output,
        input,
        sender,
        receiver,
        next: 0,
        refused: 0,
        to_send: 1,
        sample: 0,
        message: 0,
        samples: 0,
        messages: 0,
        oldest: 0,
        wrong: 0,
    })
}

entry!(main);
