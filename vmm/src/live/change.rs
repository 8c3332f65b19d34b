//! Changes of programs to other versions, while they run.
//!
//! A new version comes in parts through the control socket. When it is whole it is checked as an image of the partition
//! file is: hash, signature, keys. It must be a version of the program that runs, which means category, tasks, points and
//! a plan that is quick enough (`takt_change`). Then image and plans are written into the program's free bank by this
//! thread, which is no vCPU's, and the guest's kernel is told. The kernel does the rest; what it tells of it
//! is a claim, so only steps that can follow each other are believed.
//!
//! What an operator watches, writes or forces are bytes at a place. In another version the same place can be another value's.
//! So from the order of a change until the end of the trial there are no such orders for the program ([`is_settled`]), and
//! no change while values are forced: the kernel holds to the same.
//!
//! [`is_settled`]: ProgramChanges::is_settled
//!
//! A guest that starts anew starts with the version that was entered last. Takt itself starts with the images of
//! the partition file.

use std::sync::Arc;

use takt_abi::live::{
    Answer, ChangePhase as Phase, ChangeReason as Reason, ChangeRecord, ChangeStep, Order,
    Refusal as KernelRefusal,
};
use takt_abi::memory::PAGE;
use takt_change::make::{Change, NoteKind, Plans};
use takt_plan::Program;
use takt_program::Image;
use takt_protocol::{ErrorKind, ImageVersion, Load, PART_MAX, Refusal, VersionStatus};
use vm_memory::{Bytes, GuestAddress};

use super::link::Link;
use crate::boot::programs::Programs;
use crate::memory::GuestMemory;

/// Where the versions of the programs of a partition lie.
#[derive(Clone)]
pub struct Banks {
    /// The partition's memory.
    pub memory: GuestMemory,
    /// What a guest that starts anew finds.
    pub programs: Programs,
}

/// The programs of a partition.
pub struct ProgramChanges {
    programs: Vec<Versions>,
    upload: Option<Upload>,
    news: Vec<String>,
}

/// An image of which not all parts have come.
struct Upload {
    program: String,
    parts: u32,
    next: u32,
    bytes: Vec<u8>,
}

/// The versions of one program.
struct Versions {
    program: Program,
    running: Arc<[u8]>,
    /// What is in the other bank, if it is of use.
    other: Option<Arc<[u8]>>,
    /// The running one is in the second bank.
    in_second: bool,
    /// What the kernel has told last, if it can be true.
    record: ChangeRecord,
    /// Number of the last order of the change.
    ordered: Option<u32>,
    /// Another version has been entered since that was asked last.
    exchanged: bool,
}

fn refused(text: impl Into<String>) -> Refusal {
    Refusal::new(ErrorKind::Refused, text)
}

impl ProgramChanges {
    /// All programs are as the file says.
    pub fn of(programs: &[Program]) -> Self {
        let versions = |program: &Program| Versions {
            program: program.clone(),
            running: program.bytes().into(),
            other: None,
            in_second: false,
            record: ChangeRecord::default(),
            ordered: None,
            exchanged: false,
        };
        Self { programs: programs.iter().map(versions).collect(), upload: None, news: Vec::new() }
    }

    fn find(&mut self, name: &str) -> Result<(usize, &mut Versions), Refusal> {
        let found = self.programs.iter_mut().enumerate().find(|(_, v)| v.program.name == name);
        found.ok_or_else(|| refused("there is no program of this name in the partition"))
    }

    /// The place of a program.
    ///
    /// # Errors
    /// If there is none of this name.
    pub fn place(&mut self, name: &str) -> Result<u8, Refusal> {
        self.find(name).map(|(place, _)| place as u8)
    }

    /// True if a roll-back leads from a version that runs to the one before.
    pub fn is_entered(&self, place: u8) -> bool {
        let phase = self.programs.get(usize::from(place)).map(|v| v.record.phase);
        matches!(phase, Some(Phase::Trial | Phase::Held))
    }

