//! The versions of one program: which runs, which lies in the other bank, and how far a change is.
//!
//! The steps of a change are orders to the guest's kernel, and what it tells of them is a claim, so only steps that can
//! follow each other are believed.

use std::sync::Arc;

use takt_abi::live::{
    ChangePhase as Phase, ChangeReason as Reason, ChangeRecord, ChangeStep, Order,
    Refusal as KernelRefusal,
};
use takt_change::make::{Change, NoteKind};
use takt_plan::Program;
use takt_program::Image;
use takt_protocol::{ErrorKind, ImageVersion, Refusal, VersionStatus};
use vm_memory::{Bytes, GuestAddress};

use super::change::Banks;
use super::link::Link;

/// The versions of one program.
pub struct Versions {
    pub program: Program,
    pub running: Arc<[u8]>,
    /// What is in the other bank, if it is of use.
    pub other: Option<Arc<[u8]>>,
    /// The running one is in the second bank.
    pub in_second: bool,
    /// What the kernel has told last, if it can be true.
    pub record: ChangeRecord,
    /// Number of the last order of the change.
    pub ordered: Option<u32>,
    /// Another version has been entered since that was asked last.
    pub exchanged: bool,
}

/// The plans of a change, for the way that it takes.
struct Chosen {
    forward: Vec<u8>,
    back: Vec<u8>,
    /// What the operator is told of them.
    told: String,
}

/// An order is not carried out, for this reason.
pub fn refused(text: impl Into<String>) -> Refusal {
    Refusal::new(ErrorKind::Refused, text)
}

impl Versions {
    /// As the file says.
    pub fn of(program: &Program) -> Self {
        Self {
            program: program.clone(),
            running: program.bytes().into(),
            other: None,
            in_second: false,
            record: ChangeRecord::default(),
            ordered: None,
            exchanged: false,
        }
    }

    /// The number of the version that runs.
    pub fn version(&self) -> String {
        version_of(&self.running)
    }

    /// The kernel does not take the last order.
    pub fn not_taken(&mut self, refusal: KernelRefusal) -> String {
        self.ordered = None;
        let name = &self.program.name;
        let phase = &mut self.record.phase;
        match (refusal, *phase) {
            (KernelRefusal::Forced, Phase::Committing) => *phase = Phase::Prepared,
            (KernelRefusal::Forced, Phase::RollingBack) => *phase = Phase::Held,
            (_, before) => {
                // What has begun goes on in the kernel: which version runs is asked until it is known.
                if before == Phase::Preparing {
                    *phase = Phase::Refused;
                }
                return format!("{name}: the kernel takes no such order now ({refusal:?})");
            }
        }
        format!(
            "{name}: the version stays, because values of the program are forced: release them first"
        )
    }

    /// Whether the other bank is free.
    pub fn may_load(&self) -> Result<(), Refusal> {
        match self.record.phase {
            Phase::None | Phase::Held | Phase::RolledBack | Phase::Refused => Ok(()),
            Phase::Prepared => {
                Err(refused("a version is prepared already: commit it, or roll back"))
            }
            phase => Err(refused(format!("a change is under way ({})", word(phase)))),
        }
    }

    /// Whether an answer was made after the last order of the change was carried out.
    pub fn is_new(&self, number: u32) -> bool {
        self.ordered.is_none_or(|ordered| number.wrapping_sub(ordered) < 1 << 31)
    }

    /// Orders a step of a change.
    pub fn order(
        &mut self,
        place: usize,
        step: ChangeStep,
        link: &mut Link,
    ) -> Result<(), Refusal> {
        self.send(link, &Order::Change { program: place as u8, step })
    }

    fn send(&mut self, link: &mut Link, order: &Order) -> Result<(), Refusal> {
        let sent = link.send(order);
        self.ordered = Some(sent.map_err(|error| {
            refused(format!("the partition's kernel takes no orders now ({error:?})"))
        })?);
        Ok(())
    }

