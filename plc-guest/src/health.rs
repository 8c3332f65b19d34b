//! Errors that only the application can see.
//!
//! A sensor that reads what cannot be, a valve that does not follow: no processor raises an
//! exception for that. A guest reports it, and the health monitor's table of its partition says
//! what follows, as for any other error. It costs one VM exit.

use crate::{pages, port};
use takt_abi::memory::ERROR_TEXT_BYTES;

/// Reports an error of the application: `application-error` in the partition file. Of `text`, 64
/// bytes are kept, up to a zero byte.
///
/// Returns if the table lets the guest go on.
pub fn raise(code: u32, text: &str) {
    pages::publish_text(&padded(text));
    port::write(takt_abi::port::ERROR, code);
}

/// `text`, cut or filled up with zeros: what an earlier text left must not be read as its rest.
fn padded(text: &str) -> [u8; ERROR_TEXT_BYTES] {
    let mut bytes = [0; ERROR_TEXT_BYTES];
    for (to, from) in bytes.iter_mut().zip(text.bytes()) {
        *to = from;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_cut_or_filled_up() {
        assert_eq!(padded(&"x".repeat(ERROR_TEXT_BYTES + 1)), [b'x'; ERROR_TEXT_BYTES]);
        let short = padded("valve");
        assert_eq!(&short[..6], b"valve\0");
        assert!(short[5..].iter().all(|byte| *byte == 0));
    }
}
