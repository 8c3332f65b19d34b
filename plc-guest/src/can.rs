//! CAN controllers of cards in I/O space.
//!
//! The partition file decides at which ports a guest sees a card's base address register
//! (`[[partition.port_io]]`), so a program can have that as a constant; how the registers lie from
//! there on is a property of the card.

use takt_sja1000::{Registers, cards::Card};

use crate::io;

/// The registers of one SJA1000 behind I/O ports. Each access is one exit from the guest.
#[derive(Debug)]
pub struct Ports {
    base: u16,
    stride: u8,
}

impl Ports {
    /// The controller of such a card, whose base address register this guest sees from port `base`
    /// on.
    #[must_use]
    pub const fn new(base: u16, card: Card) -> Self {
        Self { base, stride: card.stride }
    }

    const fn port(&self, register: u8) -> u16 {
        self.base.wrapping_add(register as u16 * self.stride as u16)
    }
}

impl Registers for Ports {
    fn read(&mut self, register: u8) -> u8 {
        io::inb(self.port(register))
    }

    fn write(&mut self, register: u8, value: u8) {
        io::outb(self.port(register), value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_sja1000::cards::{KVASER_PCI, MIOE3680};

    #[test]
    fn registers_lie_as_the_card_says() {
        let last = 31;
        assert_eq!(Ports::new(0x2000, KVASER_PCI).port(last), 0x201f);
        assert_eq!(Ports::new(0x2400, MIOE3680).port(last), 0x247c);
    }
}
