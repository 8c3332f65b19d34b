//! Whether numbered messages arrive complete and in order.

/// Counts what arrives of a sequence that starts with 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sequence {
    /// Highest number so far.
    last: u64,
    /// Messages that have arrived.
    pub received: u64,
    /// Numbers that were left out. One that arrives later is still among them.
    pub lost: u64,
    /// Messages that arrived after one with the same or a higher number.
    pub disordered: u64,
}

impl Sequence {
    /// A message with this number has arrived.
    pub fn arrived(&mut self, number: u64) {
        self.received += 1;
        if number <= self.last {
            self.disordered += 1;
        } else {
            self.lost = self.lost.saturating_add(number - self.last - 1);
            self.last = number;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Received, lost, disordered.
    fn counts(numbers: &[u64]) -> (u64, u64, u64) {
        let mut sequence = Sequence::default();
        numbers.iter().for_each(|number| sequence.arrived(*number));
        (sequence.received, sequence.lost, sequence.disordered)
    }

    #[test]
    fn a_complete_sequence_has_no_losses() {
        assert_eq!(counts(&[1, 2, 3, 4]), (4, 0, 0));
    }

    #[test]
    fn gaps_are_counted_by_what_is_missing() {
        assert_eq!(counts(&[3]), (1, 2, 0));
        assert_eq!(counts(&[1, 2, 6, 7, 9]), (5, 4, 0));
        assert_eq!(counts(&[u64::MAX, 1]), (2, u64::MAX - 1, 1));
    }

    #[test]
    fn repeated_and_late_messages_are_disordered() {
        assert_eq!(counts(&[1, 1, 2]), (3, 0, 1));
        assert_eq!(counts(&[1, 3, 2, 4]), (4, 1, 1));
        assert_eq!(counts(&[0]), (1, 0, 1));
    }
}