    /// Checks a version and brings it into the guest.
    pub fn prepare(
        &mut self,
        place: usize,
        bytes: Arc<[u8]>,
        banks: &Banks,
        start: u64,
        link: &mut Link,
        admit: impl Fn(&Image<'_>) -> Result<(), String>,
    ) -> Result<String, Refusal> {
        let plans = self.check(&bytes, admit)?;
        let places = self.program.place;
        let bank = if self.in_second { places.image } else { places.second_bank };
        let lengths = [bytes.len(), plans.forward.len(), plans.back.len()].map(|l| l as u64);
        let [forward_at, back_at] = self.program.plans_in_bank(lengths).map_err(refused)?;
        // From here on what was in the other bank is gone.
        self.other = None;
        let parts = [(0, &bytes[..]), (forward_at, &plans.forward), (back_at, &plans.back)];
        let written = banks.programs.write(start, || {
            parts.into_iter().try_for_each(|(at, part)| {
                banks.memory.regions().write_slice(part, GuestAddress(bank + at))
            })
        });
        // Its loader may be writing the version that runs into this bank.
        let written =
            written.ok_or_else(|| refused("the guest starts anew: load it again then"))?;
        written.map_err(|error| refused(format!("the bank cannot be written: {error}")))?;
        let [image_bytes, forward_bytes, back_bytes] = lengths.map(|length| length as u32);
        let program = place as u8;
        self.send(link, &Order::Prepare { program, image_bytes, forward_bytes, back_bytes })?;
        self.record = ChangeRecord { program, phase: Phase::Preparing, ..ChangeRecord::default() };
        let text = format!(
            "{}: version {} is being prepared; {}",
            self.program.name,
            version_of(&bytes),
            plans.told
        );
        self.other = Some(bytes);
        Ok(text)
    }

    /// Whether the running version may change to this one.
    fn check(
        &self,
        bytes: &[u8],
        admit: impl Fn(&Image<'_>) -> Result<(), String>,
    ) -> Result<Chosen, Refusal> {
        let bad = |error| refused(format!("this is no program image: {error}"));
        let new = Image::verify(bytes).map_err(bad)?;
        let old = Image::parse(&self.running).map_err(bad)?;
        self.program.may_become(&new).map_err(refused)?;
        let change = Change::between(&old, &new);
        // The analysis of the partition file was made with the tasks as they are.
        if change.notes.iter().any(|note| note.kind == NoteKind::Task) {
            admit(&new).map_err(refused)?;
        }
        let reasons: Vec<String> = change.refusals.iter().map(ToString::to_string).collect();
        match (change.plans, change.large, change.too_large) {
            (Some(plans), ..) => {
                let (bytes, time) = (plans.cost.bytes(), plans.cost.nanoseconds());
                let told = format!("a commit moves {bytes} bytes in {time} ns by the model");
                Ok(Chosen { forward: plans.forward, back: plans.back, told })
            }
            (None, Some(large), _) if self.program.place.second_state > 0 => {
                let (records, time) = (large.records, large.nanoseconds.div_ceil(1000));
                let told = format!(
                    "before a commit its values are carried to the second state, in {records} steps and {time} us of \
                     time without a job by the model"
                );
                Ok(Chosen { forward: large.forward, back: large.back, told })
            }
            (None, Some(_), Some(reason)) => Err(refused(format!(
                "{reason}. With the key `second_state` of the partition file the change can be made"
            ))),
            _ => Err(refused(reasons.join("; "))),
        }
    }

    /// What the kernel tells, if it can follow what it told before.
    pub fn follow(
        &mut self,
        place: usize,
        record: ChangeRecord,
        banks: Option<&Banks>,
    ) -> Option<String> {
        let (before, after) = (self.record.phase, record.phase);
        // One that stops soon after the change has no phase any more, but the time that the change took.
        let stopped = after == Phase::None && record.took > 0;
        let entered = before == Phase::Committing
            && (stopped
                || matches!(
                    after,
                    Phase::Trial | Phase::Held | Phase::RollingBack | Phase::RolledBack
                ));
        let left = after == Phase::RolledBack
            && matches!(
                before,
                Phase::Committing | Phase::Trial | Phase::Held | Phase::RollingBack
            );
        let follows = before == after
            || entered
            || left
            || match after {
                Phase::None => before != Phase::RolledBack && before != Phase::Refused,
                // A commit or roll-back that the kernel has refused, if its answer was lost.
                Phase::Prepared => matches!(before, Phase::Preparing | Phase::Committing),
                Phase::Held => matches!(before, Phase::Trial | Phase::RollingBack),
                Phase::Refused => before == Phase::Preparing,
                Phase::RollingBack => matches!(before, Phase::Trial | Phase::Held),
                _ => false,
            };
        if !follows {
            return None;
        }
        if entered {
            self.exchange(place, banks);
        }
        if left {
            self.exchange(place, banks);
        }
        self.record = record;
        let name = &self.program.name;
        let (version, cycle, took) = (self.version(), record.cycle, record.took);
        let gone = match record.gone {
            0 => String::new(),
            count => format!("; {count} references became NULL"),
        };
        (before != after).then(|| match after {
            Phase::None => format!("{name}: the change is given up{}", because(record.reason)),
            Phase::Prepared if record.carried > 0 => format!(
                "{name}: a version is prepared; {} pages were carried to its state in {} us",
                record.carried,
                record.carrying.div_ceil(1000)
            ),
            Phase::Prepared => format!("{name}: a version is prepared"),
            Phase::Trial => format!(
                "{name}: version {version} runs from cycle {cycle} on, on trial; the change took {took} ns{gone}"
            ),
            Phase::Held => format!("{name}: version {version} has passed its trial"),
            Phase::RollingBack => format!("{name}: version {version} is left{}", because(record.reason)),
            Phase::RolledBack => format!(
                "{name}: version {version} runs again from cycle {cycle} on{}; the change took {took} ns{gone}",
                because(record.reason)
            ),
            Phase::Refused => format!("{name}: the kernel refuses the version{}", because(record.reason)),
            Phase::Preparing | Phase::Committing => format!("{name}: {}", word(after)),
        })
    }

    /// The guest was loaded with this version. It can be the one before, if the guest ended when it had just
    /// entered another and Takt had not heard of that.
    pub fn was_loaded(&mut self, place: usize, banks: &Banks) {
        let loaded = banks.programs.loaded(place);
        let loaded = loaded.unwrap_or_else(|| self.program.bytes().into());
        if loaded != self.running {
            banks.programs.start_with(place, Some(loaded.clone()));
            self.running = loaded;
            self.exchanged = true;
        }
    }

    /// The version in the other bank runs now, and is what the guest starts with.
    fn exchange(&mut self, place: usize, banks: Option<&Banks>) {
        if let Some(other) = self.other.take() {
            self.other = Some(std::mem::replace(&mut self.running, other));
            self.in_second = !self.in_second;
            self.exchanged = true;
            if let Some(banks) = banks {
                banks.programs.start_with(place, Some(self.running.clone()));
            }
        }
    }

    /// How the versions stand.
    pub fn status(&self) -> VersionStatus {
        VersionStatus {
            program: self.program.name.clone(),
            running: image_version(&self.running),
            other: self.other.as_ref().map(|bytes| image_version(bytes)),
            phase: word(self.record.phase).to_owned(),
            reason: because_word(self.record.reason).map(str::to_owned),
            jobs: self.record.jobs.into(),
            references_gone: self.record.gone.into(),
            took_ns: self.record.took,
            at_ns: self.record.at,
            cycle: self.record.cycle,
            carried_pages: self.record.carried.into(),
            carrying_ns: self.record.carrying,
        }
    }
}

fn version_of(bytes: &[u8]) -> String {
    Image::parse(bytes).map_or_else(|_| "?".to_owned(), |image| image.version().to_string())
}

fn image_version(bytes: &[u8]) -> ImageVersion {
    let hash = Image::parse(bytes).map_or([0; 32], |image| image.hash());
    let hash = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    ImageVersion { version: version_of(bytes), hash }
}

/// A phase, as the status has it.
pub fn word(phase: Phase) -> &'static str {
    match phase {
        Phase::None => "none",
        Phase::Preparing => "preparing",
        Phase::Prepared => "prepared",
        Phase::Committing => "committing",
        Phase::Trial => "trial",
        Phase::Held => "held",
        Phase::RollingBack => "rolling-back",
        Phase::RolledBack => "rolled-back",
        Phase::Refused => "refused",
    }
}

fn because_word(reason: Reason) -> Option<&'static str> {
    Some(match reason {
        Reason::None => return None,
        Reason::Order => "an operator's order",
        Reason::Fault => "a fault of the new version",
        Reason::Budget => "a job of the new version used up its budget",
        Reason::Image => "its image is not valid",
        Reason::Plan => "a change plan is not valid",
        Reason::Room => "there is no room for it",
        Reason::Stopped => "the program was stopped or started anew",
    })
}

fn because(reason: Reason) -> String {
    because_word(reason).map_or_else(String::new, |reason| format!(": {reason}"))
}
