//! The Linux counterpart of the PLC guest `peer`: takes every message, and writes and sends a record
//! for each.
//!
//!     exchange COUNT [FUNCTION]
//!
//! Ends after COUNT messages, or if none comes for a long time. Its ports are `out` and `in` of
//! sampling channels, `send` and `receive` of queuing channels; FUNCTION is a folder like the PCI
//! function's in sysfs. It attaches, so that it also gets what was sent before it started. Exit
//! status: 0 if every record was whole and came once and in order.

#![forbid(unsafe_code)]

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use takt_port::channel::ReadError;
use takt_port::{Clock, Input, Output, Ports, Receiver, Sender, Start, Timeout};
use takt_tests::record::{BYTES, number, record};

/// Messages between two lines.
const REPORT: u64 = 1000;
/// A PLC that is alive sends far more often, whatever machine it runs on.
const SILENCE: Timeout = Timeout::Within(Duration::from_secs(20));

#[derive(Debug, Default)]
struct Seen {
    samples: u64,
    messages: u64,
    torn: u64,
    lost: u64,
    duplicated: u64,
    /// Samples that went back in time.
    wrong: u64,
    oldest_sample_ns: u64,
    oldest_message_ns: u64,
    last_sample: Option<u64>,
    last_message: Option<u64>,
}

impl Seen {
    fn message(&mut self, bytes: &[u8], age_ns: u64) {
        self.messages += 1;
        self.oldest_message_ns = self.oldest_message_ns.max(age_ns);
        let Some(n) = number(bytes) else {
            self.torn += 1;
            return;
        };
        // The first one may follow others, which an earlier owner of the port has taken.
        let expected = self.last_message.map_or(n, |last| last.wrapping_add(1));
        match n.checked_sub(expected) {
            Some(skipped) => self.lost += skipped,
            None => self.duplicated += 1,
        }
        self.last_message = Some(n);
    }

    fn sample(&mut self, bytes: &[u8], age_ns: u64) {
        self.oldest_sample_ns = self.oldest_sample_ns.max(age_ns);
        let Some(n) = number(bytes) else {
            self.torn += 1;
            return;
        };
        self.wrong += u64::from(self.last_sample.is_some_and(|last| n < last));
        self.samples += u64::from(self.last_sample != Some(n));
        self.last_sample = Some(n);
    }

    fn is_right(&self) -> bool {
        self.torn + self.lost + self.duplicated + self.wrong == 0
    }
}

struct Exchange<'p> {
    clock: Clock,
    output: Output<'p>,
    input: Input<'p>,
    sender: Sender<'p>,
    receiver: Receiver<'p>,
    seen: Seen,
}

impl Exchange<'_> {
    fn step(&mut self) -> Result<(), Box<dyn Error>> {
        let mut buffer = [0; BYTES];
        let message = self.receiver.receive(&mut buffer, SILENCE)?;
        let age = self.clock.now().since(message.stamp);
        self.seen.message(message.bytes, self.clock.nanoseconds(age));
        let answer = record(self.seen.messages);
        self.output.write(&answer)?;
        self.sender.send(&answer, SILENCE)?;
        match self.input.read(&mut buffer) {
            Ok(sample) => self.seen.sample(sample.bytes, self.clock.nanoseconds(sample.age)),
            Err(ReadError::NeverWritten) => {}
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn hostile(&mut self) -> u64 {
        let ends = [self.receiver.status().counters, self.sender.status().counters];
        ends.iter().map(|counters| counters.hostile).sum::<u64>()
            + self.input.status().counters.hostile
    }

    fn report(&mut self) {
        let hostile = self.hostile();
        let Seen { samples, messages, torn, lost, duplicated, wrong, .. } = self.seen;
        println!(
            "exchange: messages {messages}, oldest {} ns, samples {samples}, oldest {} ns, torn \
             {torn}, lost {lost}, duplicated {duplicated}, wrong {wrong}, hostile {hostile}",
            self.seen.oldest_message_ns, self.seen.oldest_sample_ns,
        );
    }
}

fn run(count: u64, function: Option<&str>) -> Result<bool, Box<dyn Error>> {
    let ports = match function {
        Some(folder) => Ports::open(Path::new(folder))?,
        None => Ports::discover()?,
    };
    let mut exchange = Exchange {
        clock: ports.clock(),
        output: ports.output("out", Start::Attach)?,
        input: ports.input("in", Start::Attach)?,
        sender: ports.sender("send", Start::Attach)?,
        receiver: ports.receiver("receive", Start::Attach)?,
        seen: Seen::default(),
    };
    println!("exchange: {count} records of {BYTES} bytes each way");
    for n in 1..=count {
        if let Err(error) = exchange.step() {
            exchange.report();
            return Err(error);
        }
        if n.is_multiple_of(REPORT) || n == count {
            exchange.report();
        }
    }
    Ok(exchange.seen.is_right() && exchange.hostile() == 0)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (count, function) = match arguments[..] {
        [count] => (count.parse(), None),
        [count, function] => (count.parse(), Some(function)),
        _ => ("".parse(), None),
    };
    let Ok(count) = count else {
        eprintln!("usage: exchange COUNT [FUNCTION]");
        return ExitCode::from(64);
    };
    match run(count, function) {
        Ok(true) => {
            println!("exchange: all right");
            ExitCode::SUCCESS
        }
        Ok(false) => {
            println!("exchange: something is wrong");
            ExitCode::FAILURE
        }
        Err(error) => {
            println!("exchange: {error}");
            ExitCode::from(70)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_are_left_out_or_come_again_are_counted() {
        let mut seen = Seen::default();
        for n in [5, 6, 9, 9, 3, 4] {
            seen.message(&record(n), 1);
        }
        seen.message(b"torn", 7);
        assert_eq!((seen.messages, seen.lost, seen.duplicated, seen.torn), (7, 2, 2, 1));
        assert_eq!(seen.oldest_message_ns, 7);
        assert!(!seen.is_right());
    }

    #[test]
    fn samples_may_be_left_out_and_come_again_but_not_go_back() {
        let mut seen = Seen::default();
        for n in [5, 5, 9, 9] {
            seen.sample(&record(n), 1);
        }
        assert!(seen.is_right());
        assert_eq!(seen.samples, 2);
        seen.sample(&record(8), 1);
        assert_eq!(seen.wrong, 1);
    }
}
