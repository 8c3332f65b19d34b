//! A plan for more than fits between two cycles: the values get to a second state, a page at a time.
//!
//! The new version has a state of its own. While the old one runs, each page of its state is carried over, and again
//! when the program has written to it since. As soon as no page is left that has changed, the new version can be entered: the time of
//! the commit does not depend on how much moves.
//!
//! The bytes of such a plan are those of [`plan`](crate::plan) with these differences. The number at 92 is 1. Nothing is put
//! aside, since the old state stays whole. Up to [`RECORDS`] records are copies, conversions and references, in the order of
//! the places that they *read*, which do not overlap: so it is quickly found what a page becomes. A copy may keep its place.
//! What no record writes has its initial value.
//!
//! The plan back carries, in the same way, what the new version writes. It has only what gets there and back as it is. All
//! else, and what the new version has not touched, is still in the old state, with the values of the instant of the change.
//!
//! A plan that lies can at worst give the new version wrong values. Each range is inside of both states, and what a page
//! costs is bounded by its 4096 bytes.

use takt_program::Image;

use crate::header::{Header, TO_SECOND, relocate};
use crate::plan::{Defect, Step};

/// Most records.
pub const RECORDS: u32 = 1 << 16;
/// What is carried at a time.
pub const PAGE: u32 = 4096;
/// Most values that are converted without a look at the time.
const VALUES: u32 = 32;

const STEP_NS: u64 = 250;
const VALUE_NS: u64 = 200;
/// A search among all records.
const REFERENCE_NS: u64 = 500;
const WORD_NS: u64 = 2;

/// The two states, as plans see them. Ranges are inside by a checked plan's rules.
pub trait TwoStates {
    /// Copies bytes from the old one to the new one.
    fn copy(&mut self, from: u32, to: u32, bytes: u32);

    /// The number of 1, 2, 4 or 8 bytes at this place of the old one.
    fn number(&self, from: u32, bytes: u32) -> u64;

    /// Writes a number of 1, 2, 4 or 8 bytes to the new one.
    fn set_number(&mut self, to: u32, bytes: u32, value: u64);

    /// The reference that gets to this place has become NULL, because its target is gone. Nothing has written to the new state,
    /// and still the way back must carry this page, or the old reference would come back on some pages and not on others.
    fn lost(&mut self, to: u32);
}

/// A plan whose records are being checked, some at a time: all at once would take too much of a window.
#[derive(Clone, Copy, Debug)]
pub struct Check<'a> {
    plan: LargePlan<'a>,
    next: u32,
    end: u32,
}

/// What is known of a plan so far.
#[derive(Clone, Copy, Debug)]
pub enum Checked<'a> {
    /// There are more records.
    Partly(Check<'a>),
    /// All of it is valid.
    Whole(LargePlan<'a>),
}

impl<'a> Check<'a> {
    /// Looks at the header of a plan for a change between two images.
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn begin(bytes: &'a [u8], old: &Image<'_>, new: &Image<'_>) -> Result<Self, Defect> {
        let header = Header::read(bytes, TO_SECOND, RECORDS)?;
        if !header.is_of(old, new) {
            return Err(Defect::Images);
        }
        if header.saved_bytes() != 0 {
            return Err(Defect::Room);
        }
        Ok(Self { plan: LargePlan { header, nanoseconds: 0 }, next: 0, end: 0 })
    }

    /// Looks at so many more records.
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn some(mut self, most: u32) -> Result<Checked<'a>, Defect> {
        let header = self.plan.header;
        let last = header.records().min(self.next.saturating_add(most));
        while self.next < last {
            let index = self.next;
            let step = header.step(index).ok_or(Defect::Record(index))?;
            let (from, read) = source(&step).ok_or(Defect::Record(index))?;
            let inside = |at: u32, bytes: u32, size: u32| {
                bytes < u32::MAX && u64::from(at) + u64::from(bytes) <= u64::from(size)
            };
            let written = inside(step.target(), step.bytes(), header.new_bytes());
            if !written || !inside(from, read, header.old_bytes()) {
                return Err(Defect::Range(index));
            }
            if from < self.end {
                return Err(Defect::Order(index));
            }
            self.end = from + read;
            self.plan.nanoseconds += whole_cost(&step);
            self.next += 1;
        }
        Ok(if last == header.records() { Checked::Whole(self.plan) } else { Checked::Partly(self) })
    }
}

/// What a step reads of the old state. None if it is no step of such a plan.
fn source(step: &Step) -> Option<(u32, u32)> {
    match *step {
        Step::Copy { from, bytes, .. } => Some((from, bytes)),
        Step::Convert { from, count, conversion, .. } => {
            Some((from, count.saturating_mul(conversion.from().bytes())))
        }
        Step::Reference { from, .. } => Some((from, 8)),
        Step::Keep { .. } | Step::Initial { .. } | Step::Restore { .. } | Step::Save { .. } => None,
    }
}

fn whole_cost(step: &Step) -> u64 {
    match *step {
        Step::Convert { count, .. } => STEP_NS + u64::from(count) * VALUE_NS,
        Step::Reference { .. } => REFERENCE_NS,
        _ => copy_cost(step.bytes()),
    }
}