    /// Whether places in a program can be relied on: not from the order of a change until the trial is over.
    ///
    /// # Errors
    /// Why they cannot.
    pub fn is_settled(&self, place: u8) -> Result<(), Refusal> {
        let Some(versions) = self.programs.get(usize::from(place)) else { return Ok(()) };
        match versions.record.phase {
            phase @ (Phase::Committing | Phase::Trial | Phase::RollingBack) => {
                Err(refused(format!(
                    "the program {} changes to another version ({}): none of its values is watched, written or forced until \
                     the trial is over",
                    versions.program.name,
                    word(phase)
                )))
            }
            _ => Ok(()),
        }
    }

    /// The programs that have entered another version since the last time, with its hash and the bytes of its state.
    pub fn exchanged(&mut self) -> Vec<(usize, [u8; 32], u32)> {
        let mut all = Vec::new();
        for (place, versions) in self.programs.iter_mut().enumerate() {
            if std::mem::take(&mut versions.exchanged)
                && let Ok(image) = Image::parse(&versions.running)
            {
                all.push((place, image.hash(), image.state_bytes()));
            }
        }
        all
    }

    /// Takes a part of a new version. With the last one it is checked and brought into the guest.
    ///
    /// # Errors
    /// What is wrong with it; the program goes on as before.
    pub fn load(&mut self, load: &Load, banks: &Banks, link: &mut Link) -> Result<String, Refusal> {
        let (place, versions) = self.find(&load.program)?;
        versions.may_load()?;
        let most = versions.program.place.bank_bytes;
        if u64::from(load.parts) > most.div_ceil(PART_MAX as u64).max(1) {
            let text = format!("the image is longer than the program's bank of {most} bytes");
            return Err(refused(text));
        }
        self.no_other_changes(place)?;
        if load.part == 0 {
            let program = load.program.clone();
            self.upload = Some(Upload { program, parts: load.parts, next: 0, bytes: Vec::new() });
        }
        let fitting = self.upload.as_mut().filter(|upload| {
            (upload.program.as_str(), upload.parts, upload.next)
                == (load.program.as_str(), load.parts, load.part)
        });
        let Some(upload) = fitting else {
            self.upload = None;
            return Err(refused("this part does not follow the one before; begin with part 0"));
        };
        upload.bytes.extend_from_slice(&load.data);
        upload.next += 1;
        if upload.next < upload.parts {
            return Ok(format!("part {} of {}", upload.next, upload.parts));
        }
        let bytes = self.upload.take().map(|upload| upload.bytes).unwrap_or_default();
        let (place, versions) = self.find(&load.program)?;
        let said = versions.prepare(place, bytes.into(), banks, link)?;
        self.forget_ways_back(place);
        Ok(said)
    }

    /// The kernel changes one program at a time.
    fn no_other_changes(&self, place: usize) -> Result<(), Refusal> {
        let others = self.programs.iter().enumerate().filter(|(other, _)| *other != place);
        for (_, Versions { program, record, .. }) in others {
            if !matches!(
                record.phase,
                Phase::None | Phase::Held | Phase::RolledBack | Phase::Refused
            ) {
                return Err(refused(format!(
                    "the program {} of this partition changes ({}), and one program changes at a time",
                    program.name,
                    word(record.phase)
                )));
            }
        }
        Ok(())
    }

    /// With the order to prepare a version of one program, the kernel forgets the way back of another.
    fn forget_ways_back(&mut self, place: usize) {
        let changing = self.programs[place].program.name.clone();
        for (other, versions) in self.programs.iter_mut().enumerate() {
            if other != place && versions.record.phase == Phase::Held {
                (versions.other, versions.record) = (None, ChangeRecord::default());
                self.news.push(format!(
                    "{}: version {} stays, and no roll-back leads to the one before any longer, because {changing} \
                     changes",
                    versions.program.name,
                    versions.version()
                ));
            }
        }
    }

