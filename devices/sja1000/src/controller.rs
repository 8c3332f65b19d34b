//! One controller: started once, then polled.

use crate::buffer;
use crate::error::{ModeError, ReceiveError, StartError, TransmitError};
use crate::filter::Filter;
use crate::frame::Frame;
use crate::registers::{
    ACCEPTANCE, BUFFER, BUS_TIMING_0, BUS_TIMING_1, CLOCK_DIVIDER, COMMAND, ERROR_WARNING_LIMIT,
    INTERRUPT, INTERRUPT_ENABLE, MODE, OUTPUT_CONTROL, RECEIVE_ERRORS, Registers, STATUS,
    TRANSMIT_ERRORS, command, mode, status,
};
use crate::state::{BusState, ErrorCounters};
use crate::timing::BitRate;

/// How often a change of mode is requested before the controller is given up. It needs a few cycles
/// of its crystal, less than one access to a card takes.
pub const MODE_ATTEMPTS: u32 = 100;

/// Most frames that the receive buffer can hold: it has 64 bytes, and the shortest frame takes 3
/// (data sheet, section 6.4.14).
pub const RECEIVE_BUFFER_FRAMES: u32 = 21;

/// Clock divider register: PeliCAN mode, the receive comparator bypassed in favour of an external
/// transceiver, no clock output.
const CLOCK_DIVIDER_VALUE: u8 = PELICAN | 1 << 6 | 1 << 3;
const PELICAN: u8 = 1 << 7;
/// Output control register: normal output, both drivers push-pull, as the cards that Linux knows
/// are wired (`drivers/net/can/sja1000/kvaser_pci.c`, `ems_pci.c`, `plx_pci.c`).
const OUTPUT_CONTROL_VALUE: u8 = 0xda;
/// Error warning limit, as after a hardware reset.
const ERROR_WARNING_LIMIT_VALUE: u8 = 96;

/// A controller that has been started.
#[derive(Debug)]
pub struct Controller<R> {
    registers: R,
    /// The mode register while it operates.
    mode: u8,
    overruns: u64,
}

impl<R: Registers> Controller<R> {
    /// Resets the controller, sets it up, and takes it onto the bus, which it joins after 11
    /// recessive bits. Interrupts stay off. What it had received before is thrown away, and so
    /// are its error counters: this is also the way back from any state.
    ///
    /// About 40 accesses, and at most 500 with a bad card.
    ///
    /// # Errors
    /// [`StartError`] if it is not there, or does not behave like an SJA1000.
    pub fn start(registers: R, rate: BitRate, filter: Filter) -> Result<Self, StartError> {
        let mut this = Self { registers, mode: filter.mode(), overruns: 0 };
        if this.registers.read(MODE) == mode::ABSENT {
            return Err(StartError::Absent);
        }
        this.enter_reset()?;
        this.registers.write(CLOCK_DIVIDER, CLOCK_DIVIDER_VALUE);
        let divider = this.registers.read(CLOCK_DIVIDER);
        if divider & PELICAN == 0 {
            return Err(StartError::NotPeliCan(divider));
        }
        this.configure(rate, filter)?;
        this.leave_reset()?;
        this.discard_received();
        Ok(this)
    }

    /// Hands a frame over for transmission. It is sent as soon as the bus allows, and again until
    /// another node has acknowledged it.
    ///
    /// At most 15 accesses; 1 if it is not taken.
    ///
    /// # Errors
    /// [`TransmitError`] if it was not taken; nothing has changed then.
    pub fn transmit(&mut self, frame: &Frame) -> Result<(), TransmitError> {
        let status = self.registers.read(STATUS);
        if status & status::BUS_OFF != 0 {
            return Err(TransmitError::BusOff);
        }
        if status & status::TRANSMIT_BUFFER_FREE == 0 {
            return Err(TransmitError::Busy);
        }
        let bytes = buffer::encode(frame);
        let length = buffer::length(bytes[0]);
        for (register, byte) in (BUFFER..).zip(bytes).take(length) {
            self.registers.write(register, byte);
        }
        self.registers.write(COMMAND, command::TRANSMIT);
        Ok(())
    }

    /// Takes the oldest frame that has been received.
    ///
    /// At most 16 accesses; 1 if there is none. A loop of calls needs a bound: a controller
    /// may claim for ever that there is one more.
    ///
    /// # Errors
    /// [`ReceiveError`] if there is none.
    pub fn receive(&mut self) -> Result<Frame, ReceiveError> {
        let status = self.registers.read(STATUS);
        if status & status::BUS_OFF != 0 {
            return Err(ReceiveError::BusOff);
        }
        if status & status::OVERRUN != 0 {
            self.overruns = self.overruns.saturating_add(1);
            self.registers.write(COMMAND, command::CLEAR_OVERRUN);
        }
        if status & status::RECEIVED == 0 {
            return Err(ReceiveError::Empty);
        }
        let mut bytes = [0; buffer::BYTES];
        bytes[0] = self.registers.read(BUFFER);
        let length = buffer::length(bytes[0]);
        for (register, byte) in (BUFFER..).zip(&mut bytes).take(length).skip(1) {
            *byte = self.registers.read(register);
        }
        self.registers.write(COMMAND, command::RELEASE_RECEIVE_BUFFER);
        Ok(buffer::decode(&bytes))
    }

