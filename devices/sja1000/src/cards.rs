//! Where the controllers of some PCI cards are.
//!
//! All of them are in I/O space, and these are the cards that QEMU emulates; a card with memory
//! space differs only in its [`Registers`](crate::Registers).

/// Where one controller of a card is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Card {
    /// Base address register in which it is, at offset 0.
    pub bar: u8,
    /// Distance of its registers in bytes.
    pub stride: u8,
}

/// Kvaser PCIcan, the first of its up to four controllers. BAR 0 holds the PCI bridge (an S5920),
/// whose register 0x60 a real card needs to have set to 0x80808080 before it answers. (QEMU
/// `hw/net/can/can_kvaser_pci.c`; Linux `drivers/net/can/sja1000/kvaser_pci.c`.)
pub const KVASER_PCI: Card = Card { bar: 1, stride: 1 };

/// Advantech MIOe-3680, the first of its two controllers. (QEMU `hw/net/can/can_mioe3680_pci.c`.)
pub const MIOE3680: Card = Card { bar: 0, stride: 4 };

/// Advantech PCM-3680I, the first of its two controllers. (QEMU `hw/net/can/can_pcm3680_pci.c`.)
pub const PCM3680I: Card = Card { bar: 0, stride: 1 };