    /// Changes a program to the version that is prepared.
    ///
    /// # Errors
    /// Why it is not changed.
    pub fn commit(&mut self, program: &str, link: &mut Link) -> Result<String, Refusal> {
        let (place, versions) = self.find(program)?;
        if versions.record.phase != Phase::Prepared {
            let text = format!("no version is prepared ({})", word(versions.record.phase));
            return Err(refused(text));
        }
        versions.order(place, ChangeStep::Commit, link)?;
        versions.record.phase = Phase::Committing;
        Ok(format!("{program} changes between two of its cycles"))
    }

    /// Changes a program back, or gives up a version that is only prepared.
    ///
    /// # Errors
    /// Why it is not changed.
    pub fn roll_back(&mut self, program: &str, link: &mut Link) -> Result<String, Refusal> {
        let (place, versions) = self.find(program)?;
        match versions.record.phase {
            // The kernel would enter what is in the bank now. That a next version was to come, it was not told.
            Phase::Trial | Phase::Held if versions.other.is_none() => Err(refused(
                "the version before is gone: a next one was being brought into its place; load that again",
            )),
            Phase::Trial | Phase::Held => {
                versions.order(place, ChangeStep::RollBack, link)?;
                versions.record.phase = Phase::RollingBack;
                Ok(format!("{program} changes back between two of its cycles"))
            }
            Phase::Preparing | Phase::Prepared | Phase::Committing => {
                versions.order(place, ChangeStep::RollBack, link)?;
                Ok(format!("{program}: the version that is prepared is given up"))
            }
            phase => Err(refused(format!("there is nothing to go back to ({})", word(phase)))),
        }
    }

    /// How the versions stand.
    pub fn status(&self) -> Vec<VersionStatus> {
        self.programs.iter().map(Versions::status).collect()
    }

    /// The guest has started anew: with the versions that ran last, in their first banks.
    pub fn guest_has_started(&mut self) {
        for versions in &mut self.programs {
            (versions.other, versions.in_second, versions.ordered) = (None, false, None);
            if !matches!(versions.record.phase, Phase::None) {
                versions.record = ChangeRecord::default();
                let name = &versions.program.name;
                self.news.push(format!(
                    "{name}: the guest starts anew with version {}",
                    versions.version()
                ));
            }
        }
    }

    /// Asks how the changes that are under way stand.
    pub fn ask(&mut self, link: &mut Link) {
        for (place, versions) in self.programs.iter_mut().enumerate() {
            let under_way = matches!(
                versions.record.phase,
                Phase::Preparing | Phase::Committing | Phase::Trial | Phase::RollingBack
            );
            if under_way {
                // What is not sent is asked for the next time.
                let _ = link.send(&Order::Change { program: place as u8, step: ChangeStep::Tell });
            }
        }
    }

    /// Takes an answer.
    pub fn take(&mut self, number: u32, answer: &Answer, banks: Option<&Banks>) {
        match answer {
            Answer::Change(record) => {
                let place = usize::from(record.program);
                if let Some(versions) = self.programs.get_mut(place).filter(|v| v.is_new(number)) {
                    self.news.extend(versions.follow(place, *record, banks));
                }
            }
            Answer::Reply(Err(refusal)) => {
                let known = self.programs.iter_mut().find(|v| v.ordered == Some(number));
                if let Some(versions) = known {
                    let text = versions.not_taken(*refusal);
                    self.news.push(text);
                }
            }
            _ => {}
        }
    }

    /// What has come of changes since the last time.
    pub fn news(&mut self) -> impl Iterator<Item = String> + use<> {
        std::mem::take(&mut self.news).into_iter()
    }
}

impl Versions {
    fn version(&self) -> String {
        version_of(&self.running)
    }

