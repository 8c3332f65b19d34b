//! Two versions of a program: the one that runs, and the one in the other bank.
//!
//! Both see the same stacks and process image. What differs is the image, with its code and constants, and
//! how much of the memory for the state it uses. For a large change the other version has a state of its own.

use super::memory::{Area, Pages};
use super::program::{CODE, CONSTANTS, Program, Region, STATE};
use super::space::{Rights, Space};
use takt_abi::memory::PAGE;
use takt_change::cost::GATHER_BYTES;
use takt_change::{LargePlan, Memory, Plan, Room};
use takt_program::{Image, SectionKind, address};

/// The version in the other bank.
#[derive(Clone, Copy, Debug)]
pub struct Other {
    pub image: Image<'static>,
    /// How the values get to it and back.
    pub way: Way,
}

/// How values get from one version to another.
#[derive(Clone, Copy, Debug)]
pub enum Way {
    /// Both versions use one state, in which the values move at the commit.
    InOneState {
        /// From the running version to the other one.
        there: Plan<'static>,
        /// From the other one to the running version.
        back: Plan<'static>,
    },
    /// The other version has a state of its own, to which the values are carried while the running one runs.
    ToSecondState {
        /// From the running version to the other one.
        there: LargePlan<'static>,
        /// From the other one to the running version.
        back: LargePlan<'static>,
        /// What of its memory the other version's state has mapped.
        mapped: Area,
    },
}

/// Where image and plans lie in the bank.
#[derive(Clone, Copy, Debug)]
pub struct Lengths(pub [u64; 3]);

impl Program {
    /// A part of the other bank.
    fn in_other(&self, offset: u64, bytes: u64) -> Option<&'static [u8]> {
        let area = self.banks[1].part(offset, bytes)?;
        // SAFETY: the host writes to the other bank only while no change is under way: it says first that one
        // is to be prepared, and what is left of the change before is dropped then.
        Some(unsafe { area.bytes_for_ever() })
    }

    /// The image in the other bank, of which only header and sections are looked at.
    pub fn other_image(&self, lengths: Lengths) -> Option<Image<'static>> {
        let image = Image::open(self.in_other(0, lengths.0[0])?).ok()?;
        let fits = u64::from(image.state_bytes()) <= self.state_memory.bytes();
        let tasks = image.tasks().len() == self.image.tasks().len();
        let objects = image.objects().len() == self.image.objects().len();
        let segment = |kind, bytes: usize| self.segment(&image, kind, bytes).is_some();
        let mapped = segment(SectionKind::Code, image.code().len())
            && segment(SectionKind::Constants, image.constants().len());
        (fits && tasks && objects && mapped).then_some(image)
    }

    /// The bytes of the plan to the other version, or of the one back.
    pub fn other_plan(&self, lengths: Lengths, back: bool) -> Option<&'static [u8]> {
        let [image, forward, backward] = lengths.0;
        let first = address::pages(image);
        match back {
            false => self.in_other(first, forward),
            true => {
                self.in_other(first.checked_add(forward)?.checked_next_multiple_of(8)?, backward)
            }
        }
    }

    /// A segment of the image in the other bank.
    fn segment(&self, image: &Image<'_>, kind: SectionKind, bytes: usize) -> Option<Area> {
        self.banks[1].part(image.file_offset(kind) as u64, address::pages(bytes as u64))
    }

    /// Maps some pages of the other version's code and constants, from this one on; none when all are.
    pub fn map_other(&self, pages: &Pages, image: &Image<'_>, from: u64, most: u64) -> Option<u64> {
        let all = Space::other_pages(self.banks[1].bytes());
        let code = self.segment(image, SectionKind::Code, image.code().len())?;
        let constants = self.segment(image, SectionKind::Constants, image.constants().len())?;
        let end = all.min(from + most);
        let first_constant = code.bytes() / PAGE;
        for page in from..end {
            let to = match page.checked_sub(first_constant) {
                None => Some((code.start() + page * PAGE, Rights::Code)),
                Some(constant) if constant < constants.bytes() / PAGE => {
                    Some((constants.start() + constant * PAGE, Rights::Constants))
                }
                Some(_) => None,
            };
            self.space.set_other(pages, page, to);
        }
        (end < all).then_some(end)
    }

    /// Maps some more pages of the memory for the state, if a version with so many bytes needs them. True
    /// if there is nothing left to map; none if there is no room for tables.
    pub fn map_state(&mut self, pages: &mut Pages, bytes: u32, most: u64) -> Option<bool> {
        let mapped = self.regions[STATE].area.bytes();
        let wanted = address::pages(bytes.into());
        if mapped >= wanted {
            return Some(true);
        }
        let more = (wanted - mapped).min(most * PAGE);
        let part = self.state_memory.part(mapped, more)?;
        self.space.map(pages, address::STATE + mapped, part, Rights::Data).ok()?;
        self.regions[STATE].area = self.state_memory.part(0, mapped + more)?;
        Some(mapped + more >= wanted)
    }

    /// Maps some pages of the second state, from this one on, for a version with so many bytes; none when all are.
    pub fn map_second(&self, bytes: u32, from: u64, most: u64) -> Option<u64> {
        let all = self.space.second_pages();
        let end = all.min(from + most);
        for page in from..end {
            let is_used = page * PAGE < address::pages(bytes.into());
            self.space.set_second(page, is_used.then(|| self.second_state.start() + page * PAGE));
        }
        (end < all).then_some(end)
    }

    /// Gives some bytes of the second state, from this one on, their initial values in a version in the other bank. Returns
    /// where it goes on; none if that is all.
    pub fn initialise_second(&self, image: &Image<'_>, from: u64, most: u64) -> Option<u64> {
        let all = address::pages(image.state_bytes().into()).min(self.second_state.bytes());
        let end = all.min(from + most);
        let mut memory = self.memory_of(image, true);
        memory.state = self.second_state;
        // A state has at most 64 MiB.
        let (at, bytes) = (from as u32, end.saturating_sub(from) as u32);
        memory.copy(Room::Initial(at), Room::State(at), bytes);
        (end < all).then_some(end)
    }

    /// The memory that plans work on, with the initial state of an image in one of the banks.
    pub fn memory_of(&self, image: &Image<'_>, in_other: bool) -> ProgramMemory {
        let bank = self.banks[usize::from(in_other)];
        let initial =
            bank.part(image.file_offset(SectionKind::State) as u64, image.state().len() as u64);
        let (gathered, saved) =
            (u64::from(GATHER_BYTES), self.room.bytes() - u64::from(GATHER_BYTES));
        ProgramMemory {
            state: self.state_memory,
            initial: initial.unwrap_or(Area::NONE),
            gathered: self.room.part(0, gathered).unwrap_or(Area::NONE),
            saved: self.room.part(gathered, saved).unwrap_or(Area::NONE),
        }
    }

    /// The other version takes the place of this one. Its state must be right. Returns this one, as the other version from
    /// then on.
    pub fn exchange(&mut self, other: Other) -> Other {
        let image = other.image;
        let code = self.segment(&image, SectionKind::Code, image.code().len());
        let constants = self.segment(&image, SectionKind::Constants, image.constants().len());
        let region = |address, area: Option<Area>, rights| Region {
            address,
            area: area.unwrap_or(Area::NONE),
            rights,
        };
        self.regions[CODE] = region(address::CODE, code, Rights::Code);
        let at = image.constants_address();
        self.regions[CONSTANTS] = region(at, constants, Rights::Constants);
        let way = match other.way {
            Way::InOneState { there, back } => {
                self.space.exchange(false);
                Way::InOneState { there: back, back: there }
            }
            Way::ToSecondState { there, back, mapped } => {
                self.space.exchange(true);
                core::mem::swap(&mut self.state_memory, &mut self.second_state);
                let left = core::mem::replace(&mut self.regions[STATE].area, mapped);
                Way::ToSecondState { there: back, back: there, mapped: left }
            }
        };
        self.banks.swap(0, 1);
        Other { image: core::mem::replace(&mut self.image, image), way }
    }
}

