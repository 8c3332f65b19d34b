//! What a partition takes of the hardware that all partitions share.
//!
//! A schedule divides the time of a CPU, and nothing of what lies around it: tables that translate
//! addresses, caches, the way to memory. What the processor can divide of those is asked for here. Whether
//! the host has it is seen when the file is run.

use std::fmt;

use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::Kind;
use super::diagnostic::{Diagnostic, quote};
use super::raw::{self, Keys};
use super::units::Bytes;

/// What a partition takes of the hardware that all share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hardware {
    /// Of which pages its memory is made.
    pub huge_pages: HugePages,
    /// How many bus locks are no error; `None` if each is one, where KVM tells of them.
    pub bus_locks: Option<BusLockLimit>,
    /// How many ways of its CPU's L3 cache it has for itself.
    pub cache: Option<u32>,
    /// How much of the memory bandwidth it gets, in per cent.
    pub memory_bandwidth: Option<u32>,
}

/// How often a guest may lock the memory bus. With it, the host's KVM must tell of bus locks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusLockLimit {
    /// This many times,
    pub at_most: u32,
    /// within a span of this length.
    pub within: Nanos,
}

/// Most ways of a cache: the processor has a mask of 32 bits for them.
const WAYS_MAX: u32 = 32;
/// Most bus locks of a limit. Each keeps all processors from memory for about a microsecond.
const BUS_LOCKS_MAX: i64 = 100_000;
/// Longest span of a limit, a day.
const WITHIN_MAX: Nanos = Nanos::from_millis(86_400_000);

/// Of which pages a partition's memory is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HugePages {
    /// Of pages of 4 KiB.
    None,
    /// Of huge pages of 2 MiB if the host has enough of them set aside, else of 4 KiB.
    Auto,
    /// Of huge pages of this size, or the run does not start.
    Of(HugePageSize),
}

/// The sizes of huge pages that the processor has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum HugePageSize {
    /// 2 MiB.
    TwoMiB,
    /// 1 GiB.
    OneGiB,
}

impl HugePageSize {
    /// Both.
    pub const ALL: [Self; 2] = [Self::TwoMiB, Self::OneGiB];

    /// In bytes.
    #[must_use]
    pub const fn bytes(self) -> u64 {
        match self {
            Self::TwoMiB => 2 << 20,
            Self::OneGiB => 1 << 30,
        }
    }
}

/// Prints as it is written in the file.
impl fmt::Display for HugePageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Bytes(self.bytes()).fmt(f)
    }
}

/// Checks what a partition of this kind and size asks for.
pub fn check(raw: &raw::Partition, kind: &Kind, memory: Bytes) -> Result<Hardware, Diagnostic> {
    let huge_pages = match &raw.huge_pages {
        Some(value) => check_huge_pages(value, memory, &raw.memory)?,
        // A Linux has memory to win by it, and no windows that a fault of its tables could be in.
        None => match kind {
            Kind::Plc { .. } => HugePages::None,
            Kind::Linux { .. } => HugePages::Auto,
        },
    };
    let bus_locks = raw.bus_locks.as_ref().map(check_bus_locks).transpose()?;
    let cache =
        raw.cache.as_ref().map(|ways| number(ways, "ways of cache", WAYS_MAX)).transpose()?;
    let percent = raw.memory_bandwidth.as_ref();
    let memory_bandwidth =
        percent.map(|it| number(it, "per cent of the memory bandwidth", 100)).transpose()?;
    Ok(Hardware { huge_pages, bus_locks, cache, memory_bandwidth })
}

fn check_huge_pages(
    value: &Spanned<String>,
    memory: Bytes,
    written: &Spanned<Bytes>,
) -> Result<HugePages, Diagnostic> {
    let size = match value.get_ref().as_str() {
        "none" => return Ok(HugePages::None),
        "auto" => return Ok(HugePages::Auto),
        "2MiB" => HugePageSize::TwoMiB,
        "1GiB" => HugePageSize::OneGiB,
        other => {
            let found = format!("there are no huge pages {}", quote(other));
            let allowed = "\"none\", \"auto\", \"2MiB\" or \"1GiB\"";
            return Err(Diagnostic::new(value.span(), found, allowed));
        }
    };
    if !memory.0.is_multiple_of(size.bytes()) {
        let found = format!("the memory of {memory} is not a whole number of pages of {size}");
        let next = Bytes(memory.0.next_multiple_of(size.bytes()));
        let allowed = format!("a multiple of {size}, such as \"{next}\", or smaller pages");
        return Err(Diagnostic::new(written.span(), found, allowed)
            .and(value.span(), format!("pages of {size} are asked for")));
    }
    Ok(HugePages::Of(size))
}

fn check_bus_locks(limit: &Spanned<Keys<raw::BusLocks>>) -> Result<BusLockLimit, Diagnostic> {
    let Keys(raw) = limit.get_ref();
    let number = *raw.at_most.get_ref();
    let at_most =
        u32::try_from(number).ok().filter(|_| number <= BUS_LOCKS_MAX).ok_or_else(|| {
            let allowed = format!("0 to {BUS_LOCKS_MAX}; 0 if each is an error");
            Diagnostic::new(raw.at_most.span(), format!("{number} bus locks"), allowed)
        })?;
    let within = raw.within.get_ref().0;
    if within == Nanos::ZERO || within > WITHIN_MAX {
        let found = format!("a span of {within} for bus locks");
        let allowed = format!("more than nothing, and at most {WITHIN_MAX}");
        return Err(Diagnostic::new(raw.within.span(), found, allowed));
    }
    Ok(BusLockLimit { at_most, within })
}

/// A number of something, from 1 on.
fn number(value: &Spanned<i64>, what: &str, most: u32) -> Result<u32, Diagnostic> {
    let number = *value.get_ref();
    u32::try_from(number).ok().filter(|number| (1..=most).contains(number)).ok_or_else(|| {
        let allowed = format!("1 to {most}, as far as the host's processor can");
        Diagnostic::new(value.span(), format!("{number} {what}"), allowed)
    })
}
