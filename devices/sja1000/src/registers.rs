//! The registers of PeliCAN mode and their bits: data sheet, sections 6.4 and 6.5.

/// Access to the 32 registers of one controller, in whatever way the card offers.
pub trait Registers {
    /// Reads register `register`, 0 to 31. Some registers change when they are read.
    fn read(&mut self, register: u8) -> u8;
    /// Writes register `register`, 0 to 31.
    fn write(&mut self, register: u8, value: u8);
}

/// Mode register (section 6.4.3).
pub(crate) const MODE: u8 = 0;
/// Command register (6.4.4), write only.
pub(crate) const COMMAND: u8 = 1;
/// Status register (6.4.5), read only.
pub(crate) const STATUS: u8 = 2;
/// Interrupt register (6.4.6): reading clears all of it but the receive interrupt.
pub(crate) const INTERRUPT: u8 = 3;
/// Interrupt enable register (6.4.7).
pub(crate) const INTERRUPT_ENABLE: u8 = 4;
/// Bus timing register 0 (6.5.1).
pub(crate) const BUS_TIMING_0: u8 = 6;
/// Bus timing register 1 (6.5.2).
pub(crate) const BUS_TIMING_1: u8 = 7;
/// Output control register (6.5.3).
pub(crate) const OUTPUT_CONTROL: u8 = 8;
/// Error warning limit (6.4.10).
pub(crate) const ERROR_WARNING_LIMIT: u8 = 13;
/// Receive error counter (6.4.11).
pub(crate) const RECEIVE_ERRORS: u8 = 14;
/// Transmit error counter (6.4.12).
pub(crate) const TRANSMIT_ERRORS: u8 = 15;
/// First of 13 bytes: the transmit buffer when written, the receive buffer when read (6.4.13,
/// 6.4.14), while the controller operates.
pub(crate) const BUFFER: u8 = 16;
/// First of four bytes of acceptance code, then four of mask (6.4.15), in reset mode.
pub(crate) const ACCEPTANCE: u8 = 16;
/// Clock divider register (6.5.4).
pub(crate) const CLOCK_DIVIDER: u8 = 31;

/// Bits of [`MODE`].
pub(crate) mod mode {
    /// Reset mode: off the bus, and the only mode in which the controller can be configured.
    pub(crate) const RESET: u8 = 1 << 0;
    /// One acceptance filter of 32 bits instead of two shorter ones.
    pub(crate) const SINGLE_FILTER: u8 = 1 << 3;
    /// What the register reads as if nothing answers; its upper three bits are always 0.
    pub(crate) const ABSENT: u8 = 0xff;
}

/// Bits of [`COMMAND`].
pub(crate) mod command {
    /// Send what is in the transmit buffer.
    pub(crate) const TRANSMIT: u8 = 1 << 0;
    /// The frame in the receive buffer has been read; show the next.
    pub(crate) const RELEASE_RECEIVE_BUFFER: u8 = 1 << 2;
    /// The data overrun has been noticed.
    pub(crate) const CLEAR_OVERRUN: u8 = 1 << 3;
}

/// Bits of [`STATUS`].
pub(crate) mod status {
    /// There is a frame in the receive buffer.
    pub(crate) const RECEIVED: u8 = 1 << 0;
    /// A frame was lost because there was no room for it.
    pub(crate) const OVERRUN: u8 = 1 << 1;
    /// The transmit buffer may be written.
    pub(crate) const TRANSMIT_BUFFER_FREE: u8 = 1 << 2;
    /// An error counter has reached the warning limit.
    pub(crate) const ERROR: u8 = 1 << 6;
    /// The controller takes no part in the bus because of errors.
    pub(crate) const BUS_OFF: u8 = 1 << 7;
}
