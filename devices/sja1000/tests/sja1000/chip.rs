//! A model of the SJA1000, written from the data sheet and not from the driver.
//!
//! It is strict: what the data sheet forbids or says to be without effect is recorded as a
//! violation, so that a driver that gets away with something here has not got away with it unseen.

use std::cell::{RefCell, RefMut};
use std::collections::VecDeque;
use std::rc::Rc;

use takt_sja1000::{BitRate, Controller, Filter, Registers};

const RESET: u8 = 0x01;
const SINGLE: u8 = 0x08;
const PELICAN: u8 = 0x80;

/// The chip's inside. A test sets what it needs and looks at what came of it.
#[derive(Debug)]
pub struct Inside {
    pub mode: u8,
    pub clock: u8,
    pub interrupt_enable: u8,
    pub timing: [u8; 2],
    pub output: u8,
    pub warning_limit: u8,
    pub receive_errors: u8,
    pub transmit_errors: u8,
    pub acceptance: [u8; 8],
    pub transmit_buffer: [u8; 13],
    /// Frames as bytes, oldest first.
    pub received: VecDeque<Vec<u8>>,
    pub overrun: bool,
    pub bus_off: bool,
    /// Frames that have been sent, as bytes of the transmit buffer.
    pub sent: Vec<[u8; 13]>,
    /// No other node acknowledges: what is to be sent stays in the buffer.
    pub alone: bool,
    /// Keeps its receive buffer in reset mode, as QEMU's does.
    pub keeps_received: bool,
    /// Never leaves the mode that it is in.
    pub stuck: bool,
    pub pending: bool,
    pub accesses: u32,
    pub violations: Vec<String>,
}

/// A handle on the chip: the driver has one, the test another.
#[derive(Clone, Debug)]
pub struct Chip(Rc<RefCell<Inside>>);

impl Chip {
    /// As after a hardware reset: BasicCAN, in reset mode, other registers at random.
    pub fn new() -> Self {
        Self(Rc::new(RefCell::new(Inside {
            mode: RESET,
            clock: 0,
            interrupt_enable: 0xff,
            timing: [0x5a; 2],
            output: 0x5a,
            warning_limit: 0x5a,
            receive_errors: 0,
            transmit_errors: 0,
            acceptance: [0x5a; 8],
            transmit_buffer: [0x5a; 13],
            received: VecDeque::new(),
            overrun: false,
            bus_off: false,
            sent: Vec::new(),
            alone: false,
            keeps_received: false,
            stuck: false,
            pending: false,
            accesses: 0,
            violations: Vec::new(),
        })))
    }

    pub fn inside(&self) -> RefMut<'_, Inside> {
        self.0.borrow_mut()
    }

    /// A driver for it that receives everything.
    pub fn start(&self) -> Controller<Chip> {
        Controller::start(self.clone(), BitRate::Kbit500, Filter::ALL).unwrap()
    }

    /// A frame on the bus, as bytes of the receive buffer. Returns whether it passed the filter.
    pub fn deliver(&self, bytes: &[u8]) -> bool {
        let mut inside = self.inside();
        let passed = inside.accepts(bytes);
        if passed {
            let used: usize = inside.received.iter().map(Vec::len).sum();
            if used + bytes.len() > 64 {
                inside.overrun = true;
            } else {
                inside.received.push_back(bytes.to_vec());
            }
        }
        passed
    }
}

impl Inside {
    fn is_reset(&self) -> bool {
        self.mode & RESET != 0
    }

    fn violation(&mut self, register: u8, value: u8) {
        self.violations
            .push(format!("{value:#04x} to register {register}, mode {:#04x}", self.mode));
    }

    fn set_mode(&mut self, value: u8) {
        if self.stuck {
            return;
        }
        let was_reset = self.is_reset();
        let locked = if was_reset { 0 } else { 0x0e };
        self.mode = (self.mode & locked) | (value & 0x1f & !locked);
        if self.is_reset() && !was_reset {
            self.pending = false;
            if !self.keeps_received {
                self.received.clear();
                self.overrun = false;
            }
        }
    }

