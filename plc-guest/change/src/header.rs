//! What both kinds of plans begin with, and where their records lie.

use takt_program::{Image, address};

use crate::plan::{Defect, HEADER_BYTES, MAGIC, RECORD_BYTES, Step, VERSION, u32_at};

/// Where a plan says what kind it is.
pub const KIND_AT: usize = 92;
/// The values move within one state.
pub const IN_PLACE: u32 = 0;
/// The values get to a second state.
pub const TO_SECOND: u32 = 1;

/// Whether these bytes say that they are a plan to a second state. They may still be none.
#[must_use]
pub fn is_to_second(bytes: &[u8]) -> bool {
    u32_at(bytes, KIND_AT) == TO_SECOND
}

/// The header of a plan that is as long as it says.
#[derive(Clone, Copy, Debug)]
pub struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    /// Of a plan of this kind with at most so many records.
    pub fn read(bytes: &'a [u8], kind: u32, most: u32) -> Result<Self, Defect> {
        let records = u32_at(bytes, 12);
        let length = HEADER_BYTES + records.min(most) as usize * RECORD_BYTES;
        let is_plan = bytes.starts_with(&MAGIC) && u32_at(bytes, 8) == VERSION;
        let is_kind = u32_at(bytes, KIND_AT) == kind;
        if !is_plan || !is_kind || records > most || bytes.len() != length {
            return Err(Defect::Header);
        }
        Ok(Self(bytes))
    }

    /// Whether it is for these images.
    pub fn is_of(self, old: &Image<'_>, new: &Image<'_>) -> bool {
        let hashes = (self.0.get(16..48), self.0.get(48..80));
        let sizes = (self.old_bytes(), self.new_bytes());
        hashes == (Some(&old.hash()[..]), Some(&new.hash()[..]))
            && sizes == (old.state_bytes(), new.state_bytes())
    }

    /// How many records there are.
    pub fn records(self) -> u32 {
        u32_at(self.0, 12)
    }

    /// Size of the state that is left.
    pub fn old_bytes(self) -> u32 {
        u32_at(self.0, 80)
    }

    /// Size of the state that is entered.
    pub fn new_bytes(self) -> u32 {
        u32_at(self.0, 84)
    }

    /// How many bytes are put aside or come back.
    pub fn saved_bytes(self) -> u32 {
        u32_at(self.0, 88)
    }

    /// What a record says; none if there is no such record, or it says nothing.
    pub fn step(self, index: u32) -> Option<Step> {
        let at = HEADER_BYTES + index as usize * RECORD_BYTES;
        Step::read(self.0.get(at..)?.get(..RECORD_BYTES)?)
    }
}

/// Where an address of the old version leads in the new one, if `follow` says so of places in a state of so many bytes; 0 for
/// what is gone. Only the state moves; inputs, outputs and markers stay. Stacks are empty between two jobs, and constants have
/// no places that are kept.
pub fn relocate(target: u64, bytes: u32, follow: impl FnOnce(u32) -> Option<u32>) -> u64 {
    if (address::INPUT..address::TASK_INFORMATION).contains(&target) {
        return target;
    }
    let offset = target.checked_sub(address::STATE).and_then(|offset| u32::try_from(offset).ok());
    let offset = offset.filter(|offset| *offset < bytes).and_then(follow);
    offset.map_or(0, |offset| address::STATE + u64::from(offset))
}
