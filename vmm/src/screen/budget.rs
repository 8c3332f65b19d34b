//! How much a partition may show.
//!
//! Somebody has to read it: a person, a journal, a serial line. So a partition has as many bytes a
//! second as five serial lines of 115,200 baud carry, more than a person can read, and as many lines as a
//! scan of 1 ms has that prints one each time. What it does not use it saves, up to that of one second: the
//! messages of a booting kernel come in one go.

use std::time::Duration;

use takt_devices::output::Allowance;

const BYTES_PER_SECOND: u64 = 64 << 10;
const LINES_PER_SECOND: u64 = 1_000;
const NANOS: u64 = 1_000_000_000;

/// What is left of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    bytes: Bucket<BYTES_PER_SECOND>,
    lines: Bucket<LINES_PER_SECOND>,
}

/// What grows by `RATE` a second, up to that of one second. In billionths, so that nothing is lost to
/// rounding however often it grows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bucket<const RATE: u64>(u64);

impl<const RATE: u64> Bucket<RATE> {
    pub const FULL: Self = Self(RATE * NANOS);

    pub fn grow(&mut self, passed: Duration) {
        let nanos = u64::try_from(passed.as_nanos()).unwrap_or(NANOS).min(NANOS);
        self.0 = (self.0 + RATE * nanos).min(Self::FULL.0);
    }

    pub const fn spend(&mut self, count: u64) {
        self.0 = self.0.saturating_sub(count.saturating_mul(NANOS));
    }

    pub const fn left(&self) -> u64 {
        self.0 / NANOS
    }
}

impl Budget {
    pub const FULL: Self = Self { bytes: Bucket::FULL, lines: Bucket::FULL };

    pub fn grow(&mut self, passed: Duration) {
        self.bytes.grow(passed);
        self.lines.grow(passed);
    }

    pub fn left(&self) -> Allowance {
        Allowance { bytes: self.bytes.left() as usize, lines: self.lines.left() as usize }
    }

    /// Whether it is enough for all of this.
    pub fn has(&self, bytes: &[u8]) -> bool {
        self.left().of(bytes) == bytes.len()
    }

    pub fn spend(&mut self, bytes: &[u8]) {
        self.bytes.spend(bytes.len() as u64);
        self.lines.spend(bytes.iter().filter(|byte| **byte == b'\n').count() as u64);
    }
}
