//! A controller that answers with nonsense: every operation ends, after no more accesses than it
//! says, and every frame is one.

use proptest::prelude::*;
use std::cell::Cell;
use takt_sja1000::{
    BitRate, BusState, Controller, Filter, Frame, Id, Registers, StandardId, TransmitError,
};

/// Answers with the values given, over and over, and counts.
struct Nonsense<'a> {
    answers: &'a [u8],
    next: usize,
    accesses: &'a Cell<u32>,
}

impl Nonsense<'_> {
    fn access(&mut self, register: u8) {
        assert!(register < 32, "register {register}");
        self.accesses.set(self.accesses.get() + 1);
    }
}

impl Registers for Nonsense<'_> {
    fn read(&mut self, register: u8) -> u8 {
        self.access(register);
        self.next = (self.next + 1) % self.answers.len();
        self.answers[self.next]
    }

    fn write(&mut self, register: u8, _: u8) {
        self.access(register);
    }
}

/// A controller that starts as it should and then goes mad.
struct Mad<'a> {
    acceptance: [u8; 8],
    mode: u8,
    sane: &'a Cell<bool>,
    nonsense: Nonsense<'a>,
}

impl Registers for Mad<'_> {
    fn read(&mut self, register: u8) -> u8 {
        if !self.sane.get() {
            return self.nonsense.read(register);
        }
        match register {
            0 => self.mode,
            31 => 0x80,
            16..24 => self.acceptance[usize::from(register) - 16],
            _ => 0,
        }
    }

    fn write(&mut self, register: u8, value: u8) {
        match register {
            _ if !self.sane.get() => self.nonsense.write(register, value),
            0 => self.mode = value,
            16..24 => self.acceptance[usize::from(register) - 16] = value,
            _ => {}
        }
    }
}

fn check(frame: &Frame) {
    assert!(frame.length() <= 8);
    let bytes = if frame.is_remote() { 0 } else { frame.length().into() };
    assert_eq!(frame.bytes().len(), bytes);
    match frame.id() {
        Id::Standard(id) => assert!(id.get() < 0x800),
        Id::Extended(id) => assert!(id.get() < 0x2000_0000),
    }
}

/// Every operation many times on one that answers like this.
fn exercise(answers: &[u8]) {
    let accesses = Cell::new(0);
    let nonsense = || Nonsense { answers, next: 0, accesses: &accesses };
    let _ = Controller::start(nonsense(), BitRate::Mbit1, Filter::ALL);
    assert!(accesses.get() <= 500, "start: {} accesses", accesses.get());

    let sane = Cell::new(true);
    let mad = Mad { acceptance: [0; 8], mode: 1, sane: &sane, nonsense: nonsense() };
    let mut controller = Controller::start(mad, BitRate::Mbit1, Filter::ALL).unwrap();
    sane.set(false);
    let frame = Frame::data(StandardId::MAX, &[0xff; 8]).unwrap();
    for _ in 0..50 {
        accesses.set(0);
        let sent = controller.transmit(&frame);
        let maximum = if sent.is_ok() { 15 } else { 1 };
        assert!(accesses.get() <= maximum, "transmit: {} accesses", accesses.get());
        accesses.set(0);
        if let Ok(frame) = controller.receive() {
            check(&frame);
        }
        assert!(accesses.get() <= 16, "receive: {} accesses", accesses.get());
        accesses.set(0);
        let _ = controller.state();
        assert_eq!(accesses.get(), 4);
        accesses.set(0);
        controller.request_recovery();
        assert_eq!(accesses.get(), 1);
        accesses.set(0);
        let _ = controller.recover();
        assert!(accesses.get() <= 200, "recover: {} accesses", accesses.get());
    }
}

#[test]
fn a_card_that_is_pulled_out_is_off_the_bus() {
    let accesses = Cell::new(0);
    let sane = Cell::new(true);
    let nonsense = Nonsense { answers: &[0xff], next: 0, accesses: &accesses };
    let mad = Mad { acceptance: [0; 8], mode: 1, sane: &sane, nonsense };
    let mut controller = Controller::start(mad, BitRate::Mbit1, Filter::ALL).unwrap();
    sane.set(false);
    let frame = Frame::data(StandardId::MAX, &[]).unwrap();
    assert_eq!(controller.transmit(&frame), Err(TransmitError::BusOff));
    assert!(controller.receive().is_err());
    assert_eq!(controller.state(), BusState::Absent);
}

#[test]
fn every_constant_is_survived() {
    for answer in 0..=u8::MAX {
        exercise(&[answer]);
    }
}

proptest! {
    #[test]
    fn any_answers_are_survived(answers in prop::collection::vec(any::<u8>(), 1..400)) {
        exercise(&answers);
    }
}
