//! Tests of CAN objects, against the driver's model of a controller and against controllers that lie.

use crate::can::*;
use crate::process_image::Newest;
use crate::time::Clock;
use std::cell::Cell;
use std::rc::Rc;
use takt_abi::can::{BIT_RATES, Controller, EXTENDED, OBJECTS_MAX, ON_CHANGE, Object};
use takt_abi::io::{INPUT, OUTPUT};
use takt_sja1000::{BitRate, BusState, Registers};

#[allow(dead_code, reason = "the driver's own tests use all of it")]
#[path = "../../../devices/sja1000/tests/sja1000/chip.rs"]
mod chip;

use chip::Chip;

/// Ticks after which a controller is told to come back.
const PATIENCE: u64 = 1_000;
/// One tick is one nanosecond.
const CLOCK: Clock = Clock::new(0, 1_000_000);
const SETTINGS: Controller = Controller { frames: 3, kbit_per_s: 500, ..Controller::NONE };

const fn object(identifier: u32, direction: u8, bytes: u8, flags: u8) -> Object {
    Object { identifier, controller: 0, direction, bytes, flags }
}

/// Places in `OBJECTS`.
const SPEED: u64 = 0;
const LONG: u64 = 1;
const VALVE: u64 = 2;
const LAMP: u64 = 3;
const OBJECTS: [Object; 4] = [
    object(0x181, INPUT, 4, 0),
    object(0x18ff_0181 | EXTENDED, INPUT, 0, 0),
    object(0x201, OUTPUT, 4, 0),
    object(0x202, OUTPUT, 1, ON_CHANGE),
];

fn can<R: Registers>(registers: R) -> Can<R> {
    let mut all = [Object::NONE; OBJECTS_MAX];
    all[..OBJECTS.len()].copy_from_slice(&OBJECTS);
    let mut can = Can::new(&all, PATIENCE);
    can.start(0, &SETTINGS, registers).unwrap();
    can
}

fn started() -> (Chip, Can<Chip>) {
    let chip = Chip::new();
    (chip.clone(), can(chip))
}

/// The window does not end.
fn never() -> bool {
    false
}

fn standard(id: u16, data: &[u8]) -> Vec<u8> {
    let [high, low] = (id << 5).to_be_bytes();
    [&[data.len() as u8, high, low], data].concat()
}

fn write(can: &mut Can<Chip>, object: u64, byte: u8) {
    can.put(object, 0, |data| data[0] = byte);
}

/// First bytes of the frames that were sent, with the low byte of their identifiers.
fn sent(chip: &Chip) -> Vec<(u8, u8)> {
    let frames = std::mem::take(&mut chip.inside().sent);
    let id = |frame: &[u8; 13]| (u16::from_be_bytes([frame[1], frame[2]]) >> 5) as u8;
    frames.iter().map(|frame| (id(frame), frame[3])).collect()
}

#[test]
fn an_object_has_its_newest_frame_its_age_and_its_count() {
    let (chip, mut can) = started();
    assert_eq!(can.newest(SPEED, 5, &CLOCK), Newest::NONE);
    for byte in [1, 2] {
        assert!(chip.deliver(&standard(0x181, &[byte; 6])));
    }
    can.receive(0, 100, never);
    let newest = can.newest(SPEED, 170, &CLOCK);
    assert_eq!(newest.message, Some(&[2, 2, 2, 2, 2, 2, 0, 0][..]));
    assert_eq!((newest.valid, newest.age, newest.count), (true, 70, 2));
    // A long frame leaves nothing of itself behind in a shorter one.
    assert!(chip.deliver(&standard(0x181, &[3; 4])));
    can.receive(0, 200, never);
    let newest = can.newest(SPEED, 200, &CLOCK);
    assert_eq!(newest.message, Some(&[3, 3, 3, 3, 0, 0, 0, 0][..]));
    let long = [&[0x80][..], &(0x18ff_0181u32 << 3).to_be_bytes()].concat();
    assert!(chip.deliver(&long));
    can.receive(0, 300, never);
    assert_eq!(can.newest(LONG, 300, &CLOCK).count, 1);
    assert_eq!(can.look(0, 300).unwrap().1.received, 4);
}