    /// How often [`receive`](Self::receive) has found that frames were lost because those before them
    /// had not been taken. How many were lost each time, the controller does not know.
    pub const fn overruns(&self) -> u64 {
        self.overruns
    }

    /// The part that the controller takes in the bus. 4 accesses.
    pub fn state(&mut self) -> BusState {
        let mode = self.registers.read(MODE);
        let status = self.registers.read(STATUS);
        let counters = self.error_counters();
        let reset = mode & mode::RESET != 0;
        if mode == mode::ABSENT {
            BusState::Absent
        } else if status & status::BUS_OFF != 0 {
            if reset { BusState::BusOff } else { BusState::Recovering }
        } else if reset {
            BusState::Reset
        } else if counters.are_passive() {
            BusState::Passive
        } else if status & status::ERROR != 0 {
            BusState::Warning
        } else {
            BusState::Active
        }
    }

    /// The error counters. 2 accesses.
    pub fn error_counters(&mut self) -> ErrorCounters {
        ErrorCounters {
            transmit: self.registers.read(TRANSMIT_ERRORS),
            receive: self.registers.read(RECEIVE_ERRORS),
        }
    }

    /// Sends a controller that is off the bus back to it, as set up before. It is
    /// [`Recovering`](BusState::Recovering) until the bus has been idle 128 times for 11 bits, 6 ms
    /// at 250 kbit/s; this does not wait for that.
    ///
    /// Whether to come back, and how often, is the program's decision: a controller that has gone
    /// off the bus was disturbing it, or was disturbed. 2 accesses; with a bad card 2 for each of
    /// [`MODE_ATTEMPTS`].
    ///
    /// # Errors
    /// [`ModeError`] if it stays in reset mode.
    pub fn recover(&mut self) -> Result<(), ModeError> {
        self.leave_reset()
    }

    /// As [`recover`](Self::recover), without a look at whether the controller obeys: what it does next says so. 1 access.
    pub fn request_recovery(&mut self) {
        self.registers.write(MODE, self.mode);
    }

    fn enter_reset(&mut self) -> Result<(), ModeError> {
        self.change_mode(mode::RESET, mode::RESET).ok_or(ModeError::StaysOperating)
    }

    /// Bits other than reset mode itself can only be changed in reset mode, so here is where the
    /// kind of filter takes effect.
    fn leave_reset(&mut self) -> Result<(), ModeError> {
        self.change_mode(self.mode, 0).ok_or(ModeError::StaysReset)
    }

    /// Writes `value` until the reset bit reads as `reset`.
    fn change_mode(&mut self, value: u8, reset: u8) -> Option<()> {
        for _ in 0..MODE_ATTEMPTS {
            self.registers.write(MODE, value);
            if self.registers.read(MODE) & mode::RESET == reset {
                return Some(());
            }
        }
        None
    }

    /// Writes everything that can only be written in reset mode.
    fn configure(&mut self, rate: BitRate, filter: Filter) -> Result<(), StartError> {
        self.registers.write(INTERRUPT_ENABLE, 0);
        let [first, second] = rate.registers();
        self.registers.write(BUS_TIMING_0, first);
        self.registers.write(BUS_TIMING_1, second);
        self.registers.write(OUTPUT_CONTROL, OUTPUT_CONTROL_VALUE);
        self.registers.write(ERROR_WARNING_LIMIT, ERROR_WARNING_LIMIT_VALUE);
        self.registers.write(RECEIVE_ERRORS, 0);
        self.registers.write(TRANSMIT_ERRORS, 0);
        for (register, written) in (ACCEPTANCE..).zip(filter.registers()) {
            self.registers.write(register, written);
        }
        for (register, written) in (ACCEPTANCE..).zip(filter.registers()) {
            let read = self.registers.read(register);
            if read != written {
                return Err(StartError::NotStored { register, written, read });
            }
        }
        // Reading is what clears it.
        let _ = self.registers.read(INTERRUPT);
        Ok(())
    }

    /// Empties the receive buffer. Reset mode has done so in a real controller, not in QEMU's
    /// (7.2), where a program that is started anew would find frames of its former life.
    fn discard_received(&mut self) {
        for _ in 0..RECEIVE_BUFFER_FRAMES {
            if self.registers.read(STATUS) & status::RECEIVED == 0 {
                break;
            }
            self.registers.write(COMMAND, command::RELEASE_RECEIVE_BUFFER);
        }
        self.registers.write(COMMAND, command::CLEAR_OVERRUN);
    }
}
