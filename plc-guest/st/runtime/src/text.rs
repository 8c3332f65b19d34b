//! Comparisons and searches in the units of strings.

use core::slice;

/// Both strings as slices.
///
/// # Safety
/// Each address is readable for so many units.
unsafe fn slices<'a, T>(
    a: *const T,
    a_units: usize,
    b: *const T,
    b_units: usize,
) -> (&'a [T], &'a [T]) {
    // SAFETY: the caller's promise; strings are aligned for their units.
    unsafe { (slice::from_raw_parts(a, a_units), slice::from_raw_parts(b, b_units)) }
}

fn compare<T: Ord>(a: &[T], b: &[T]) -> i64 {
    for (a, b) in a.iter().zip(b) {
        if a != b {
            return if a < b { -1 } else { 1 };
        }
    }
    a.len().cmp(&b.len()) as i64
}

fn find<T: Eq + Copy>(text: &[T], sought: &[T]) -> i64 {
    let (Some(&first), Some(last)) = (sought.first(), text.len().checked_sub(sought.len())) else {
        return 0;
    };
    for (at, &unit) in text.iter().enumerate().take(last + 1) {
        if unit == first && text.iter().skip(at).zip(sought).all(|(a, b)| a == b) {
            return at as i64 + 1;
        }
    }
    0
}

/// The number of units before the first that is zero, at most `most`.
///
/// # Safety
/// So many bytes are readable, and one more.
pub unsafe extern "C" fn length_bytes(text: *const u8, most: usize) -> usize {
    // SAFETY: the caller's promise.
    let text = unsafe { slice::from_raw_parts(text, most) };
    // Eight at a time: a word has a zero byte where this arithmetic, of Mycroft, leaves a high bit.
    let (words, _) = text.as_chunks::<8>();
    let holds_zero = |word: &[u8; 8]| {
        let word = u64::from_le_bytes(*word);
        word.wrapping_sub(0x0101_0101_0101_0101) & !word & 0x8080_8080_8080_8080 != 0
    };
    let clear = words.iter().position(holds_zero).unwrap_or(words.len()) * 8;
    clear + text.iter().skip(clear).position(|byte| *byte == 0).unwrap_or(text.len() - clear)
}

/// As [`length_bytes`].
///
/// # Safety
/// So many units are readable, and one more.
pub unsafe extern "C" fn length_units(text: *const u16, most: usize) -> usize {
    // SAFETY: the caller's promise.
    let text = unsafe { slice::from_raw_parts(text, most) };
    text.iter().position(|unit| *unit == 0).unwrap_or(most)
}

/// -1, 0 or 1: unit by unit, a prefix is less.
///
/// # Safety
/// As [`slices`].
pub unsafe extern "C" fn compare_bytes(
    a: *const u8,
    a_units: usize,
    b: *const u8,
    b_units: usize,
) -> i64 {
    // SAFETY: the caller's promise.
    let (a, b) = unsafe { slices(a, a_units, b, b_units) };
    compare(a, b)
}

/// As [`compare_bytes`].
///
/// # Safety
/// As [`slices`].
pub unsafe extern "C" fn compare_units(
    a: *const u16,
    a_units: usize,
    b: *const u16,
    b_units: usize,
) -> i64 {
    // SAFETY: the caller's promise.
    let (a, b) = unsafe { slices(a, a_units, b, b_units) };
    compare(a, b)
}

/// The position, from 1, of the first occurrence; 0 if there is none or nothing is sought.
///
/// # Safety
/// As [`slices`].
pub unsafe extern "C" fn find_bytes(
    text: *const u8,
    units: usize,
    sought: *const u8,
    sought_units: usize,
) -> i64 {
    // SAFETY: the caller's promise.
    let (text, sought) = unsafe { slices(text, units, sought, sought_units) };
    find(text, sought)
}

/// As [`find_bytes`].
///
/// # Safety
/// As [`slices`].
pub unsafe extern "C" fn find_units(
    text: *const u16,
    units: usize,
    sought: *const u16,
    sought_units: usize,
) -> i64 {
    // SAFETY: the caller's promise.
    let (text, sought) = unsafe { slices(text, units, sought, sought_units) };
    find(text, sought)
}
