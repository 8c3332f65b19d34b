//! Starting, from whatever state, and the controllers that cannot be started.

use takt_sja1000::{
    BitRate, BusState, Controller, Filter, ModeError, ReceiveError, Registers, StartError,
};

use crate::chip::Chip;

#[test]
fn everything_is_set_up_and_nothing_forbidden_is_done() {
    let chip = Chip::new();
    Controller::start(chip.clone(), BitRate::Kbit250, Filter::ALL).unwrap();
    let inside = chip.inside();
    assert_eq!(inside.violations, [""; 0]);
    // On the bus, with two filters; PeliCAN, comparator bypassed, clock output off.
    assert_eq!((inside.mode, inside.clock), (0x00, 0xc8));
    assert_eq!(inside.interrupt_enable, 0);
    assert_eq!(inside.timing, [0x01, 0x1c]);
    assert_eq!((inside.output, inside.warning_limit), (0xda, 96));
    assert_eq!(inside.acceptance, [0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff]);
    assert!(inside.accesses < 45, "{} accesses", inside.accesses);
}

#[test]
fn each_rate_has_its_timing() {
    let rates = [
        (BitRate::Kbit250, [0x01, 0x1c]),
        (BitRate::Kbit500, [0x00, 0x1c]),
        (BitRate::Mbit1, [0x00, 0x14]),
    ];
    for (rate, expected) in rates {
        let chip = Chip::new();
        Controller::start(chip.clone(), rate, Filter::ALL).unwrap();
        assert_eq!(chip.inside().timing, expected, "{rate:?}");
    }
}

#[test]
fn a_running_controller_is_started_anew() {
    let chip = Chip::new();
    let _former = chip.start();
    chip.deliver(&[0x00, 0x10, 0x00]);
    chip.inside().transmit_errors = 200;
    // With one filter, which only reset mode can change.
    chip.inside().mode = 0x08;
    let mut controller = chip.start();
    assert_eq!(controller.receive(), Err(ReceiveError::Empty));
    assert_eq!(controller.state(), BusState::Active);
    assert_eq!(chip.inside().mode, 0x00);
    assert_eq!(chip.inside().violations, [""; 0]);
}

#[test]
fn a_controller_off_the_bus_is_started_anew() {
    let chip = Chip::new();
    let _former = chip.start();
    chip.inside().bus_off = true;
    chip.inside().mode |= 1;
    chip.inside().transmit_errors = 127;
    assert_eq!(chip.start().state(), BusState::Active);
}

#[test]
fn frames_of_a_former_life_are_thrown_away() {
    let chip = Chip::new();
    let _former = chip.start();
    chip.inside().keeps_received = true;
    for _ in 0..30 {
        chip.deliver(&[0x00, 0x10, 0x00]);
    }
    let mut controller = chip.start();
    assert_eq!(controller.receive(), Err(ReceiveError::Empty));
    assert_eq!(controller.overruns(), 0);
}

#[test]
fn a_controller_that_stays_in_its_mode_is_given_up() {
    let chip = Chip::new();
    chip.inside().stuck = true;
    let error = Controller::start(chip.clone(), BitRate::Kbit250, Filter::ALL).unwrap_err();
    assert_eq!(error, StartError::Mode(ModeError::StaysReset));

    let chip = Chip::new();
    let _former = chip.start();
    chip.inside().stuck = true;
    let error = Controller::start(chip.clone(), BitRate::Kbit250, Filter::ALL).unwrap_err();
    assert_eq!(error, StartError::Mode(ModeError::StaysOperating));
}

/// Reads as the same value everywhere.
struct Constant(u8);

impl Registers for Constant {
    fn read(&mut self, _: u8) -> u8 {
        self.0
    }
    fn write(&mut self, _: u8, _: u8) {}
}

#[test]
fn what_is_no_controller_is_told() {
    let start = |value| Controller::start(Constant(value), BitRate::Mbit1, Filter::ALL).err();
    assert_eq!(start(0xff), Some(StartError::Absent));
    assert_eq!(start(0x00), Some(StartError::Mode(ModeError::StaysOperating)));
    assert_eq!(start(0x01), Some(StartError::NotPeliCan(0x01)));
    let not_stored = StartError::NotStored { register: 16, written: 0, read: 0x81 };
    assert_eq!(start(0x81), Some(not_stored));
}

/// A card whose registers are further apart than its driver assumes: each is there four times.
#[derive(Debug)]
struct WrongStride(Chip);

impl Registers for WrongStride {
    fn read(&mut self, register: u8) -> u8 {
        self.0.read(register / 4)
    }
    fn write(&mut self, register: u8, value: u8) {
        self.0.write(register / 4, value);
    }
}

#[test]
fn a_wrong_stride_does_not_start() {
    let chip = Chip::new();
    let _former = chip.start();
    let error = Controller::start(WrongStride(chip), BitRate::Mbit1, Filter::ALL).unwrap_err();
    assert_eq!(error, StartError::NotPeliCan(0));
}