const fn copy_cost(bytes: u32) -> u64 {
    STEP_NS + bytes.div_ceil(8) as u64 * WORD_NS
}

/// A plan that has been checked as a whole.
#[derive(Clone, Copy, Debug)]
pub struct LargePlan<'a> {
    header: Header<'a>,
    nanoseconds: u64,
}

/// How far a page of the old state has been carried over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    start: u32,
    /// The next byte to look at, and the record to look into.
    at: u32,
    record: u32,
    /// References in it that led to something gone.
    pub gone: u16,
}

impl<'a> LargePlan<'a> {
    /// Checks a plan at once.
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn parse(bytes: &'a [u8], old: &Image<'_>, new: &Image<'_>) -> Result<Self, Defect> {
        let mut check = Check::begin(bytes, old, new)?;
        loop {
            check = match check.some(RECORDS)? {
                Checked::Partly(check) => check,
                Checked::Whole(plan) => return Ok(plan),
            };
        }
    }

    /// How many records it has.
    #[must_use]
    pub fn records(&self) -> u32 {
        self.header.records()
    }

    /// The time to carry all pages over once, by the model.
    #[must_use]
    pub const fn nanoseconds(&self) -> u64 {
        self.nanoseconds
    }

    /// How many pages the old state has.
    #[must_use]
    pub fn pages(&self) -> u32 {
        self.header.old_bytes().div_ceil(PAGE)
    }

    /// A page of which nothing is carried over yet.
    #[must_use]
    pub fn page(&self, number: u32) -> Page {
        let start = number.saturating_mul(PAGE);
        let is_before = |index| {
            let read = self.header.step(index).as_ref().and_then(source);
            read.is_some_and(|(from, bytes)| from + bytes <= start)
        };
        Page { start, at: start, record: first(self.records(), is_before), gone: 0 }
    }

    /// Carries some more of a page over: about so many nanoseconds by the model, and at least one step. True if that was the rest.
    pub fn carry(&self, page: &mut Page, most: u64, states: &mut impl TwoStates) -> bool {
        let end = page.start.saturating_add(PAGE);
        let mut spent = 0;
        while spent < most {
            let Some(step) = self.header.step(page.record) else { return true };
            let (from, read) = source(&step).unwrap_or_default();
            if from >= end {
                return true;
            }
            let (until, cost) = self.carry_step(&step, page, end, states);
            spent += cost;
            page.at = until;
            if until < from + read {
                if until >= end {
                    return true;
                }
            } else {
                page.record += 1;
            }
        }
        false
    }

    /// Carries some of a step over that reads from the page. Returns where it goes on, and what it cost.
    fn carry_step(
        &self,
        step: &Step,
        page: &mut Page,
        end: u32,
        states: &mut impl TwoStates,
    ) -> (u32, u64) {
        match *step {
            Step::Copy { from, to, bytes } => {
                let (at, until) = (page.at.max(from), (from + bytes).min(end));
                states.copy(at, to + (at - from), until - at);
                (until, copy_cost(until - at))
            }
            Step::Convert { from, to, count, conversion } => {
                // A value may begin in the page before.
                let (size, written) = (conversion.from().bytes(), conversion.to().bytes());
                let first = page.at.saturating_sub(from) / size;
                let last = count.min((end - from).div_ceil(size)).min(first + VALUES);
                for index in first..last {
                    let value = conversion.value(states.number(from + index * size, size));
                    states.set_number(to + index * written, written, value);
                }
                (from + last * size, STEP_NS + u64::from(last - first) * VALUE_NS)
            }
            Step::Reference { from, to } => {
                let target = states.number(from, 8);
                let now = self.relocated(target);
                states.set_number(to, 8, now);
                if target != 0 && now == 0 {
                    states.lost(to);
                    // One that begins in the page before is counted there.
                    page.gone += u16::from(from >= page.start);
                }
                (from + 8, REFERENCE_NS)
            }
            Step::Keep { .. } | Step::Initial { .. } | Step::Restore { .. } | Step::Save { .. } => {
                (end, STEP_NS)
            }
        }
    }

    /// Where an address of the old version leads in the new one: 0 for what is gone.
    #[must_use]
    pub fn relocated(&self, target: u64) -> u64 {
        relocate(target, self.header.old_bytes(), |offset| {
            let is_before = |index| {
                let read = self.header.step(index).as_ref().and_then(source);
                read.is_some_and(|(from, bytes)| from + bytes <= offset)
            };
            let (from, to, bytes) = match self.header.step(first(self.records(), is_before))? {
                Step::Copy { from, to, bytes } => (from, to, bytes),
                Step::Reference { from, to } => (from, to, 8),
                _ => return None,
            };
            offset.checked_sub(from).filter(|inside| *inside < bytes).map(|inside| to + inside)
        })
    }
}

/// The first of so many records of which this is not true; it is true of none behind.
fn first(records: u32, is_before: impl Fn(u32) -> bool) -> u32 {
    let (mut low, mut high) = (0, records);
    while low < high {
        let middle = low + (high - low) / 2;
        if is_before(middle) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}

const _: () = assert!(PAGE as u64 == takt_program::address::PAGE);
