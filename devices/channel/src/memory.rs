//! Access to shared pages, and the only unsafe code of the crate.
//!
//! The unit is the aligned 64-bit word, which x86-64 moves in one piece, so that a concurrent
//! writer, honest or not, can make a value wrong but never undefined. The direction is in the
//! type: [`PeerPages`] has no way to write.
//!
//! Every load acquires and every store releases. On x86-64 that costs nothing and makes the
//! arguments in `slots` short: a reader that sees a store sees everything its writer did before it.
//! Loads are relaxed with a fence behind them, not acquire loads, because only relaxed atomic loads are
//! guaranteed to work on pages mapped read-only (documentation of `core::sync::atomic`, "Atomic
//! accesses to read-only memory").

#![allow(unsafe_code)]

use core::fmt;
use core::ptr::NonNull;
use core::slice;
use core::sync::atomic::{AtomicU64, Ordering, fence};

/// A region that can be read, word by word.
pub trait Load {
    /// Number of 64-bit words in the region.
    fn words(&self) -> usize;

    /// The word with this number, counted from 0; nothing after it in program order may happen
    /// before it. 0 for a word outside the region, so that no index can end a partition.
    fn load(&self, word: usize) -> u64;

    /// Copies the bytes from this word on; nothing after it in program order may happen before it.
    /// As if by [`load`](Self::load), word after word.
    #[inline]
    fn load_bytes(&self, word: usize, target: &mut [u8]) {
        load_each(self, word, target);
    }
}

/// A region that this end alone writes.
pub trait Store: Load {
    /// Writes a word; nothing before it in program order may happen after it. Without effect
    /// outside the region.
    fn store(&mut self, word: usize, value: u64);

    /// Writes these bytes from this word on, and zeros to the end of the last word. As if by
    /// [`store`](Self::store), word after word.
    #[inline]
    fn store_bytes(&mut self, word: usize, bytes: &[u8]) {
        store_each(self, word, bytes);
    }
}

/// The memory is not aligned to 64-bit words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Misaligned;

impl fmt::Display for Misaligned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a channel region must be aligned to 8 bytes")
    }
}

impl core::error::Error for Misaligned {}

/// Pages that the other end writes and this one can only read.
#[derive(Debug)]
pub struct PeerPages<'a>(&'a [AtomicU64]);

impl<'a> PeerPages<'a> {
    /// Takes `bytes` bytes at `start`; what is left of the last word is not used.
    ///
    /// # Errors
    /// [`Misaligned`].
    ///
    /// # Safety
    /// For all of `'a` the memory must be mapped, at least for reading, and whatever is executed in
    /// this address space accesses it through atomics only. What others do through mappings of
    /// their own does not matter.
    pub unsafe fn new(start: NonNull<u8>, bytes: usize) -> Result<Self, Misaligned> {
        // SAFETY: this function's contract is that of `words_at`.
        Ok(PeerPages(unsafe { words_at(start, bytes) }?))
    }
}

impl Load for PeerPages<'_> {
    fn words(&self) -> usize {
        self.0.len()
    }

    #[inline]
    fn load(&self, word: usize) -> u64 {
        load(self.0, word)
    }

    #[inline]
    fn load_bytes(&self, word: usize, target: &mut [u8]) {
        let done = load_rows(self.0, word, target);
        match target.get_mut(done..) {
            None | Some([]) => {}
            Some(rest) => load_each(self, word + done / WORD, rest),
        }
    }
}

/// Pages that only this end writes.
#[derive(Debug)]
pub struct OwnPages<'a>(&'a [AtomicU64]);

impl<'a> OwnPages<'a> {
    /// Takes `bytes` bytes at `start`; what is left of the last word is not used.
    ///
    /// # Errors
    /// [`Misaligned`].
    ///
    /// # Safety
    /// As for [`PeerPages::new`], and the memory must be writable. A second writer would spoil the
    /// channel's messages, but not soundness.
    pub unsafe fn new(start: NonNull<u8>, bytes: usize) -> Result<Self, Misaligned> {
        // SAFETY: this function's contract includes that of `words_at`.
        Ok(OwnPages(unsafe { words_at(start, bytes) }?))
    }
}

