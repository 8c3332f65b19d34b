//! How a guest machine asks to be switched off or restarted.
//!
//! Linux has two ways, and both are here so that neither is mistaken for a crash: the sleep and
//! reset registers of hardware-reduced ACPI (specification 6.5, sections 4.8.3.6 and 4.8.3.7),
//! and the reset line of the keyboard controller, which it tries next. It may use both in a row;
//! the first request wins.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use vm_superio::{I8042Device, Trigger};

use crate::ports::PortDevice;

/// What a guest machine asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerRequest {
    /// Switch off.
    Off,
    /// Start again.
    Reset,
}

/// The line on which the request waits until the vCPU's thread looks at it.
#[derive(Clone, Debug, Default)]
pub struct PowerLine(Arc<AtomicU8>);

impl PowerLine {
    const OFF: u8 = 1;
    const RESET: u8 = 2;

    /// The request, if there has been one.
    #[must_use]
    pub fn request(&self) -> Option<PowerRequest> {
        match self.0.load(Ordering::Relaxed) {
            Self::OFF => Some(PowerRequest::Off),
            Self::RESET => Some(PowerRequest::Reset),
            _ => None,
        }
    }

    fn raise(&self, request: u8) {
        let _ = self.0.compare_exchange(0, request, Ordering::Relaxed, Ordering::Relaxed);
    }
}

/// The ACPI registers: sleep control, sleep status, reset, one byte each.
pub struct AcpiPower(pub PowerLine);

impl AcpiPower {
    /// Offset of the sleep control register.
    pub const SLEEP_CONTROL: u16 = 0;
    /// Offset of the sleep status register.
    pub const SLEEP_STATUS: u16 = 1;
    /// Offset of the reset register.
    pub const RESET: u16 = 2;
    /// What the guest writes to the reset register.
    pub const RESET_VALUE: u8 = 1;
    /// Sleep type of "soft off" (S5), as the DSDT tells it to the guest.
    pub const SOFT_OFF: u8 = 5;

    /// SLP_EN in the sleep control register; SLP_TYP lies in the three bits below it.
    const SLEEP_ENABLE: u8 = 1 << 5;
}

impl PortDevice for AcpiPower {
    fn read(&mut self, _offset: u16, data: &mut [u8]) {
        data.fill(0);
    }

    fn write(&mut self, offset: u16, data: &[u8]) {
        match (offset, data) {
            (Self::SLEEP_CONTROL, &[value])
                if value & Self::SLEEP_ENABLE != 0 && (value >> 2) & 7 == Self::SOFT_OFF =>
            {
                self.0.raise(PowerLine::OFF);
            }
            (Self::RESET, &[Self::RESET_VALUE]) => self.0.raise(PowerLine::RESET),
            _ => {}
        }
    }
}

impl Trigger for PowerLine {
    type E = std::convert::Infallible;

    fn trigger(&self) -> Result<(), Self::E> {
        self.raise(PowerLine::RESET);
        Ok(())
    }
}

/// The keyboard controller, of which only the reset line is wired.
pub struct KeyboardController(I8042Device<PowerLine>);

impl KeyboardController {
    /// One whose reset line is `line`.
    #[must_use]
    pub fn new(line: PowerLine) -> Self {
        Self(I8042Device::new(line))
    }
}

impl PortDevice for KeyboardController {
    fn read(&mut self, offset: u16, data: &mut [u8]) {
        data.fill(0);
        if let (Ok(offset), [value]) = (u8::try_from(offset), data) {
            *value = self.0.read(offset);
        }
    }

    fn write(&mut self, offset: u16, data: &[u8]) {
        if let (Ok(offset), &[value]) = (u8::try_from(offset), data) {
            let Ok(()) = self.0.write(offset, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleep_type_five_with_the_enable_bit_switches_off() {
        let line = PowerLine::default();
        let mut acpi = AcpiPower(line.clone());
        for harmless in [0, 5 << 2, 0x20, 0x20 | 3 << 2, 0xc0] {
            acpi.write(AcpiPower::SLEEP_CONTROL, &[harmless]);
            assert_eq!(line.request(), None, "{harmless:#x}");
        }
        acpi.write(AcpiPower::SLEEP_CONTROL, &[0x20 | 5 << 2]);
        assert_eq!(line.request(), Some(PowerRequest::Off));
    }

    #[test]
    fn the_first_request_wins() {
        let line = PowerLine::default();
        AcpiPower(line.clone()).write(AcpiPower::RESET, &[AcpiPower::RESET_VALUE]);
        AcpiPower(line.clone()).write(AcpiPower::SLEEP_CONTROL, &[0x34]);
        assert_eq!(line.request(), Some(PowerRequest::Reset));
    }

    #[test]
    fn the_keyboard_controller_resets_on_its_command_only() {
        let line = PowerLine::default();
        let mut keyboard = KeyboardController::new(line.clone());
        for port in 0..=4 {
            for value in 0..=0xfd {
                keyboard.write(port, &[value]);
            }
        }
        keyboard.write(4, &[0xfe, 0xfe]);
        keyboard.write(u16::MAX, &[0xfe]);
        assert_eq!(line.request(), None);
        keyboard.write(4, &[0xfe]);
        assert_eq!(line.request(), Some(PowerRequest::Reset));
    }
}
