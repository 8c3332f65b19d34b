//! A guest that counts what its ports cost, in ticks of the TSC.
//!
//! It has the ports of `peer`. In each cycle it uses each of them once, for 512 bytes, and copies as
//! many bytes within its own memory; of each it keeps the least that it took. In the lab a tick is
//! one instruction, so the difference is what a port costs beyond moving the bytes.

#![no_std]
#![no_main]

use core::hint::black_box;

use takt_channel::Tsc;
use takt_plc_guest::channel::{self, Input, Output, Receiver, Sender};
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, port};

/// Bytes of a message.
const BYTES: usize = 512;
/// Cycles until the result is printed.
const CYCLES: u32 = 100;
/// Exit code if a port does not open.
const NOT_OPEN: u32 = 2;

/// The least that something took.
#[derive(Clone, Copy)]
struct Least(u64);

impl Least {
    fn measure(&mut self, what: impl FnOnce() -> bool) {
        let before = cycle::now();
        let done = what();
        let after = cycle::now();
        if done {
            self.0 = self.0.min(after.saturating_sub(before));
        }
    }
}

struct Cost {
    output: Output,
    input: Input,
    sender: Sender,
    receiver: Receiver,
    message: [u8; BYTES],
    buffer: [u8; BYTES],
    cycles: u32,
    nothing: Least,
    copy: Least,
    write: Least,
    read: Least,
    send: Least,
    receive: Least,
}

impl Program for Cost {
    fn scan(&mut self, _: &Cycle) {
        let Self { message, buffer, output, input, sender, receiver, .. } = self;
        let now = Tsc(cycle::now());
        message.fill(self.cycles as u8);
        self.nothing.measure(|| true);
        self.copy.measure(|| {
            black_box(&mut *buffer).copy_from_slice(black_box(message));
            black_box(&buffer);
            true
        });
        self.write.measure(|| output.write(black_box(message), now).is_ok());
        self.read.measure(|| black_box(input.read(black_box(buffer), now)).is_ok());
        self.send.measure(|| sender.send(black_box(message), now).is_ok());
        self.receive.measure(|| black_box(receiver.receive(black_box(buffer))).is_ok());
        self.cycles += 1;
        if self.cycles == CYCLES {
            let beyond = |least: Least| least.0.saturating_sub(self.nothing.0);
            print(format_args!(
                "ticks for {BYTES} bytes: copy {}, write {}, read {}, send {}, receive {}",
                beyond(self.copy),
                beyond(self.write),
                beyond(self.read),
                beyond(self.send),
                beyond(self.receive),
            ));
        }
    }
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
    let least = Least(u64::MAX);
    cycle::run(Cost {
        output,
        input,
        sender,
        receiver,
        message: [0; BYTES],
        buffer: [0; BYTES],
        cycles: 0,
        nothing: least,
        copy: least,
        write: least,
        read: least,
        send: least,
        receive: least,
    })
}

entry!(main);