    /// The kernel does not take the last order.
    fn not_taken(&mut self, refusal: KernelRefusal) -> String {
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
    fn may_load(&self) -> Result<(), Refusal> {
        match self.record.phase {
            Phase::None | Phase::Held | Phase::RolledBack | Phase::Refused => Ok(()),
            Phase::Prepared => {
                Err(refused("a version is prepared already: commit it, or roll back"))
            }
            phase => Err(refused(format!("a change is under way ({})", word(phase)))),
        }
    }

    /// Whether an answer was made after the last order of the change was carried out.
    fn is_new(&self, number: u32) -> bool {
        self.ordered.is_none_or(|ordered| number.wrapping_sub(ordered) < 1 << 31)
    }

    fn order(&mut self, place: usize, step: ChangeStep, link: &mut Link) -> Result<(), Refusal> {
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
    fn prepare(
        &mut self,
        place: usize,
        bytes: Arc<[u8]>,
        banks: &Banks,
        link: &mut Link,
    ) -> Result<String, Refusal> {
        let plans = self.check(&bytes)?;
        let places = self.program.place;
        let bank = if self.in_second { places.image } else { places.second_bank };
        let forward_at = (bytes.len() as u64).next_multiple_of(PAGE);
        let back_at = (forward_at + plans.forward.len() as u64).next_multiple_of(8);
        let end = back_at + plans.back.len() as u64;
        if end > places.bank_bytes {
            let text = format!(
                "image and plans have {end} bytes; the program's bank has {}. The key `bank` of the partition file \
                 makes it larger",
                places.bank_bytes
            );
            return Err(refused(text));
        }
        // From here on what was in the other bank is gone.
        self.other = None;
        for (at, part) in [(0, &bytes[..]), (forward_at, &plans.forward), (back_at, &plans.back)] {
            let to = GuestAddress(bank + at);
            let written = banks.memory.regions().write_slice(part, to);
            written.map_err(|error| refused(format!("the bank cannot be written: {error}")))?;
        }
        let lengths = [bytes.len(), plans.forward.len(), plans.back.len()];
        let [image_bytes, forward_bytes, back_bytes] = lengths.map(|length| length as u32);
        let program = place as u8;
        self.send(link, &Order::Prepare { program, image_bytes, forward_bytes, back_bytes })?;
        self.record = ChangeRecord { program, phase: Phase::Preparing, ..ChangeRecord::default() };
        let text = format!(
            "{}: version {} is being prepared; a commit moves {} bytes in {} ns by the model",
            self.program.name,
            version_of(&bytes),
            plans.cost.bytes(),
            plans.cost.nanoseconds()
        );
        self.other = Some(bytes);
        Ok(text)
    }

    /// Whether the running version may change to this one.
    fn check(&self, bytes: &[u8]) -> Result<Plans, Refusal> {
        let bad = |error| refused(format!("this is no program image: {error}"));
        let new = Image::verify(bytes).map_err(bad)?;
        let old = Image::parse(&self.running).map_err(bad)?;
        if let Some(keys) = &self.program.keys {
            match new.key() {
                Some(key) if keys.contains(&key) => {}
                Some(_) => {
                    return Err(refused(
                        "the image is signed with a key that the partition file does not name",
                    ));
                }
                None => {
                    return Err(refused(
                        "the image is not signed, and the partition file names keys",
                    ));
                }
            }
        }
        if u64::from(new.state_bytes()) > self.program.place.state_bytes {
            return Err(refused(format!(
                "the version needs {} bytes of state; the key `state` of the partition file gives it {}",
                new.state_bytes(),
                self.program.place.state_bytes
            )));
        }
        let change = Change::between(&old, &new);
        // The analysis of the partition file was made with the tasks as they are.
        if let Some(note) = change.notes.iter().find(|note| note.kind == NoteKind::Task) {
            return Err(refused(format!("a change of tasks needs a restart: {}", note.text)));
        }
        let reasons: Vec<String> = change.refusals.iter().map(ToString::to_string).collect();
        change.plans.ok_or_else(|| refused(reasons.join("; ")))
    }

    /// What the kernel tells, if it can follow what it told before.
    fn follow(
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

    fn status(&self) -> VersionStatus {
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

fn word(phase: Phase) -> &'static str {
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