#[test]
fn foreign_short_and_remote_frames_are_counted_and_change_nothing() {
    let (chip, mut can) = started();
    let remote = [&[0x40 | 4][..], &standard(0x181, &[])[1..]].concat();
    // With an extended and a standard identifier the filter keeps everything.
    for frame in [standard(0x182, &[1; 8]), standard(0x181, &[1; 3]), remote] {
        assert!(chip.deliver(&frame));
    }
    can.receive(0, 1, never);
    assert_eq!(can.newest(SPEED, 1, &CLOCK), Newest::NONE);
    let (state, figures, overruns) = can.look(0, 1).unwrap();
    let expected = Figures { foreign: 2, short: 1, ..Figures::default() };
    assert_eq!((state, figures, overruns), (BusState::Active, expected, 0));
}

#[test]
fn a_job_takes_and_hands_over_so_many_frames_and_no_more() {
    let (chip, mut can) = started();
    for byte in 0..5 {
        assert!(chip.deliver(&standard(0x181, &[byte; 4])));
    }
    can.receive(0, 1, never);
    assert_eq!((can.newest(SPEED, 1, &CLOCK).count, chip.inside().received.len()), (3, 2));
    can.receive(0, 1, never);
    assert_eq!((can.newest(SPEED, 1, &CLOCK).count, chip.inside().received.len()), (5, 0));
    write(&mut can, VALVE, 1);
    write(&mut can, LAMP, 1);
    can.send(0, 1, never);
    assert_eq!(sent(&chip).len(), 2);
}

#[test]
fn no_frame_is_begun_when_the_window_is_over() {
    let (answers, accesses) = (Rc::new(Cell::new(None)), Rc::new(Cell::new(0)));
    let chip = Chip::new();
    let liar = Liar { chip: chip.clone(), answers, accesses: accesses.clone() };
    let mut can = can(liar);
    for byte in 0..3 {
        assert!(chip.deliver(&standard(0x181, &[byte; 4])));
    }
    // The window ends with the first access.
    accesses.set(0);
    let over = || accesses.get() > 0;
    assert!(!can.receive(0, 1, over));
    assert!(accesses.replace(0) <= 16);
    assert_eq!((can.newest(SPEED, 1, &CLOCK).count, chip.inside().received.len()), (1, 2));
    // The next pass takes the rest.
    assert!(can.receive(0, 2, never));
    assert_eq!((can.newest(SPEED, 2, &CLOCK).count, chip.inside().received.len()), (3, 0));
    can.put(VALVE, 2, |data| data[0] = 1);
    can.put(LAMP, 2, |data| data[0] = 1);
    accesses.set(0);
    can.send(0, 2, over);
    assert!(accesses.replace(0) <= 15);
    assert_eq!((sent(&chip).len(), can.waits(0)), (1, true));
    // If it has ended before, nothing is done.
    assert!(!can.receive(0, 3, || true));
    can.send(0, 3, || true);
    assert_eq!((accesses.get(), can.waits(0)), (0, true));
}

#[test]
fn what_is_cyclic_is_sent_each_time_and_what_is_not_when_it_changes() {
    let (chip, mut can) = started();
    for (byte, expected) in [
        (0, &[(1, 0), (2, 0)][..]),
        (0, &[(1, 0)]),
        (7, &[(1, 7), (2, 7)]),
        (7, &[(1, 7)]),
        (0, &[(1, 0), (2, 0)]),
    ] {
        write(&mut can, VALVE, byte);
        write(&mut can, LAMP, byte);
        can.send(0, 1, never);
        let mut frames = sent(&chip);
        frames.sort_unstable();
        assert_eq!(frames, expected);
    }
    assert_eq!(chip.inside().violations, [""; 0]);
}

#[test]
fn objects_that_find_the_buffer_busy_take_turns_with_their_newest_values() {
    let (chip, mut can) = started();
    chip.inside().alone = true;
    for byte in 1..=3 {
        write(&mut can, VALVE, byte);
        write(&mut can, LAMP, byte);
        can.send(0, 1, never);
    }
    assert!(can.waits(0) && !can.send_one(0, 1));
    // The first of each is in the buffer or waits; two values of the valve, or one, and of the lamp gave way.
    let figures = can.look(0, 1).unwrap().1;
    assert_eq!((figures.sent, figures.replaced), (1, 3), "{figures:?}");
    chip.inside().alone = false;
    chip.inside().pending = false;
    can.send(0, 1, never);
    let mut frames = sent(&chip);
    frames.sort_unstable();
    assert_eq!((frames, can.waits(0)), (vec![(1, 3), (2, 3)], false));
    // One frame at a time: neither comes twice before the other.
    for byte in 4..10 {
        write(&mut can, VALVE, byte);
        write(&mut can, LAMP, byte);
        assert!(can.send_one(0, 1));
    }
    let order: Vec<u8> = sent(&chip).iter().map(|frame| frame.0).collect();
    assert!(order == [1, 2, 1, 2, 1, 2] || order == [2, 1, 2, 1, 2, 1], "{order:?}");
}