    fn status(&self) -> u8 {
        let warning = self.transmit_errors.max(self.receive_errors) >= self.warning_limit;
        u8::from(!self.received.is_empty())
            | u8::from(self.overrun) << 1
            | u8::from(!self.pending) << 2
            | u8::from(!self.pending) << 3
            | u8::from(warning || self.bus_off) << 6
            | u8::from(self.bus_off) << 7
    }

    fn command(&mut self, value: u8) {
        if value & 1 != 0 {
            self.pending = self.alone;
            if !self.alone {
                let frame = self.transmit_buffer;
                self.sent.push(frame);
            }
        }
        if value & 4 != 0 {
            self.received.pop_front();
        }
        if value & 8 != 0 {
            self.overrun = false;
        }
    }

    /// Data sheet, section 6.4.15.
    fn accepts(&self, bytes: &[u8]) -> bool {
        if self.is_reset() || self.bus_off {
            return false;
        }
        let extended = bytes[0] & 0x80 != 0;
        let remote = bytes[0] & 0x40 != 0;
        let single = self.mode & SINGLE != 0;
        // Each filter: registers, what they are compared with, and in which bits.
        let mut first = Vec::new();
        let mut second = Vec::new();
        if extended && single {
            let last = bytes[4] & 0xf8 | u8::from(remote) << 2;
            first.extend([(0, bytes[1], 0xff), (1, bytes[2], 0xff)]);
            first.extend([(2, bytes[3], 0xff), (3, last, 0xfc)]);
        } else if extended {
            first.extend([(0, bytes[1], 0xff), (1, bytes[2], 0xff)]);
            second.extend([(2, bytes[1], 0xff), (3, bytes[2], 0xff)]);
        } else {
            let low = bytes[2] & 0xe0 | u8::from(remote) << 4;
            first.extend([(0, bytes[1], 0xff), (1, low, 0xf0)]);
            if single {
                let data = bytes[3..].iter().take(2);
                first.extend((2..).zip(data).map(|(register, byte)| (register, *byte, 0xff)));
            } else {
                second.extend([(2, bytes[1], 0xff), (3, low, 0xf0)]);
                if let Some(byte) = bytes.get(3) {
                    first.extend([(1, byte >> 4, 0x0f), (3, byte & 0x0f, 0x0f)]);
                }
            }
        }
        let (code, mask) = self.acceptance.split_at(4);
        let passes = |filter: &[(usize, u8, u8)]| {
            filter.iter().all(|(i, byte, relevant)| (byte ^ code[*i]) & relevant & !mask[*i] == 0)
        };
        passes(&first) || (!single && passes(&second))
    }
}

impl Registers for Chip {
    fn read(&mut self, register: u8) -> u8 {
        let mut inside = self.inside();
        inside.accesses += 1;
        let reset = inside.is_reset();
        match register {
            0 => inside.mode,
            31 => inside.clock,
            _ if inside.clock & PELICAN == 0 => 0xff,
            2 => inside.status(),
            4 => inside.interrupt_enable,
            14 => inside.receive_errors,
            15 => inside.transmit_errors,
            16..24 if reset => inside.acceptance[usize::from(register) - 16],
            // Behind the frame lies what was there before it.
            16..29 if !reset => {
                let frame = inside.received.front();
                let byte = frame.and_then(|frame| frame.get(usize::from(register) - 16));
                byte.copied().unwrap_or(0xa5)
            }
            _ => 0,
        }
    }

    fn write(&mut self, register: u8, value: u8) {
        let mut inside = self.inside();
        inside.accesses += 1;
        let reset = inside.is_reset();
        match register {
            0 => inside.set_mode(value),
            31 if reset => inside.clock = value,
            _ if inside.clock & PELICAN == 0 => inside.violation(register, value),
            1 => inside.command(value),
            4 => inside.interrupt_enable = value,
            6 | 7 if reset => inside.timing[usize::from(register) - 6] = value,
            8 if reset => inside.output = value,
            13 if reset => inside.warning_limit = value,
            14 if reset => inside.receive_errors = value,
            15 if reset => {
                inside.transmit_errors = value;
                inside.bus_off &= value == 255;
            }
            16..24 if reset => inside.acceptance[usize::from(register) - 16] = value,
            16..29 if !reset && !inside.pending => {
                inside.transmit_buffer[usize::from(register) - 16] = value;
            }
            _ => inside.violation(register, value),
        }
    }
}
