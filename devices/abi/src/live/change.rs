//! How the change of a program to another version stands, as the kernel tells.

use super::bytes::{Reader, Writer};

/// Where a change is.
///
/// ```text
///  None --prepare--> Preparing --> Prepared --commit--> Committing --> Trial --> Held
///                        |             |                                 |        | roll back
///                        v             v roll back                 error v        v
///                     Refused         None                           RollingBack --> RolledBack
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ChangePhase {
    /// There is none.
    #[default]
    None = 0,
    /// The new version's pages are mapped, a few in each window.
    Preparing = 1,
    /// The new version can be entered.
    Prepared = 2,
    /// It is entered as soon as no task has a job and there is time.
    Committing = 3,
    /// It runs, and an error leads back.
    Trial = 4,
    /// It runs, and an order can lead back.
    Held = 5,
    /// The old version is entered as soon as there is time.
    RollingBack = 6,
    /// The old version runs again.
    RolledBack = 7,
    /// The new version or its plans are not valid, or there is no room for them.
    Refused = 8,
}

/// Why a version was left or refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ChangeReason {
    /// It was not.
    #[default]
    None = 0,
    /// An operator's order.
    Order = 1,
    /// A fault of the new version, or it stopped itself.
    Fault = 2,
    /// A job of the new version used up its budget.
    Budget = 3,
    /// The image is not valid.
    Image = 4,
    /// A plan is not valid.
    Plan = 5,
    /// There is no room.
    Room = 6,
    /// The program was stopped, or started anew.
    Stopped = 7,
}

/// How a change stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChangeRecord {
    /// Place of the program.
    pub program: u8,
    /// Where it is.
    pub phase: ChangePhase,
    /// Why it is there.
    pub reason: ChangeReason,
    /// Jobs that the new version has done since it was entered, up to the end of its trial.
    pub jobs: u32,
    /// References that led to something gone at the last commit or roll-back.
    pub gone: u32,
    /// Time that it took from the last instruction before to the last of it, in nanoseconds.
    pub took: u64,
    /// When that was: nanoseconds since the start of the programs.
    pub at: u64,
    /// Jobs of the program's first task up to then.
    pub cycle: u64,
    /// Pages that were carried over to a second state for this commit or roll-back, each as often as it was. 0 if the
    /// values move within one state.
    pub carried: u32,
    /// Time that it took, between jobs, in nanoseconds.
    pub carrying: u64,
}

impl ChangePhase {
    const ALL: [Self; 9] = [
        Self::None,
        Self::Preparing,
        Self::Prepared,
        Self::Committing,
        Self::Trial,
        Self::Held,
        Self::RollingBack,
        Self::RolledBack,
        Self::Refused,
    ];
}

impl ChangeReason {
    const ALL: [Self; 8] = [
        Self::None,
        Self::Order,
        Self::Fault,
        Self::Budget,
        Self::Image,
        Self::Plan,
        Self::Room,
        Self::Stopped,
    ];
}

impl ChangeRecord {
    pub(super) fn write(&self, to: &mut Writer<'_>) {
        to.u8(self.program);
        to.u8(self.phase as u8);
        to.u8(self.reason as u8);
        to.u8(0);
        to.u32(self.jobs);
        to.u32(self.gone);
        [self.took, self.at, self.cycle].into_iter().for_each(|number| to.u64(number));
        to.u32(self.carried);
        to.u64(self.carrying);
    }

    pub(super) fn read(from: &mut Reader<'_>) -> Option<Self> {
        let (program, phase, reason, zero) = (from.u8()?, from.u8()?, from.u8()?, from.u8()?);
        Some(Self {
            program,
            phase: ChangePhase::ALL.into_iter().find(|p| *p as u8 == phase && zero == 0)?,
            reason: ChangeReason::ALL.into_iter().find(|r| *r as u8 == reason)?,
            jobs: from.u32()?,
            gone: from.u32()?,
            took: from.u64()?,
            at: from.u64()?,
            cycle: from.u64()?,
            carried: from.u32()?,
            carrying: from.u64()?,
        })
    }
}
