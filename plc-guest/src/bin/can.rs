//! A guest that drives two CAN cards: one sends a numbered frame in each cycle, the other receives
//! whatever is on the bus.
//!
//! The frames are standard and extended ones in turn. It counts what it sent, what arrived of that,
//! what is missing or came in the wrong order, and what came from others, and says so every 1000
//! cycles. If a controller goes off the bus it is told to come back then, and not sooner.
//!
//! The partition file must give it the cards' base address registers at the ports named here.

#![no_std]
#![no_main]

use takt_plc_guest::can::Ports;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::sequence::Sequence;
use takt_plc_guest::{entry, port};
use takt_sja1000::cards::{KVASER_PCI, MIOE3680};
use takt_sja1000::{BitRate, BusState, Controller, ExtendedId, Filter, Frame, Id, StandardId};

/// Where this guest sees BAR 1 of the card that sends, a Kvaser PCIcan.
const SENDER: u16 = 0x2000;
/// Where it sees BAR 0 of the card that receives, an Advantech MIOe-3680.
const RECEIVER: u16 = 0x2400;

/// Identifiers of odd and even frames: the last in every arbitration, since this is a test.
const ODD: StandardId = StandardId::MAX;
const EVEN: ExtendedId = ExtendedId::MAX;
/// Cycles between two lines on the console.
const REPORT: u64 = 1000;
/// Frames taken in one cycle, so that a busy bus, or a mad card, cannot make it endless.
const RECEIVED_MAX: u32 = 4;
/// Exit code if a controller does not start.
const NO_CONTROLLER: u32 = 2;

struct Can {
    sender: Controller<Ports>,
    receiver: Controller<Ports>,
    cycles: u64,
    sent: u64,
    /// Cycles in which the frame was not taken.
    refused: u64,
    sequence: Sequence,
    /// Frames of others.
    foreign: u64,
    recoveries: u64,
}

impl Can {
    fn send(&mut self) {
        let number = self.sent + 1;
        // Eight bytes are not too many.
        let frame = Frame::data(id(number), &number.to_le_bytes()).ok();
        match frame.map(|frame| self.sender.transmit(&frame)) {
            Some(Ok(())) => self.sent = number,
            _ => self.refused += 1,
        }
    }

    fn receive(&mut self) {
        for _ in 0..RECEIVED_MAX {
            let Ok(frame) = self.receiver.receive() else { return };
            match number(&frame) {
                Some(number) => self.sequence.arrived(number),
                None => self.foreign += 1,
            }
        }
    }

    fn report(&mut self, cycle: &Cycle) {
        let states = [self.sender.state(), self.receiver.state()];
        let Sequence { received, lost, disordered, .. } = self.sequence;
        print(format_args!(
            "cycle {}, sent {}, received {received}, lost {lost}, disordered {disordered}, \
             refused {}, foreign {}, overruns {}, recoveries {}, {:?} and {:?}",
            cycle.release,
            self.sent,
            self.refused,
            self.foreign,
            self.receiver.overruns(),
            self.recoveries,
            states[0],
            states[1],
        ));
        for (controller, state) in [&mut self.sender, &mut self.receiver].into_iter().zip(states) {
            if state == BusState::BusOff && controller.recover().is_ok() {
                self.recoveries += 1;
            }
        }
    }
}

impl Program for Can {
    fn scan(&mut self, cycle: &Cycle) {
        self.cycles += 1;
        self.send();
        self.receive();
        if self.cycles.is_multiple_of(REPORT) {
            self.report(cycle);
        }
    }
}

fn id(number: u64) -> Id {
    if number.is_multiple_of(2) { EVEN.into() } else { ODD.into() }
}

/// The number of a frame that this guest has sent.
fn number(frame: &Frame) -> Option<u64> {
    let number = u64::from_le_bytes(frame.bytes().try_into().ok()?);
    (frame.id() == id(number)).then_some(number)
}

fn start(name: &str, ports: Ports) -> Controller<Ports> {
    Controller::start(ports, BitRate::Kbit500, Filter::ALL).unwrap_or_else(|error| {
        print(format_args!("the {name} does not start: {error}"));
        port::exit(NO_CONTROLLER)
    })
}

fn main() -> ! {
    // The receiver first: nothing is sent that it could miss.
    let receiver = start("receiver", Ports::new(RECEIVER, MIOE3680));
    let sender = start("sender", Ports::new(SENDER, KVASER_PCI));
    print(format_args!("can, a frame of 8 bytes in each cycle at 500 kbit/s"));
    cycle::run(Can {
        sender,
        receiver,
        cycles: 0,
        sent: 0,
        refused: 0,
        sequence: Sequence::default(),
        foreign: 0,
        recoveries: 0,
    })
}

entry!(main);
