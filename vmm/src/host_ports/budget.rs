//! How much a port may do between two ticks.
//!
//! The supervisor thread competes with a Linux guest in the background for the same CPU. A client that
//! floods a socket must not make it work more than a port may cost; and what one port does must
//! not keep the others, the keyboard and the records of the windows waiting.

/// Messages, connections included, in one tick.
const MESSAGES: u32 = 64;
/// Bytes in one tick, so that long messages come to no more time than many short ones. The
/// message that reaches the bound is still whole.
const BYTES: usize = 256 << 10;

/// Messages of this length that a tick serves: one at least.
#[must_use]
pub const fn messages_of(bytes: usize) -> usize {
    let most = if bytes == 0 { MESSAGES as usize } else { BYTES.div_ceil(bytes) };
    if most < MESSAGES as usize { most } else { MESSAGES as usize }
}

/// What is left of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    messages: u32,
    bytes: usize,
}

impl Budget {
    /// That of one tick.
    pub const TICK: Budget = Budget { messages: MESSAGES, bytes: BYTES };

    /// Whether one more may be served.
    #[must_use]
    pub const fn is_left(&self) -> bool {
        self.messages > 0 && self.bytes > 0
    }

    /// Takes off one message, or a connection, which has no bytes.
    pub const fn spend(&mut self, bytes: usize) {
        self.messages = self.messages.saturating_sub(1);
        self.bytes = self.bytes.saturating_sub(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_short_messages_and_few_long_ones_use_it_up() {
        let count = |bytes| {
            let mut budget = Budget::TICK;
            let mut count = 0;
            while budget.is_left() {
                budget.spend(bytes);
                count += 1;
            }
            count
        };
        assert_eq!((count(0), count(1), count(65_536)), (64, 64, 4));
    }
}
