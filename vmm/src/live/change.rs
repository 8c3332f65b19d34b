//! Changes of programs to other versions, while they run.
//!
//! A new version comes in parts through the control socket. When it is whole it is checked as an image of the partition
//! file is: hash, signature, keys. It must be a version of the program that runs, which means category, tasks, points
//! and a plan that is quick enough (`takt_change`). Then image and plans are written into the program's free bank by
//! this thread, which is no vCPU's, and the guest's kernel is told. The kernel does the rest (`versions` follows it).
//!
//! What an operator watches, writes or forces are bytes at a place. In another version the same place can be another
//! value's. So from the order of a change until the end of the trial there are no such orders for the program
//! ([`is_settled`]), and no change while values are forced: the kernel holds to the same.
//!
//! [`is_settled`]: ProgramChanges::is_settled
//!
//! A guest that starts anew starts with the version that was entered last. Takt itself starts with the images of
//! the partition file.

use takt_abi::live::{Answer, ChangePhase as Phase, ChangeRecord, ChangeStep, Order};
use takt_plan::{Admission, Program};
use takt_program::Image;
use takt_protocol::{Load, PART_MAX, Refusal, VersionStatus};

use super::link::Link;
use super::versions::{Versions, refused, word};
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
    /// Of their budgets, before a version with others is let in.
    admission: Admission,
    upload: Option<Upload>,
    /// Number of the last question how a change stands.
    asked: u32,
    /// Which start of the guest is known here.
    start: u64,
    news: Vec<String>,
}

/// An image of which not all parts have come.
struct Upload {
    program: String,
    parts: u32,
    next: u32,
    bytes: Vec<u8>,
}

impl ProgramChanges {
    /// All programs are as the file says.
    pub fn of(programs: &[Program], admission: Admission) -> Self {
        let programs = programs.iter().map(Versions::of).collect();
        Self { programs, admission, upload: None, asked: 0, start: 0, news: Vec::new() }
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

    /// The programs that have entered another version since the last time.
    pub fn exchanged(&mut self) -> Vec<usize> {
        let programs = self.programs.iter_mut().enumerate();
        programs
            .filter_map(|(place, v)| std::mem::take(&mut v.exchanged).then_some(place))
            .collect()
    }

    /// The version of a program that runs.
    pub fn image(&self, place: usize) -> Option<Image<'_>> {
        Image::parse(&self.programs.get(place)?.running).ok()
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
            // All at once: memory that grows may move, and what it leaves interrupts each CPU of Takt's threads.
            let mut bytes = self.upload.take().map_or(Vec::new(), |upload| upload.bytes);
            bytes.clear();
            let (program, parts) = (load.program.clone(), load.parts);
            bytes
                .try_reserve_exact(parts as usize * PART_MAX)
                .map_err(|_| refused("the host has no memory for the image"))?;
            self.upload = Some(Upload { program, parts, next: 0, bytes });
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
        let (start, admission) = (self.start, &self.admission);
        let running: Vec<_> = self.programs.iter().map(|v| v.running.clone()).collect();
        let admit = |new: &Image<'_>| {
            let images = running.iter().enumerate().map(|(at, bytes)| (at, Image::parse(bytes)));
            let images = images.filter_map(|(at, image)| Some((at, image.ok()?)));
            admission.check(&images.chain([(place, *new)]).collect::<Vec<_>>())
        };
        let versions = &mut self.programs[place];
        let said = versions.prepare(place, bytes.into(), banks, start, link, admit)?;
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

    /// The guest has started anew: with the versions that it was loaded with, in their first banks.
    pub fn guest_has_started(&mut self, banks: Option<&Banks>) {
        if let Some(banks) = banks {
            self.start = banks.programs.start_count();
        }
        for (place, versions) in self.programs.iter_mut().enumerate() {
            if let Some(banks) = banks {
                versions.was_loaded(place, banks);
            }
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

    /// Asks how the changes that are under way stand. One that is prepared is given up by a stop of the program.
    pub fn ask(&mut self, link: &mut Link) {
        if !link.may_ask_again(self.asked) {
            return;
        }
        for (place, versions) in self.programs.iter_mut().enumerate() {
            let under_way = matches!(
                versions.record.phase,
                Phase::Preparing
                    | Phase::Prepared
                    | Phase::Committing
                    | Phase::Trial
                    | Phase::RollingBack
            );
            if under_way {
                // What is not sent is asked for the next time.
                let tell = Order::Change { program: place as u8, step: ChangeStep::Tell };
                self.asked = link.send(&tell).unwrap_or(self.asked);
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
