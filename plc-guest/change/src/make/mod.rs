//! From two images to the plan of a change, and to what engineers are told of it.
//!
//! Values are matched by name, as engineers think of them. Where a type has changed, its parts are matched by
//! their names, elements of arrays by their index. What has no like in the new version is dropped; what has none in
//! the old one begins with its initial value.
//!
//! Not every change can be made while the program runs. What cannot is told with its name and the reason
//! ([`Refusal`]), and then the way is a restart of the partition.

mod carry;
mod compare;
mod entry;
mod footprint;
mod likeness;
mod refusal;
mod steps;
mod targets;

use std::collections::HashSet;
use std::string::{String, ToString};
use std::vec::Vec;

use takt_program::Image;

use crate::cost::Cost;
use crate::large::LargePlan;
use crate::plan::{Defect, Plan};
use carry::Carried;

pub use compare::{Note, NoteKind};
pub use entry::{Entry, Fate};
pub use refusal::Refusal;

/// A change from one image to another.
#[derive(Clone, Debug)]
pub struct Change {
    /// What happens to each variable of the state, in the order of their names.
    pub entries: Vec<Entry>,
    /// Values that get to the new version, and that a roll-back does not bring back: they are as at the commit then.
    pub left_behind: Vec<Entry>,
    /// What else is different: tasks, points.
    pub notes: Vec<Note>,
    /// Why the change cannot be made while the program runs.
    pub refusals: Vec<Refusal>,
    /// The plans of a commit within one state, if there is no such reason.
    pub plans: Option<Plans>,
    /// Why the values cannot move within one state, if nothing else is in the way.
    pub too_large: Option<Refusal>,
    /// Then these plans carry them to a second state.
    pub large: Option<Large>,
}

/// The plans of a change that can be made.
#[derive(Clone, Debug)]
pub struct Plans {
    /// From the old version to the new one.
    pub forward: Vec<u8>,
    /// Back again.
    pub back: Vec<u8>,
    /// What the first does.
    pub cost: Cost,
    /// What the second does.
    pub back_cost: Cost,
}

/// The plans of a change that takes a second state.
#[derive(Clone, Debug)]
pub struct Large {
    /// From the old version to the new one.
    pub forward: Vec<u8>,
    /// Back again.
    pub back: Vec<u8>,
    /// How many records the first has.
    pub records: u32,
    /// Time without a job that all of the state takes once, by the model, in nanoseconds.
    pub nanoseconds: u64,
}

impl Change {
    /// Compares two images.
    #[must_use]
    pub fn between(old: &Image<'_>, new: &Image<'_>) -> Self {
        let (mut notes, mut refusals) = compare::compare(old, new);
        let forward = Carried::there(old, new);
        let back = Carried::back(new, old);
        for image in [old, new] {
            refusals.extend(footprint::nameless(image).map(|gap| Refusal::Nameless {
                version: image.version(),
                at: gap.start,
                bytes: gap.end - gap.start,
            }));
        }
        refusals.extend(forward.refusals.iter().cloned());
        refusals.extend(only_back(&forward, &back));
        refusals.extend(compare::rises(old, new, &forward));
        let left_behind = left_behind(&forward, &back);
        if !forward.references.is_empty() && (forward.loses() || !left_behind.is_empty()) {
            let text = "one to what is dropped, converted or starts anew becomes NULL, and stays NULL after a roll-back; one \
                        to what a roll-back does not bring back becomes NULL at the roll-back";
            notes.push(Note { kind: NoteKind::Reference, text: text.to_string() });
        }
        let mut change = Self {
            entries: forward.entries.clone(),
            left_behind,
            notes,
            refusals,
            plans: None,
            too_large: None,
            large: None,
        };
        if forward.too_many || back.too_many {
            change.refusals.push(Refusal::Steps);
        }
        if change.refusals.is_empty() {
            match plans(old, new, &forward, &back) {
                Ok(plans) => change.plans = Some(plans),
                Err(reason) if reason.is_of_size() => {
                    match Large::of(old, new, &forward, &back) {
                        Ok(large) => change.large = Some(large),
                        Err(refusal) => change.refusals.push(refusal),
                    }
                    change.too_large = Some(reason);
                }
                Err(refusal) => change.refusals.push(refusal),
            }
        }
        // There is no roll-back of what is not done.
        if !change.refusals.is_empty() {
            change.left_behind.clear();
        }
        change
    }
}

/// What is in the way of a roll-back, and not of the change itself.
fn only_back(forward: &Carried, back: &Carried) -> impl Iterator<Item = Refusal> {
    let told: HashSet<String> = forward.refusals.iter().map(ToString::to_string).collect();
    back.refusals.iter().filter(move |refusal| !told.contains(&refusal.to_string())).cloned()
}

/// What starts anew on the way back, and has not started anew on the way there.
fn left_behind(forward: &Carried, back: &Carried) -> Vec<Entry> {
    let anew = |carried: &Carried| -> Vec<Entry> {
        let entries = carried.entries.iter();
        entries.filter(|entry| matches!(entry.fate, Fate::Anew { .. })).cloned().collect()
    };
    let there: HashSet<String> =
        anew(forward).into_iter().map(|entry| entry.name.to_ascii_lowercase()).collect();
    let mut left = anew(back);
    left.retain(|entry| !there.contains(&entry.name.to_ascii_lowercase()));
    left
}

fn plans(
    old: &Image<'_>,
    new: &Image<'_>,
    forward: &Carried,
    back: &Carried,
) -> Result<Plans, Refusal> {
    let aside = steps::aside(back, forward, new);
    let forward = steps::forward(old, new, forward, &aside);
    let back = steps::back(new, old, back, &aside);
    let (forward, back) = (forward.ok_or(Refusal::Records)?, back.ok_or(Refusal::Records)?);
    let refused = |defect| match defect {
        Defect::Cost { nanoseconds } => Refusal::Cost { nanoseconds },
        Defect::Room => Refusal::Room,
        other => Refusal::Plan(other),
    };
    let cost = Plan::parse(&forward, old, new).map_err(refused)?.cost();
    let back_cost = Plan::parse(&back, new, old).map_err(refused)?.cost();
    Ok(Plans { forward, back, cost, back_cost })
}

impl Large {
    /// The plans to a second state, also for a change that needs none. Nothing else may be in the way of the change.
    ///
    /// # Errors
    /// If it takes too many records.
    pub fn between(old: &Image<'_>, new: &Image<'_>) -> Result<Self, Refusal> {
        Self::of(old, new, &Carried::there(old, new), &Carried::back(new, old))
    }

    fn of(
        old: &Image<'_>,
        new: &Image<'_>,
        forward: &Carried,
        back: &Carried,
    ) -> Result<Self, Refusal> {
        let back = steps::from_second(new, old, back, forward).ok_or(Refusal::Steps)?;
        let forward = steps::to_second(old, new, forward).ok_or(Refusal::Steps)?;
        let plan = LargePlan::parse(&forward, old, new).map_err(Refusal::Plan)?;
        let (records, nanoseconds) = (plan.records(), plan.nanoseconds());
        LargePlan::parse(&back, new, old).map_err(Refusal::Plan)?;
        Ok(Self { forward, back, records, nanoseconds })
    }
}
