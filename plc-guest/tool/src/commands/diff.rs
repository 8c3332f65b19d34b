//! `takt plc diff`: what a change of a running program to another version would do.

use std::path::PathBuf;

use serde_json::{Value, json};
use takt_change::Cost;
use takt_change::cost::COMMIT_NS;
use takt_change::make::{Change, Entry, Fate, Large, NoteKind, Plans, Refusal};
use takt_plan::{Admission, Program};
use takt_points::Plc;
use takt_program::Image;
use takt_scheduler::table::PartitionId;

use super::versions::find;
use super::{hex, image, read};
use crate::live::Which;
use crate::{Failure, status};

/// Arguments of `diff`.
#[derive(clap::Args)]
pub struct Diff {
    /// The image of the old version, and that of the new one; with --running only the latter.
    #[arg(value_name = "IMAGE", required = true, num_args = 1..=2)]
    images: Vec<PathBuf>,
    /// Compare with what runs: the partition file that Takt runs.
    #[arg(long, value_name = "FILE", requires = "program")]
    running: Option<PathBuf>,
    /// The program of that file.
    #[arg(long, value_name = "NAME", requires = "running")]
    program: Option<String>,
    /// The partition; not needed if only one has programs.
    #[arg(long, value_name = "NAME", requires = "running")]
    partition: Option<String>,
    /// The control socket, if it is not that of the file.
    #[arg(long, value_name = "SOCKET", requires = "running")]
    control: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Also list the variables that stay as they are.
    #[arg(long)]
    all: bool,
}

impl Diff {
    pub fn run(self) -> Result<(), Failure> {
        let Versions { old: old_path, new: new_path, running } = self.versions()?;
        let (old_bytes, new_bytes) = (read(&old_path)?, read(&new_path)?);
        let (old, new) = (image(&old_path, &old_bytes)?, image(&new_path, &new_bytes)?);
        let mut change = Change::between(&old, &new);
        if let Some(plc) = running
            && let Some(program) = &self.program
        {
            let reasons = against(&plc, find(&plc, program)?, (&new_bytes, &new), &change);
            change.refusals.extend(reasons.into_iter().map(Refusal::Partition));
        }
        if self.json {
            println!("{:#}", as_json(&old, &new, &change));
        } else {
            print(&old, &new, &change, self.all);
        }
        match change.refusals.len() {
            0 => Ok(()),
            count => {
                let reasons = if count == 1 { "reason" } else { "reasons" };
                let message =
                    format!("the change needs a restart of the partition: {count} {reasons}");
                Err(Failure { status: status::NOT_AS_EXPECTED, message })
            }
        }
    }
}

impl Diff {
    fn versions(&self) -> Result<Versions, Failure> {
        let (running, program, new) = match (&self.running, &self.program, &self.images[..]) {
            (None, _, [old, new]) => {
                return Ok(Versions { old: old.clone(), new: new.clone(), running: None });
            }
            (Some(running), Some(program), [new]) => (running.clone(), program, new.clone()),
            (None, ..) => {
                return Err(Failure::input("one image takes --running and --program, too"));
            }
            (Some(_), ..) => return Err(Failure::input("--running takes the new image alone")),
        };
        let plc = Which::new(running, self.partition.clone(), self.control.clone()).load()?;
        let old = find(&plc, program)?.path.clone();
        // The image of the file is the one that runs, or this fails.
        plc.connect()?;
        Ok(Versions { old, new, running: Some(plc) })
    }
}

/// The images of both versions, and where the old one runs, if that is known.
struct Versions {
    old: PathBuf,
    new: PathBuf,
    running: Option<Plc>,
}

