//! What a message through a sampling port costs a program of Linux's, in ticks of the TSC.
//!
//!     port-cost LABEL
//!
//! Has the ports `out` and `in` of the PLC guest `peer`. In the lab a tick is one instruction.

#![deny(unsafe_code)]

use std::error::Error;
use std::process::ExitCode;

use takt_port::channel::ReadError;
use takt_port::{Ports, Start};
use takt_tests::record::{BYTES, record};

/// Messages that are measured. Some are interrupted; the median is not.
const COUNT: usize = 1_001;

fn run() -> Result<[u64; 3], Box<dyn Error>> {
    let ports = Ports::discover()?;
    let clock = ports.clock();
    let mut output = ports.output("out", Start::Attach)?;
    let mut input = ports.input("in", Start::Attach)?;
    let mut buffer = [0; BYTES];
    let [mut nothing, mut writes, mut reads] = [const { Vec::new() }; 3];
    while reads.len() < COUNT {
        let message = record(reads.len() as u64);
        let begin = clock.now();
        nothing.push(clock.now().since(begin).0);
        let begin = clock.now();
        output.write(&message)?;
        writes.push(clock.now().since(begin).0);
        let begin = clock.now();
        let read = input.read(&mut buffer).map(drop);
        let ticks = clock.now().since(begin).0;
        match read {
            Ok(()) => reads.push(ticks),
            Err(ReadError::NeverWritten) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok([nothing, writes, reads].map(median))
}

fn median(mut ticks: Vec<u64>) -> u64 {
    ticks.sort_unstable();
    ticks.get(ticks.len() / 2).copied().unwrap_or(0)
}

fn main() -> ExitCode {
    let label = std::env::args().nth(1).unwrap_or_default();
    match run() {
        Ok([nothing, write, read]) => {
            println!(
                "port-cost {label}: write {} read {}",
                write.saturating_sub(nothing),
                read.saturating_sub(nothing)
            );
            ExitCode::SUCCESS
        }
        Err(error) => {
            println!("port-cost {label}: {error}");
            ExitCode::FAILURE
        }
    }
}
