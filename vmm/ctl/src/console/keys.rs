//! What is typed at `takt console`, and the keys that are its own.
//!
//! The key that leads to them is that of Takt's own terminal, `Ctrl-]`. What follows it is another one on purpose: there
//! `q` ends the run. Who is used to leaving a console by `Ctrl-]` `q` would one day stop the plant by it.

/// The key that is kept back: `Ctrl-]`.
const ESCAPE: u8 = 0x1d;
/// After it: detach.
const DETACH: u8 = b'd';

/// Finds the keys that are not for the guest.
#[derive(Debug, Default)]
pub struct Keys {
    escaped: bool,
}

impl Keys {
    /// Takes typed bytes. Returns those for the guest, and whether the user has left.
    pub fn take(&mut self, typed: &[u8]) -> (Vec<u8>, bool) {
        let mut bytes = Vec::with_capacity(typed.len());
        for &byte in typed {
            match (std::mem::take(&mut self.escaped), byte) {
                (false, ESCAPE) => self.escaped = true,
                (true, DETACH) => return (bytes, true),
                (true, ESCAPE) | (false, _) => bytes.push(byte),
                (true, _) => bytes.extend([ESCAPE, byte]),
            }
        }
        (bytes, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_key_leaves_and_can_be_typed_itself() {
        let mut keys = Keys::default();
        assert_eq!(keys.take(b"ls\r\x1d"), (b"ls\r".to_vec(), false));
        assert_eq!(keys.take(b"q\x1d\x1d"), (b"\x1dq\x1d".to_vec(), false));
        assert_eq!(keys.take(b"a\x1ddb"), (b"a".to_vec(), true));
        assert_eq!(keys.take(b"\x03"), (vec![3], false));
    }
}
