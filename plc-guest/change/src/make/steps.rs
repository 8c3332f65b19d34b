//! From pieces to the records of a plan.

use std::vec::Vec;

use takt_program::Image;

use super::carry::{Carried, Piece, What};
use super::footprint::state_variables;
use crate::header::{IN_PLACE, KIND_AT, TO_SECOND};
use crate::large;
use crate::plan::{HEADER_BYTES, MAGIC, RECORDS, Step, VERSION};

/// What a plan is for.
#[derive(Clone, Copy)]
enum Kind {
    InPlace { saved: u32 },
    ToSecond,
}

/// A gap up to this between two pieces is padding, which may come along.
const PADDING: u32 = 16;

/// Bytes that the new version uses for something else, and that a roll-back brings back: their place in the
/// old state, and their number. They lie one behind the other where they are put aside.
pub struct Aside(Vec<(u32, u32)>);

impl Aside {
    fn bytes(&self) -> Option<u32> {
        self.0.iter().try_fold(0u32, |sum, (_, bytes)| sum.checked_add(*bytes))
    }

    /// Place in the old state, place where they are put aside, number.
    fn places(&self) -> impl Iterator<Item = (u32, u32, u32)> + '_ {
        let mut next = 0u32;
        self.0.iter().map(move |&(at, bytes)| {
            let aside = next;
            next = next.saturating_add(bytes);
            (at, aside, bytes)
        })
    }
}

/// What must be put aside: what the way back cannot carry, where the new version writes. Where it does not, the
/// bytes of the old version are simply still there.
pub fn aside(back: &Carried, forward: &Carried, new: &Image<'_>) -> Aside {
    let mut used: Vec<(u32, u32)> =
        state_variables(new).iter().map(|v| (v.offset, v.offset + v.bytes)).collect();
    // Padding comes along with its neighbours.
    used.extend(merged(forward).iter().map(|piece| (piece.to, piece.to + piece.what.bytes())));
    used.sort_unstable();
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for (start, end) in used {
        match ranges.last_mut() {
            Some(last) if start <= last.1 => last.1 = last.1.max(end),
            _ => ranges.push((start, end)),
        }
    }
    let mut aside = Vec::new();
    for piece in merged(back) {
        let What::Initial { bytes } = piece.what else { continue };
        let (start, end) = (piece.to, piece.to + bytes);
        let first = ranges.partition_point(|range| range.1 <= start);
        for range in ranges.iter().skip(first).take_while(|range| range.0 < end) {
            let (low, high) = (range.0.max(start), range.1.min(end));
            aside.push((low, high - low));
        }
    }
    Aside(aside)
}

/// The plan to the new version; none if it is too long.
pub fn forward(
    old: &Image<'_>,
    new: &Image<'_>,
    carried: &Carried,
    aside: &Aside,
) -> Option<Vec<u8>> {
    let mut steps = writing(carried, old.state_bytes());
    for (from, to, bytes) in aside.places() {
        steps.push(Step::Save { from, to, bytes });
    }
    let kind = Kind::InPlace { saved: aside.bytes()? };
    encode(old, new, &with_references(steps, carried), kind)
}

/// The plan back: what it cannot carry is what was put aside, or is still there.
pub fn back(new: &Image<'_>, old: &Image<'_>, carried: &Carried, aside: &Aside) -> Option<Vec<u8>> {
    let mut steps = writing(carried, new.state_bytes());
    steps.retain(|step| !matches!(step, Step::Initial { .. }));
    for (to, from, bytes) in aside.places() {
        steps.push(Step::Restore { from, to, bytes });
    }
    steps.sort_by_key(|step| match *step {
        Step::Keep { at: to, .. } | Step::Copy { to, .. } | Step::Convert { to, .. } => to,
        Step::Initial { to, .. } | Step::Restore { to, .. } => to,
        Step::Save { .. } | Step::Reference { .. } => u32::MAX,
    });
    let kind = Kind::InPlace { saved: aside.bytes()? };
    encode(new, old, &with_references(steps, carried), kind)
}

