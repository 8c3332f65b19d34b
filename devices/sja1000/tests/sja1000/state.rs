//! Error states, and the way back onto the bus.

use takt_sja1000::{BusState, ErrorCounters, Frame, ReceiveError, StandardId, TransmitError};

use crate::chip::Chip;

#[test]
fn counters_decide_the_state() {
    let chip = Chip::new();
    let mut controller = chip.start();
    let states = [
        (0, 0, BusState::Active),
        (95, 95, BusState::Active),
        (96, 0, BusState::Warning),
        (0, 96, BusState::Warning),
        (127, 127, BusState::Warning),
        (128, 0, BusState::Passive),
        (0, 128, BusState::Passive),
        (255, 0, BusState::Passive),
    ];
    for (transmit, receive, expected) in states {
        chip.inside().transmit_errors = transmit;
        chip.inside().receive_errors = receive;
        assert_eq!(controller.state(), expected, "{transmit}, {receive}");
        assert_eq!(controller.error_counters(), ErrorCounters { transmit, receive });
    }
}

/// Bit timing and filter.
fn set_up(chip: &Chip) -> ([u8; 2], [u8; 8]) {
    let inside = chip.inside();
    (inside.timing, inside.acceptance)
}

#[test]
fn off_the_bus_and_back() {
    let chip = Chip::new();
    let mut controller = chip.start();
    let before = set_up(&chip);
    chip.inside().bus_off = true;
    chip.inside().mode |= 1;
    chip.inside().transmit_errors = 127;
    let frame = Frame::data(StandardId::new(1).unwrap(), &[]).unwrap();
    assert_eq!(controller.state(), BusState::BusOff);
    assert_eq!(controller.transmit(&frame), Err(TransmitError::BusOff));
    assert_eq!(controller.receive(), Err(ReceiveError::BusOff));

    chip.inside().accesses = 0;
    assert_eq!(controller.recover(), Ok(()));
    assert_eq!(chip.inside().accesses, 2);
    assert_eq!(controller.state(), BusState::Recovering);
    chip.inside().mode |= 1;
    controller.request_recovery();
    assert_eq!(controller.state(), BusState::Recovering);
    assert_eq!(controller.transmit(&frame), Err(TransmitError::BusOff));

    chip.inside().bus_off = false;
    chip.inside().transmit_errors = 0;
    assert_eq!(controller.state(), BusState::Active);
    assert_eq!(controller.transmit(&frame), Ok(()));
    assert_eq!(set_up(&chip), before);
    assert_eq!(chip.inside().violations, [""; 0]);
}

#[test]
fn somebody_elses_reset_is_seen() {
    let chip = Chip::new();
    let mut controller = chip.start();
    chip.inside().mode |= 1;
    assert_eq!(controller.state(), BusState::Reset);
}
