//! The port, as a guest and the host use it.

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::output;

const DATA: u16 = 0;
const INTERRUPT_ENABLE: u16 = 1;

fn port() -> (SerialPort<Vec<u8>>, EventFd) {
    let irq = EventFd::new(vmm_sys_util::eventfd::EFD_NONBLOCK).unwrap();
    (SerialPort::new(IrqLine(irq.try_clone().unwrap()), Vec::new()), irq)
}

#[test]
fn output_goes_out_in_order() {
    let (mut port, _irq) = port();
    for byte in b"Linux version" {
        port.write(DATA, &[*byte]);
    }
    assert_eq!(port.lock().registers.writer(), b"Linux version");
}

#[test]
fn typed_bytes_arrive_in_order_also_beyond_the_fifo() {
    let (mut port, irq) = port();
    port.write(INTERRUPT_ENABLE, &[1]);
    let typed: Vec<u8> = (0..=255).cycle().take(1000).collect();
    assert_eq!(port.type_bytes(&typed), 1000);
    assert!(irq.read().is_ok());
    let mut value = [0];
    let seen: Vec<u8> = (0..1000)
        .map(|_| {
            port.read(DATA, &mut value);
            value[0]
        })
        .collect();
    assert_eq!(seen, typed);
}

#[test]
fn a_guest_that_does_not_read_cannot_make_the_queue_grow() {
    let (port, _irq) = port();
    let taken: usize = (0..100).map(|_| port.type_bytes(&[0; 1000])).sum();
    assert!(taken <= PENDING_MAX + 64, "{taken}");
}

#[test]
fn typing_does_not_wait_for_a_guest_that_holds_the_port() {
    let (port, _irq) = port();
    let held = port.clone();
    let guard = held.lock();
    assert_eq!(port.type_bytes(b"x"), 0);
    drop(guard);
    assert_eq!(port.type_bytes(b"x"), 1);
}

#[test]
fn a_full_output_is_told_before_a_write_waits_for_it() {
    let irq = EventFd::new(vmm_sys_util::eventfd::EFD_NONBLOCK).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let (out, mut end) = output::waiting(stop.clone());
    let mut port = SerialPort::new(IrqLine(irq), out);
    let mut printed = 0;
    while !port.would_wait(DATA, 2) {
        port.write(DATA, b"y");
        printed += 1;
    }
    // There is room for one byte, and for no string of them.
    assert!(!port.would_wait(DATA, 1));
    port.write(DATA, b"y");
    assert!(port.would_wait(DATA, 1));
    assert!(!port.would_wait(INTERRUPT_ENABLE, 1), "only what is printed waits");
    let mut seen = Vec::new();
    end.drain_into(&mut seen);
    assert_eq!(seen, vec![b'y'; printed + 1]);
    // What is longer than all of the room never finds more than that.
    assert!(!port.would_wait(DATA, usize::MAX));
    port.write(DATA, b"y");
    assert!(port.would_wait(DATA, usize::MAX));
    stop.store(true, Ordering::Relaxed);
    assert!(!port.would_wait(DATA, usize::MAX), "the run ends, and no reader is left");
}

#[test]
fn a_reset_forgets_what_was_typed_and_what_a_guest_has_set() {
    const LINE_CONTROL: u16 = 3;
    const MODEM_CONTROL: u16 = 4;
    const LINE_STATUS: u16 = 5;
    const DIVISOR_LATCH: u8 = 0x80;
    const LOOP_BACK: u8 = 0x10;

    let (mut port, irq) = port();
    port.write(INTERRUPT_ENABLE, &[1]);
    port.type_bytes(&[7; 1000]);
    port.write(LINE_CONTROL, &[DIVISOR_LATCH]);
    port.write(MODEM_CONTROL, &[LOOP_BACK]);
    port.reset();
    let _ = irq.read();
    let mut value = [0];
    for (register, expected) in [(INTERRUPT_ENABLE, 0), (LINE_CONTROL, 0), (MODEM_CONTROL, 0)] {
        port.read(register, &mut value);
        assert_eq!(value, [expected], "{register}");
    }
    port.read(LINE_STATUS, &mut value);
    assert_eq!(value[0] & 1, 0, "data are ready");
    // The next guest gets only what was typed for it, and no interrupt that it has not asked for.
    port.type_bytes(b"x");
    assert!(irq.read().is_err());
    port.read(DATA, &mut value);
    assert_eq!(&value, b"x");
}

#[test]
fn any_sequence_of_accesses_is_survived() {
    let (mut port, _irq) = port();
    // A small linear congruential generator: a fixed sequence, no dependency.
    let mut state = 1u32;
    for _ in 0..100_000 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (offset, value) = ((state >> 8) as u16, (state >> 24) as u8);
        let width = [1, 2, 4][(state >> 20) as usize % 3];
        if state & 0x8000_0000 == 0 {
            port.write(offset % 12, &[value; 4][..width]);
        } else {
            port.read(offset % 12, &mut [0; 4][..width]);
        }
        port.type_bytes(&[value]);
    }
}