/// The steps that write the state. What stays is among them only if there are references to it.
fn writing(carried: &Carried, old_bytes: u32) -> Vec<Step> {
    let follow = !carried.references.is_empty() && carried.moves();
    let mut steps = Vec::new();
    for Piece { to, what } in merged(carried) {
        match what {
            What::Carry { from, bytes } if from == to => {
                if follow {
                    steps.push(Step::Keep { at: from, bytes });
                }
            }
            What::Carry { from, bytes } => steps.push(Step::Copy { from, to, bytes }),
            What::Convert { from, count, conversion } => {
                steps.push(Step::Convert { from, to, count, conversion });
            }
            What::Initial { bytes } => {
                // Behind the old state it is done before the commit.
                let before = old_bytes.saturating_sub(to).min(bytes);
                if before > 0 {
                    steps.push(Step::Initial { to, bytes: before });
                }
                if before < bytes {
                    steps.push(Step::Initial { to: to + before, bytes: bytes - before });
                }
            }
        }
    }
    steps
}

/// The plan back from a second state; none if it is too long. It has only what gets there and back as it is: what does not is
/// in the old state still, whether the page is carried or not.
pub fn from_second(
    new: &Image<'_>,
    old: &Image<'_>,
    back: &Carried,
    forward: &Carried,
) -> Option<Vec<u8>> {
    // What is not carried back is no target any more either.
    let drops = back.moves();
    let carried = Carried { pieces: both_ways(back, forward), drops, ..back.clone() };
    to_second(new, old, &carried)
}

/// The parts of the pieces back that the way there carries from the same places. A type is not always like on both ways: an
/// enumeration that has gained a name is on the way there alone, so what is one piece there is several on the way back.
fn both_ways(back: &Carried, forward: &Carried) -> Vec<Piece> {
    let there = joined(forward, 0);
    let mut pieces = Vec::new();
    for piece in &back.pieces {
        let What::Carry { from, bytes } = piece.what else { continue };
        let first = there.partition_point(|other| other.to + other.what.bytes() <= from);
        for other in there[first..].iter().take_while(|other| other.to < from + bytes) {
            let What::Carry { from: origin, .. } = other.what else { continue };
            let low = from.max(other.to);
            let high = (from + bytes).min(other.to + other.what.bytes());
            if low < high && other.to.wrapping_sub(origin) == from.wrapping_sub(piece.to) {
                let what = What::Carry { from: low, bytes: high - low };
                pieces.push(Piece { to: piece.to + (low - from), what });
            }
        }
    }
    pieces
}

/// The plan that carries the values to a second state; none if it is too long.
pub fn to_second(old: &Image<'_>, new: &Image<'_>, carried: &Carried) -> Option<Vec<u8>> {
    let references = references(carried);
    let mut steps: Vec<Step> = Vec::new();
    // Padding of the old version may be a variable of the new one.
    for Piece { to, what } in joined(carried, 0) {
        match what {
            What::Carry { from, bytes } => {
                let first = references.partition_point(|(place, _)| *place < from);
                let inside = references.iter().skip(first).take_while(|r| r.0 < from + bytes);
                let mut copy = |at: u32, until: u32| {
                    let step = Step::Copy { from: at, to: to + (at - from), bytes: until - at };
                    steps.extend((until > at).then_some(step));
                };
                let mut at = from;
                for (place, _) in inside {
                    copy(at, *place);
                    at = place + 8;
                }
                copy(at, from + bytes);
            }
            What::Convert { from, count, conversion } => {
                steps.push(Step::Convert { from, to, count, conversion });
            }
            What::Initial { .. } => {}
        }
    }
    steps.extend(references.into_iter().map(|(from, to)| Step::Reference { from, to }));
    steps.sort_by_key(|step| match *step {
        Step::Copy { from, .. } | Step::Convert { from, .. } | Step::Reference { from, .. } => from,
        Step::Keep { .. } | Step::Initial { .. } | Step::Restore { .. } | Step::Save { .. } => {
            u32::MAX
        }
    });
    encode(old, new, &steps, Kind::ToSecond)
}

