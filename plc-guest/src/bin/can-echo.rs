//! A guest that sends a numbered frame in each cycle and receives it back: somebody else on the bus
//! returns every frame as it is.
//!
//! Unlike `can` it drives one card only, the one that the other party does not have. A controller does
//! not receive what it sends, so whatever arrives has made the way there and back. Every 1000 cycles
//! it says what became of its frames.

#![no_std]
#![no_main]

use takt_plc_guest::can::Ports;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::sequence::Sequence;
use takt_plc_guest::{entry, port};
use takt_sja1000::cards::MIOE3680;
use takt_sja1000::{BitRate, Controller, Filter, Frame, Id, StandardId};

/// Where this guest sees BAR 0 of its card, an Advantech MIOe-3680.
const CARD: u16 = 0x2400;
/// The last in every arbitration, since this is a test.
const IDENTIFIER: StandardId = StandardId::MAX;
/// Cycles between two lines on the console.
const REPORT: u64 = 1000;
/// Frames taken in one cycle.
const RECEIVED_MAX: u32 = 4;
/// Exit code if the controller does not start.
const NO_CONTROLLER: u32 = 2;

struct Echo {
    card: Controller<Ports>,
    cycles: u64,
    sent: u64,
    /// Cycles in which the frame was not taken.
    refused: u64,
    returned: Sequence,
    /// Frames that are none of ours.
    foreign: u64,
}

impl Program for Echo {
    fn scan(&mut self, cycle: &Cycle) {
        // Those of the cycles before, so that what is missing at a report is on its way.
        for _ in 0..RECEIVED_MAX {
            let Ok(frame) = self.card.receive() else { break };
            match number(&frame) {
                Some(number) => self.returned.arrived(number),
                None => self.foreign += 1,
            }
        }
        self.cycles += 1;
        if self.cycles.is_multiple_of(REPORT) {
            let Sequence { received, lost, disordered, .. } = self.returned;
            print(format_args!(
                "cycle {}, sent {}, received {received}, lost {lost}, disordered {disordered}, \
                 refused {}, foreign {}, overruns {}, {:?}",
                cycle.release,
                self.sent,
                self.refused,
                self.foreign,
                self.card.overruns(),
                self.card.state(),
            ));
        }
        let number = self.sent + 1;
        // Eight bytes are not too many.
        let frame = Frame::data(Id::from(IDENTIFIER), &number.to_le_bytes()).ok();
        match frame.map(|frame| self.card.transmit(&frame)) {
            Some(Ok(())) => self.sent = number,
            _ => self.refused += 1,
        }
    }
}

/// The number of a frame that this guest has sent.
fn number(frame: &Frame) -> Option<u64> {
    let number = u64::from_le_bytes(frame.bytes().try_into().ok()?);
    (frame.id() == Id::from(IDENTIFIER)).then_some(number)
}

fn main() -> ! {
    let card = Controller::start(Ports::new(CARD, MIOE3680), BitRate::Kbit500, Filter::ALL)
        .unwrap_or_else(|error| {
            print(format_args!("the card does not start: {error}"));
            port::exit(NO_CONTROLLER)
        });
    let returned = Sequence::default();
    cycle::run(Echo { card, cycles: 0, sent: 0, refused: 0, returned, foreign: 0 })
}

entry!(main);