#[test]
fn a_controller_off_its_bus_is_told_to_come_back_after_a_while_and_sends_all_anew() {
    let (chip, mut can) = started();
    write(&mut can, LAMP, 1);
    can.send(0, 1, never);
    assert_eq!(sent(&chip), [(2, 1)]);
    (chip.inside().bus_off, chip.inside().mode) = (true, 1);
    for now in [100, 500, 100 + PATIENCE - 1] {
        write(&mut can, LAMP, 1);
        can.receive(0, now, never);
        can.send(0, now, never);
        assert_eq!((chip.inside().mode & 1, can.waits(0)), (1, false), "{now}");
    }
    assert_eq!(can.look(0, 200).unwrap().0, BusState::BusOff);
    can.receive(0, 100 + PATIENCE, never);
    assert_eq!(can.look(0, 100 + PATIENCE).unwrap().0, BusState::Recovering);
    chip.inside().bus_off = false;
    can.receive(0, 100 + PATIENCE + 1, never);
    can.send(0, 100 + PATIENCE + 1, never);
    // Nothing has changed, but no answer tells what became of the frame before.
    assert_eq!(sent(&chip), [(2, 1)]);
    assert_eq!(can.look(0, 2_000).unwrap().1.bus_offs, 1);
    assert_eq!(chip.inside().violations, [""; 0]);
}

#[test]
fn without_a_controller_nothing_is_received_sent_or_waited_for() {
    let mut can: Can<Chip> = Can::new(&[OBJECTS[2]; OBJECTS_MAX], PATIENCE);
    let chip = Chip::new();
    chip.inside().stuck = true;
    assert!(can.start(0, &SETTINGS, chip).is_err());
    can.receive(0, 1, never);
    write(&mut can, 0, 1);
    can.send(0, 1, never);
    assert!(!can.waits(0) && can.look(0, 1).is_none());
    // Nor does a number that is none do anything.
    write(&mut can, u64::MAX, 1);
    can.receive(usize::MAX, 1, never);
    can.send(usize::MAX, 1, never);
    assert_eq!(can.newest(u64::MAX, 1, &CLOCK), Newest::NONE);
}

/// Behaves until it has started, then answers each read with the next of some numbers, and counts.
struct Liar {
    chip: Chip,
    answers: Rc<Cell<Option<u64>>>,
    accesses: Rc<Cell<u32>>,
}

impl Registers for Liar {
    fn read(&mut self, register: u8) -> u8 {
        self.accesses.set(self.accesses.get() + 1);
        let Some(state) = self.answers.get() else { return self.chip.read(register) };
        let next = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(state | 1);
        self.answers.set(Some(next));
        (next >> 56) as u8
    }

    fn write(&mut self, register: u8, value: u8) {
        self.accesses.set(self.accesses.get() + 1);
        if self.answers.get().is_none() {
            self.chip.write(register, value);
        }
    }
}

#[test]
fn a_controller_that_lies_costs_no_more_accesses_than_are_told() {
    for seed in 0..5_000u64 {
        let (answers, accesses) = (Rc::new(Cell::new(None)), Rc::new(Cell::new(0)));
        let liar = Liar { chip: Chip::new(), answers: answers.clone(), accesses: accesses.clone() };
        let mut can = can(liar);
        answers.set(Some(seed));
        for now in 0..20 {
            accesses.set(0);
            can.receive(0, now * 600, never);
            assert!(accesses.replace(0) <= 16 * 3, "seed {seed}");
            can.put(VALVE, now, |data| data.fill(now as u8));
            can.put(LAMP, now, |data| data[0] = now as u8);
            can.send(0, now * 600, never);
            assert!(accesses.replace(0) <= 15 * 2, "seed {seed}");
            can.look(0, now * 600);
            assert!(accesses.get() <= 5, "seed {seed}");
        }
    }
}

#[test]
fn every_rate_of_the_interface_is_one_of_the_driver() {
    for rate in BIT_RATES {
        assert!(BitRate::from_kbit_per_s(rate).is_some(), "{rate}");
    }
}