/// The pieces in the order of the places that they write, with neighbours that do the same as one. Padding
/// comes along with what is carried, unless there are references: what is padding on one side may be a variable on the
/// other. Initial values are of the new version, whose padding it is.
fn merged(carried: &Carried) -> Vec<Piece> {
    joined(carried, if carried.references.is_empty() { PADDING } else { 0 })
}

fn joined(carried: &Carried, padding: u32) -> Vec<Piece> {
    let mut pieces = carried.pieces.clone();
    pieces.sort_by_key(|piece| (piece.to, core::cmp::Reverse(piece.what.bytes())));
    let mut merged: Vec<Piece> = Vec::new();
    for piece in pieces {
        let joined = merged.last().and_then(|last| join(*last, piece, padding));
        match (joined, merged.last_mut()) {
            (Some(joined), Some(last)) => *last = joined,
            _ => merged.push(piece),
        }
    }
    merged
}

fn join(a: Piece, b: Piece, padding: u32) -> Option<Piece> {
    let end = a.to + a.what.bytes();
    let close = |padding| b.to <= end.saturating_add(padding);
    let adjacent = b.to == end;
    let what = match (a.what, b.what) {
        (What::Carry { from: x, .. }, What::Carry { from: y, bytes })
            if close(padding) && y.wrapping_sub(x) == b.to - a.to =>
        {
            What::Carry { from: x, bytes: (b.to - a.to + bytes).max(a.what.bytes()) }
        }
        (What::Initial { .. }, What::Initial { bytes }) if close(PADDING) => {
            What::Initial { bytes: (b.to - a.to + bytes).max(a.what.bytes()) }
        }
        (
            What::Convert { from: x, count, conversion },
            What::Convert { from: y, count: more, conversion: other },
        ) if adjacent && conversion == other && y == x + count * conversion.from().bytes() => {
            What::Convert { from: x, count: count + more, conversion }
        }
        _ => return None,
    };
    Some(Piece { to: a.to, what })
}

/// The references that come along, in the order of their places. If nothing moves they are right as they are.
fn references(carried: &Carried) -> Vec<(u32, u32)> {
    let mut references = if carried.moves() { carried.references.clone() } else { Vec::new() };
    references.sort_unstable();
    references.dedup();
    references
}

/// With a step for each reference, in the order of the places that they get to.
fn with_references(mut steps: Vec<Step>, carried: &Carried) -> Vec<Step> {
    let mut references = references(carried);
    references.sort_by_key(|(_, to)| *to);
    steps.extend(references.into_iter().map(|(from, to)| Step::Reference { from, to }));
    steps
}

fn encode(old: &Image<'_>, new: &Image<'_>, steps: &[Step], kind: Kind) -> Option<Vec<u8>> {
    let (most, code, saved) = match kind {
        Kind::InPlace { saved } => (RECORDS, IN_PLACE, saved),
        Kind::ToSecond => (large::RECORDS, TO_SECOND, 0),
    };
    let records = u32::try_from(steps.len()).ok().filter(|records| *records <= most)?;
    let mut plan = std::vec![0; HEADER_BYTES];
    plan[..8].copy_from_slice(&MAGIC);
    plan[16..48].copy_from_slice(&old.hash());
    plan[48..80].copy_from_slice(&new.hash());
    let numbers = [
        (8, VERSION),
        (12, records),
        (80, old.state_bytes()),
        (84, new.state_bytes()),
        (88, saved),
        (KIND_AT, code),
    ];
    for (at, number) in numbers {
        plan[at..at + 4].copy_from_slice(&number.to_le_bytes());
    }
    steps.iter().for_each(|step| plan.extend_from_slice(&step.record()));
    Some(plan)
}
