//! Records that show whether they are whole: the same ones that the PLC guest `peer` exchanges.

/// Bytes of a record.
pub const BYTES: usize = 512;

/// A record: 64 words that are all its number.
#[must_use]
pub fn record(number: u64) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    bytes.as_chunks_mut::<8>().0.fill(number.to_le_bytes());
    bytes
}

/// The number of a record; `None` if it is torn or has another length.
#[must_use]
pub fn number(bytes: &[u8]) -> Option<u64> {
    let words = bytes.as_chunks::<8>().0;
    let first = *words.first()?;
    (bytes.len() == BYTES && words.iter().all(|word| *word == first))
        .then(|| u64::from_le_bytes(first))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_that_is_whole_has_a_number_and_no_other_has() {
        for n in [0, 1, u64::MAX] {
            let mut bytes = record(n);
            assert_eq!(number(&bytes), Some(n));
            assert_eq!(number(&bytes[8..]), None);
            bytes[BYTES - 1] ^= 1;
            assert_eq!(number(&bytes), None);
        }
        assert_eq!(number(&[]), None);
    }
}
