//! The consoles of partitions, for clients that attach to them.
//!
//! Takt keeps the last bytes of each, so that who attaches sees where it stands. No partition waits for a client: what
//! a client does not take is not kept for it but counted.

use std::collections::VecDeque;

use super::protocol::{ConsoleStart, hex};

/// Bytes that are kept of each console: some 200 lines.
pub const KEPT_BYTES: usize = 16 << 10;

/// What is kept of all consoles, in the order of the file.
pub(super) struct Consoles(Vec<Kept>);

struct Kept {
    last: VecDeque<u8>,
    /// Bytes that are kept no more.
    gone: u64,
}

impl Consoles {
    /// Of so many partitions.
    pub fn new(partitions: usize) -> Self {
        let kept = || Kept { last: VecDeque::with_capacity(KEPT_BYTES), gone: 0 };
        Self((0..partitions).map(|_| kept()).collect())
    }

    /// A partition has written something.
    pub fn wrote(&mut self, partition: usize, bytes: &[u8]) {
        let Some(kept) = self.0.get_mut(partition) else { return };
        let new = bytes.get(bytes.len().saturating_sub(KEPT_BYTES)..).unwrap_or_default();
        let excess = (kept.last.len() + new.len()).saturating_sub(KEPT_BYTES);
        kept.last.drain(..excess);
        kept.last.extend(new);
        kept.gone += (excess + bytes.len() - new.len()) as u64;
    }

    /// What a client finds that attaches now.
    pub fn start(&self, partition: usize, name: &str, terminal: bool) -> ConsoleStart {
        let kept = self.0.get(partition);
        let bytes = kept.map_or_else(Vec::new, |kept| kept.last.iter().copied().collect());
        ConsoleStart {
            partition: name.to_owned(),
            terminal,
            before: kept.map_or(0, |kept| kept.gone),
            bytes: hex(&bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_bytes_are_kept_and_the_others_counted() {
        let mut consoles = Consoles::new(2);
        let now = |consoles: &Consoles| {
            let start = consoles.start(1, "linux", true);
            (start.before, start.bytes.len() / 2)
        };
        consoles.wrote(1, b"login: ");
        assert_eq!(consoles.start(1, "linux", true).bytes, hex(b"login: "));
        consoles.wrote(1, &[b'x'; KEPT_BYTES]);
        assert_eq!(now(&consoles), (7, KEPT_BYTES));
        consoles.wrote(1, &[b'y'; KEPT_BYTES + 3]);
        assert_eq!(now(&consoles), (7 + KEPT_BYTES as u64 + 3, KEPT_BYTES));
        consoles.wrote(1, b"z");
        assert_eq!(now(&consoles), (7 + KEPT_BYTES as u64 + 4, KEPT_BYTES));
        assert!(consoles.start(1, "linux", true).bytes.ends_with("797a"));
        assert_eq!(consoles.0[1].last.capacity(), KEPT_BYTES, "it has grown");
        assert_eq!(consoles.start(0, "plc", false).bytes, "");
        // There is none of this number, which is no reason to fall over.
        consoles.wrote(2, b"x");
        assert_eq!(consoles.start(2, "none", false).before, 0);
    }
}