/// What the partition file says against the change, as Takt finds it when the version is loaded.
fn against(
    plc: &Plc,
    program: &Program,
    (bytes, new): (&[u8], &Image<'_>),
    change: &Change,
) -> Vec<String> {
    let may_become = program.may_become(new);
    let has_room = match (&change.plans, &change.large, &change.too_large) {
        (None, Some(_), Some(reason)) if program.place.second_state == 0 => Err(format!(
            "{reason}. With the key `second_state` of the partition file the change can be made"
        )),
        (Some(Plans { forward, back, .. }), ..) | (None, Some(Large { forward, back, .. }), _) => {
            let lengths = [bytes.len(), forward.len(), back.len()].map(|length| length as u64);
            program.plans_in_bank(lengths).map(drop)
        }
        (None, None, _) => Ok(()),
    };
    let is_in_time = match change.notes.iter().any(|note| note.kind == NoteKind::Task) {
        true => is_in_time(plc, &program.name, new),
        false => Ok(()),
    };
    [may_become, has_room, is_in_time].into_iter().filter_map(Result::err).collect()
}

/// Whether all tasks beside the programs of the file are in time, if this version of one of them has its budgets.
fn is_in_time(plc: &Plc, program: &str, new: &Image<'_>) -> Result<(), String> {
    let programs = plc.partition().programs();
    let images = programs.iter().enumerate().filter_map(|(at, p)| Some((at, p.image()?)));
    let place = programs.iter().position(|other| other.name == program);
    let versions: Vec<_> = images.chain(place.map(|place| (place, *new))).collect();
    Admission::of(plc.file(), PartitionId(plc.place())).check(&versions)
}

fn print(old: &Image<'_>, new: &Image<'_>, change: &Change, all: bool) {
    let key = |image: &Image<'_>| image.key().map_or("unsigned".into(), |key| hex(&key[..4]));
    println!(
        "program {}: {} ({}) becomes {} ({})",
        new.name(),
        old.version(),
        key(old),
        new.version(),
        key(new)
    );
    let kept = change.entries.iter().filter(|entry| entry.fate == Fate::Kept).count();
    for entry in change.entries.iter().filter(|entry| all || entry.fate != Fate::Kept) {
        println!("  {:<12} {:<32} {}", entry.fate.word(), entry.name, types(entry));
    }
    if kept > 0 && !all {
        println!("  {:<12} {kept} more", "kept");
    }
    for note in &change.notes {
        println!("  {:<12} {}", note.kind.word(), note.text);
    }
    for refusal in &change.refusals {
        println!("  {:<12} {refusal}", "refused");
    }
    if let (Some(reason), Some(large)) = (&change.too_large, &change.large) {
        println!("  {:<12} {reason}", "large");
        println!("  {:<12} {}", "second state", large_text(large));
    }
    if let Some(plans) = &change.plans {
        println!("  {:<12} {}", "commit", cost_text(&plans.cost));
        println!("  {:<12} {}", "roll-back", cost_text(&plans.back_cost));
    }
    for Entry { name, ty, .. } in &change.left_behind {
        println!("  {:<12} {name:<32} {ty}: gets its value of the commit again", "roll-back");
    }
}

fn types(entry: &Entry) -> String {
    match &entry.fate {
        Fate::Converted { from } | Fate::Anew { from } => format!("{from} -> {}", entry.ty),
        Fate::Kept | Fate::Moved | Fate::New | Fate::Dropped => entry.ty.clone(),
    }
}

fn cost_text(cost: &Cost) -> String {
    let early = match cost.early {
        0 => String::new(),
        bytes => format!(", {bytes} bytes of new state before it"),
    };
    format!(
        "{} bytes in {} steps, {} of at most {COMMIT_NS} ns by the model{early}",
        cost.bytes(),
        cost.steps,
        cost.nanoseconds()
    )
}

fn large_text(large: &Large) -> String {
    format!(
        "{} steps, {} us of time without a job by the model, before a commit that moves nothing; takes the key `second_state` \
         of the partition file",
        large.records,
        large.nanoseconds.div_ceil(1000)
    )
}

fn as_json(old: &Image<'_>, new: &Image<'_>, change: &Change) -> Value {
    let version = |image: &Image<'_>| json!({ "version": image.version().to_string(), "hash": hex(&image.hash()) });
    let entries = change.entries.iter().map(|entry| {
        let from = match &entry.fate {
            Fate::Converted { from } | Fate::Anew { from } => Some(from),
            Fate::Kept | Fate::Moved | Fate::New | Fate::Dropped => None,
        };
        json!({ "name": entry.name, "fate": entry.fate.word(), "type": entry.ty, "from": from })
    });
    let left_behind =
        change.left_behind.iter().map(|entry| json!({ "name": entry.name, "type": entry.ty }));
    let notes =
        change.notes.iter().map(|note| json!({ "kind": note.kind.word(), "text": note.text }));
    json!({
        "program": new.name(), "old": version(old), "new": version(new),
        "possible": change.refusals.is_empty(), "variables": entries.collect::<Vec<_>>(),
        "left_behind": left_behind.collect::<Vec<_>>(), "notes": notes.collect::<Vec<_>>(),
        "refusals": change.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "commit": change.plans.as_ref().map(|plans| cost_json(&plans.cost)),
        "roll_back": change.plans.as_ref().map(|plans| cost_json(&plans.back_cost)),
        "large": change.large.as_ref().map(|large| json!({
            "reason": change.too_large.as_ref().map(ToString::to_string),
            "steps": large.records, "nanoseconds": large.nanoseconds,
        })),
    })
}

fn cost_json(cost: &Cost) -> Value {
    json!({
        "steps": cost.steps, "moved_bytes": cost.moved, "converted_values": cost.converted,
        "initialised_bytes": cost.initialised, "saved_bytes": cost.saved,
        "references": cost.references, "early_bytes": cost.early,
        "nanoseconds": cost.nanoseconds(), "limit_nanoseconds": COMMIT_NS,
    })
}