/// See [`Program::memory_of`].
#[derive(Clone, Copy, Debug)]
pub struct ProgramMemory {
    state: Area,
    initial: Area,
    gathered: Area,
    saved: Area,
}

impl ProgramMemory {
    fn place(&self, room: Room, bytes: u32) -> Option<Area> {
        let (area, at) = match room {
            Room::State(at) => (self.state, at),
            Room::Initial(at) => (self.initial, at),
            Room::Gathered(at) => (self.gathered, at),
            Room::Saved(at) => (self.saved, at),
        };
        area.part(at.into(), bytes.into())
    }
}

impl Memory for ProgramMemory {
    fn copy(&mut self, from: Room, to: Room, bytes: u32) {
        let Some(target) = self.place(to, bytes) else { return };
        if let Room::Initial(at) = from {
            // What the image has; the rest is zero.
            let there = self.initial.bytes().saturating_sub(at.into()).min(bytes.into());
            if let Some(source) = self.initial.part(at.into(), there) {
                target.copy_from(source);
            }
            if let Some(rest) = target.part(there, u64::from(bytes) - there) {
                rest.clear();
            }
        } else if let Some(source) = self.place(from, bytes) {
            target.copy_from(source);
        }
    }

    fn number(&self, at: Room, bytes: u32) -> u64 {
        let mut number = [0; 8];
        if let (Some(place), Some(number)) =
            (self.place(at, bytes), number.get_mut(..bytes as usize))
        {
            place.read(number);
        }
        u64::from_le_bytes(number)
    }

    fn set_number(&mut self, at: Room, bytes: u32, value: u64) {
        if let Some(place) = self.place(at, bytes) {
            place.write(&value.to_le_bytes());
        }
    }
}
