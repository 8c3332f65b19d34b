//! Carries the values of a program to the state of another version, while it runs.
//!
//! Nothing is stopped for it. Each page of the state is carried over once; from then on those are carried again that have been
//! written to since, in time that no task needs. The processor notes in the page tables what a program writes; what the
//! kernel writes it notes there itself. As soon as a look at all pages has ended and the program has not run since it began,
//! both states have the same values, and the versions can be exchanged.
//!
//! After the exchange the same goes on in the other direction until the trial is over, so that an error leads back soon.

use super::kernel::{Kernel, Shown};
use super::memory::Area;
use super::program::{Program, STATE};
use super::space::Space;
use super::version::{Other, Way};
use takt_abi::live::{ChangePhase, ChangeReason};
use takt_change::large::Page;
use takt_change::{LargePlan, TwoStates};
use takt_plc_guest::cycle;

/// What one piece carries over, in nanoseconds of the plan's model: a third of the time that a piece may take.
const PIECE_NS: u64 = 20_000;
/// Pages that one piece looks at.
const LOOKS: u64 = 512;

/// How far the values have been carried.
#[derive(Clone, Copy, Debug)]
pub struct Carrying {
    /// Each page is carried, and not only those that have been written to.
    all: bool,
    /// The page that is being carried.
    page: Option<(u64, Page)>,
    /// The next page to look at.
    next: u64,
    /// Both states had the same values when the last look at all pages ended.
    same: bool,
    /// The program has run since that look began.
    ran: bool,
    /// The counts of all pages were set to zero.
    counts: bool,
    /// References that led to something gone.
    gone: u32,
    /// Pages that were carried over, each as often as it was.
    pages: u32,
    /// The time that it took, in ticks.
    ticks: u64,
}

impl Carrying {
    /// Nothing is carried over yet.
    pub const fn begin() -> Self {
        Self { all: true, ..Self::AFTER_EXCHANGE }
    }

    /// The versions have been exchanged: what the new one writes is to be carried back.
    pub const AFTER_EXCHANGE: Self = Self {
        all: false,
        page: None,
        next: 0,
        same: false,
        ran: false,
        counts: false,
        gone: 0,
        pages: 0,
        ticks: 0,
    };

    /// The program, or the kernel in its place, writes to its state.
    pub const fn program_runs(&mut self) {
        self.ran = true;
    }

    /// Each page has been carried over once.
    pub const fn is_carried_once(&self) -> bool {
        !self.all
    }

    /// Both states have the same values.
    pub const fn is_done(&self) -> bool {
        self.same && !self.ran
    }

    /// Does a piece of it. True if the tables must be entered anew before the program goes on.
    fn piece(&mut self, program: &Program, plan: &LargePlan<'_>) -> bool {
        let from = cycle::now();
        if !self.counts {
            program.room.first(2 * u64::from(plan.pages())).clear();
            self.counts = true;
        }
        if self.page.is_none() {
            self.look(program, plan);
        }
        let found = self.page;
        if let Some((number, mut page)) = found {
            let mut states = Areas {
                old: program.regions[STATE].area,
                new: program.second_state,
                space: program.space,
            };
            let done = plan.carry(&mut page, PIECE_NS, &mut states);
            self.page = (!done).then_some((number, page));
            if done {
                self.pages = self.pages.saturating_add(1);
                self.count(program.room, number, page.gone);
            }
        }
        self.ticks += cycle::now().saturating_sub(from);
        found.is_some()
    }

    /// Looks for the next page to carry over.
    fn look(&mut self, program: &Program, plan: &LargePlan<'_>) {
        if self.next == 0 {
            (self.ran, self.same) = (false, false);
        }
        let all = u64::from(plan.pages());
        let end = all.min(self.next + LOOKS);
        // When the last page was carried, what follows it is none of the plan.
        let looked = if self.all { end.min(self.next + 1) } else { end };
        let found = match program.space.take_written(self.next, looked) {
            None if self.all && self.next < all => Some(self.next),
            found => found,
        };
        self.page = found.map(|number| (number, plan.page(number as u32)));
        self.next = found.map_or(end, |number| number + 1);
        if found.is_none() && end == all {
            (self.next, self.all, self.same) = (0, false, true);
        }
    }

    /// Counts the references of a page that led to something gone, in place of those that it had before.
    fn count(&mut self, room: Area, number: u64, gone: u16) {
        let Some(place) = room.part(2 * number, 2) else { return };
        let mut before = [0; 2];
        place.read(&mut before);
        place.write(&gone.to_le_bytes());
        self.gone = self.gone + u32::from(gone) - u32::from(u16::from_le_bytes(before));
    }
}

struct Areas {
    old: Area,
    new: Area,
    space: Space,
}

impl TwoStates for Areas {
    fn copy(&mut self, from: u32, to: u32, bytes: u32) {
        let places =
            (self.old.part(from.into(), bytes.into()), self.new.part(to.into(), bytes.into()));
        if let (Some(from), Some(to)) = places {
            to.copy_from(from);
        }
    }

    fn number(&self, from: u32, bytes: u32) -> u64 {
        let mut number = [0; 8];
        let place = self.old.part(from.into(), bytes.into());
        if let (Some(place), Some(number)) = (place, number.get_mut(..bytes as usize)) {
            place.read(number);
        }
        u64::from_le_bytes(number)
    }

    fn set_number(&mut self, to: u32, bytes: u32, value: u64) {
        if let Some(place) = self.new.part(to.into(), bytes.into()) {
            place.write(&value.to_le_bytes());
        }
    }

    fn lost(&mut self, to: u32) {
        self.space.set_written(true, to.into(), 8);
    }
}

impl Kernel {
    /// Carries some more values of the program that changes over to the other version's state.
    pub fn carry_some(&mut self) -> Result<(), ChangeReason> {
        let change = &mut self.change;
        let program = self.programs[usize::from(change.record.program)].as_ref();
        let program = program.ok_or(ChangeReason::Stopped)?;
        let Some(Other { way: Way::ToSecondState { there, .. }, .. }) = &change.other else {
            return Err(ChangeReason::Stopped);
        };
        if change.carrying.piece(program, there) {
            self.shown = Shown::NONE;
        }
        // On trial no order for the way back was given: the figures are those of the commit.
        if change.record.phase != ChangePhase::Trial {
            let Carrying { gone, pages, ticks, .. } = change.carrying;
            (change.record.gone, change.record.carried) = (gone, pages);
            change.record.carrying = self.clock.span(ticks).0;
        }
        Ok(())
    }
}
