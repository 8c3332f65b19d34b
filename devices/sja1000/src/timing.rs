//! Bit timing: what the two bus timing registers must be for a rate.
//!
//! A bit is divided into time quanta of `2 * (prescaler + 1) / crystal`: one for synchronisation,
//! then segment 1, the sample, segment 2 (data sheet, sections 6.5.1 and 6.5.2). The registers hold
//! each value less one. Every node of a bus must sample at about the same place, and where that is
//! depends on the bus, not on this controller: CiA 301 recommends 87.5 % of the bit for rates up to
//! 800 kbit/s, and 75 % at 1 Mbit/s leaves more for the second segment of a shorter bit.

/// Rate of the bus, for a controller with a crystal of 16 MHz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BitRate {
    /// 10 kbit/s: 16 quanta of 6250 ns, sampled at 87.5 %.
    Kbit10,
    /// 20 kbit/s: 16 quanta of 3125 ns, sampled at 87.5 %.
    Kbit20,
    /// 50 kbit/s: 16 quanta of 1250 ns, sampled at 87.5 %.
    Kbit50,
    /// 100 kbit/s: 16 quanta of 625 ns, sampled at 87.5 %.
    Kbit100,
    /// 125 kbit/s: 16 quanta of 500 ns, sampled at 87.5 %.
    Kbit125,
    /// 250 kbit/s: 16 quanta of 250 ns, sampled at 87.5 %.
    Kbit250,
    /// 500 kbit/s: 16 quanta of 125 ns, sampled at 87.5 %.
    Kbit500,
    /// 1 Mbit/s: 8 quanta of 125 ns, sampled at 75 %.
    Mbit1,
}

impl BitRate {
    const ALL: [(Self, u32); 8] = [
        (Self::Kbit10, 10),
        (Self::Kbit20, 20),
        (Self::Kbit50, 50),
        (Self::Kbit100, 100),
        (Self::Kbit125, 125),
        (Self::Kbit250, 250),
        (Self::Kbit500, 500),
        (Self::Mbit1, 1000),
    ];

    /// That of so many kbit/s, if it is one of these.
    #[must_use]
    pub fn from_kbit_per_s(rate: u32) -> Option<Self> {
        Self::ALL.iter().find(|(_, kbit)| *kbit == rate).map(|(rate, _)| *rate)
    }

    /// Bus timing registers 0 and 1. The jump width is one quantum, and each bit is sampled once,
    /// which is what the data sheet recommends above 100 kbit/s.
    pub(crate) const fn registers(self) -> [u8; 2] {
        match self {
            Self::Kbit10 => registers(50, 13, 2),
            Self::Kbit20 => registers(25, 13, 2),
            Self::Kbit50 => registers(10, 13, 2),
            Self::Kbit100 => registers(5, 13, 2),
            Self::Kbit125 => registers(4, 13, 2),
            Self::Kbit250 => registers(2, 13, 2),
            Self::Kbit500 => registers(1, 13, 2),
            Self::Mbit1 => registers(1, 5, 2),
        }
    }
}

/// Registers for a prescaler of 1 to 64 and segments of 1 to 16 and 1 to 8 quanta.
const fn registers(prescaler: u8, segment_1: u8, segment_2: u8) -> [u8; 2] {
    [prescaler - 1, (segment_2 - 1) << 4 | (segment_1 - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rate in bit/s and sample point in tenths of a percent, by the formulas of the data sheet.
    fn meaning([first, second]: [u8; 2]) -> (u32, u32) {
        let prescaler = u32::from(first & 0x3f);
        let segment_1 = u32::from(second & 0xf) + 1;
        let segment_2 = u32::from(second >> 4 & 0x7) + 1;
        let quanta = 1 + segment_1 + segment_2;
        (16_000_000 / (2 * (prescaler + 1) * quanta), 1000 * (1 + segment_1) / quanta)
    }

    #[test]
    fn registers_mean_the_rate_and_the_sample_point() {
        for (rate, kbit) in BitRate::ALL {
            let sample = if rate == BitRate::Mbit1 { 750 } else { 875 };
            assert_eq!(meaning(rate.registers()), (1000 * kbit, sample), "{rate:?}");
            assert_eq!(BitRate::from_kbit_per_s(kbit), Some(rate));
        }
        assert_eq!(BitRate::from_kbit_per_s(0), None);
        assert_eq!(BitRate::from_kbit_per_s(800), None);
    }

    #[test]
    fn one_sample_and_a_jump_of_one_quantum() {
        for (rate, _) in BitRate::ALL {
            let [first, second] = rate.registers();
            assert_eq!((first >> 6, second >> 7), (0, 0), "{rate:?}");
        }
    }
}
