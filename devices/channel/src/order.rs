//! The order of message numbers, which begin again at 0 after the largest.

/// Whether message `a` comes after message `b`, on a circle of numbers.
#[inline]
pub(crate) fn is_ahead(a: u64, b: u64) -> bool {
    (1..=u64::MAX / 2).contains(&a.wrapping_sub(b))
}