impl Load for OwnPages<'_> {
    fn words(&self) -> usize {
        self.0.len()
    }

    #[inline]
    fn load(&self, word: usize) -> u64 {
        load(self.0, word)
    }

    #[inline]
    fn load_bytes(&self, word: usize, target: &mut [u8]) {
        let done = load_rows(self.0, word, target);
        match target.get_mut(done..) {
            None | Some([]) => {}
            Some(rest) => load_each(self, word + done / WORD, rest),
        }
    }
}

impl Store for OwnPages<'_> {
    #[inline]
    fn store(&mut self, word: usize, value: u64) {
        if let Some(cell) = self.0.get(word) {
            cell.store(value, Ordering::Release);
        }
    }

    #[inline]
    fn store_bytes(&mut self, word: usize, bytes: &[u8]) {
        let done = store_rows(self.0, word, bytes);
        match bytes.get(done..) {
            None | Some([]) => {}
            Some(rest) => store_each(self, word + done / WORD, rest),
        }
    }
}

#[inline]
fn load(words: &[AtomicU64], word: usize) -> u64 {
    let value = words.get(word).map_or(0, |cell| cell.load(Ordering::Relaxed));
    fence(Ordering::Acquire);
    value
}

const WORD: usize = size_of::<u64>();

fn load_each(region: &(impl Load + ?Sized), word: usize, target: &mut [u8]) {
    let (whole, last) = target.as_chunks_mut::<WORD>();
    let words = whole.len();
    for (n, to) in whole.iter_mut().enumerate() {
        *to = region.load(word + n).to_le_bytes();
    }
    if !last.is_empty() {
        let bytes = region.load(word + words).to_le_bytes();
        last.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    }
}

fn store_each(region: &mut (impl Store + ?Sized), word: usize, bytes: &[u8]) {
    let (whole, last) = bytes.as_chunks::<WORD>();
    for (n, from) in whole.iter().enumerate() {
        region.store(word + n, u64::from_le_bytes(*from));
    }
    if !last.is_empty() {
        let mut value = [0; WORD];
        value.iter_mut().zip(last).for_each(|(to, from)| *to = *from);
        region.store(word + whole.len(), u64::from_le_bytes(value));
    }
}

/// Words that are copied at a time, without a look at the bounds for each: what makes the copy of a
/// long message cost little more than its loads and stores.
const ROW: usize = 8;

/// As [`Load::load_bytes`], for whole rows; returns how many bytes those were.
#[inline]
fn load_rows(words: &[AtomicU64], word: usize, target: &mut [u8]) -> usize {
    let (from, _) = words.get(word..).unwrap_or_default().as_chunks::<ROW>();
    let (to, _) = target.as_chunks_mut::<WORD>().0.as_chunks_mut::<ROW>();
    let rows = from.len().min(to.len());
    for (to, from) in to.iter_mut().zip(from) {
        for (to, from) in to.iter_mut().zip(from) {
            *to = from.load(Ordering::Relaxed).to_le_bytes();
        }
    }
    fence(Ordering::Acquire);
    rows * ROW * WORD
}

/// As [`Store::store_bytes`], for whole rows; returns how many bytes those were.
#[inline]
fn store_rows(words: &[AtomicU64], word: usize, bytes: &[u8]) -> usize {
    let (to, _) = words.get(word..).unwrap_or_default().as_chunks::<ROW>();
    let (from, _) = bytes.as_chunks::<WORD>().0.as_chunks::<ROW>();
    let rows = from.len().min(to.len());
    for (to, from) in to.iter().zip(from) {
        for (to, from) in to.iter().zip(from) {
            to.store(u64::from_le_bytes(*from), Ordering::Release);
        }
    }
    rows * ROW * WORD
}

/// Sees memory as words.
///
/// # Safety
/// For all of `'a` the memory must be mapped, and accessed in this address space through atomics
/// only.
unsafe fn words_at<'a>(start: NonNull<u8>, bytes: usize) -> Result<&'a [AtomicU64], Misaligned> {
    let start = start.cast::<AtomicU64>();
    if !start.is_aligned() {
        return Err(Misaligned);
    }
    // SAFETY: aligned (just checked), mapped for `'a` and free of non-atomic accesses (contract);
    // any bit pattern is an AtomicU64, and the length is rounded down to whole words.
    Ok(unsafe { slice::from_raw_parts(start.as_ptr(), bytes / size_of::<AtomicU64>()) })
}
