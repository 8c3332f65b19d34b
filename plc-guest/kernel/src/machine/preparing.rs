//! Prepares the version in a program's other bank, in pieces that fit into time that no task needs.

use super::carrying::Carrying;
use super::kernel::Kernel;
use super::memory::Area;
use super::version::{Lengths, Other, Way};
use takt_abi::live::{ChangePhase, ChangeReason};
use takt_change::large::{Check, Checked};
use takt_change::{LargePlan, Plan, Ready, is_to_second};
use takt_program::Image;

/// Pages that are mapped in one piece.
const PAGES: u64 = 64;
/// Pages of a second state, which lie behind each other, and so are their entries.
const SECOND_PAGES: u64 = 256;
/// Bytes that get their initial values in one piece.
const BYTES: u64 = 4096;
/// Records of a plan to a second state that are checked in one piece.
const RECORDS: u32 = 128;

/// What is to be done next for a version that is prepared.
#[derive(Clone, Copy, Debug)]
pub enum Piece {
    Image(Lengths),
    There(Lengths, Image<'static>),
    Back(Lengths, Image<'static>, Plan<'static>),
    CheckThere(Lengths, Image<'static>, Check<'static>),
    CheckBack(Image<'static>, LargePlan<'static>, Check<'static>),
    Code(u64),
    State,
    Early(u64),
    Second(u64),
    Initial(u64),
    Carry,
}

impl Kernel {
    /// Does the next piece.
    pub fn prepare_some(&mut self) -> Result<(), ChangeReason> {
        let Some(piece) = self.change.piece else { return Err(ChangeReason::Stopped) };
        let next = match piece {
            Piece::Carry => {
                self.carry_some()?;
                (!self.change.carrying.is_carried_once()).then_some(Piece::Carry)
            }
            piece => self.prepare_piece(piece)?,
        };
        self.change.piece = next;
        if next.is_none() {
            self.change.record.phase = ChangePhase::Prepared;
        }
        Ok(())
    }

    fn prepare_piece(&mut self, piece: Piece) -> Result<Option<Piece>, ChangeReason> {
        let change = &mut self.change;
        let program = self.programs[usize::from(change.record.program)].as_mut();
        let program = program.ok_or(ChangeReason::Stopped)?;
        let pages = self.pages.as_mut().ok_or(ChangeReason::Room)?;
        let plan = |lengths, back| program.other_plan(lengths, back).ok_or(ChangeReason::Plan);
        let running = program.image;
        let next = match (piece, change.other) {
            (Piece::Image(lengths), _) => {
                let image = program.other_image(lengths).ok_or(ChangeReason::Image)?;
                Piece::There(lengths, image)
            }
            (Piece::There(lengths, image), _) => {
                let bytes = plan(lengths, false)?;
                if is_to_second(bytes) {
                    if program.second_state == Area::NONE {
                        return Err(ChangeReason::Room);
                    }
                    let check = Check::begin(bytes, &running, &image);
                    Piece::CheckThere(lengths, image, check.map_err(|_| ChangeReason::Plan)?)
                } else {
                    let there = Plan::parse(bytes, &running, &image);
                    Piece::Back(lengths, image, there.map_err(|_| ChangeReason::Plan)?)
                }
            }
            (Piece::Back(lengths, image, there), _) => {
                let back = Plan::parse(plan(lengths, true)?, &image, &running);
                let back = back.map_err(|_| ChangeReason::Plan)?;
                change.other = Some(Other { image, way: Way::InOneState { there, back } });
                Piece::Code(0)
            }
            (Piece::CheckThere(lengths, image, check), _) => {
                match check.some(RECORDS).map_err(|_| ChangeReason::Plan)? {
                    Checked::Partly(check) => Piece::CheckThere(lengths, image, check),
                    Checked::Whole(there) => {
                        let check = Check::begin(plan(lengths, true)?, &image, &running);
                        Piece::CheckBack(image, there, check.map_err(|_| ChangeReason::Plan)?)
                    }
                }
            }
            (Piece::CheckBack(image, there, check), _) => {
                match check.some(RECORDS).map_err(|_| ChangeReason::Plan)? {
                    Checked::Partly(check) => Piece::CheckBack(image, there, check),
                    Checked::Whole(back) => {
                        let bytes = takt_program::address::pages(image.state_bytes().into());
                        let mapped =
                            program.second_state.part(0, bytes).ok_or(ChangeReason::Room)?;
                        let way = Way::ToSecondState { there, back, mapped };
                        change.other = Some(Other { image, way });
                        Piece::Code(0)
                    }
                }
            }
            (Piece::Code(from), Some(other)) => {
                let next = program.map_other(pages, &other.image, from, PAGES);
                let state = match other.way {
                    Way::InOneState { .. } => Piece::State,
                    Way::ToSecondState { .. } => Piece::Second(0),
                };
                next.map_or(state, Piece::Code)
            }
            (Piece::State, Some(other)) => {
                let bytes = other.image.state_bytes();
                let done = program.map_state(pages, bytes, PAGES).ok_or(ChangeReason::Room)?;
                if done {
                    program.space.complete_other(false);
                }
                if done { Piece::Early(0) } else { Piece::State }
            }
            (Piece::Early(done), Some(Other { image, way: Way::InOneState { there, .. } })) => {
                let mut memory = program.memory_of(&image, true);
                let next = Ready::new(there).prepare(done, BYTES, &mut memory);
                return Ok(next.map(Piece::Early));
            }
            (Piece::Second(from), Some(other)) => {
                let next = program.map_second(other.image.state_bytes(), from, SECOND_PAGES);
                if next.is_none() {
                    program.space.complete_other(true);
                }
                next.map_or(Piece::Initial(0), Piece::Second)
            }
            (Piece::Initial(from), Some(other)) => {
                let next = program.initialise_second(&other.image, from, BYTES);
                if next.is_none() {
                    change.carrying = Carrying::begin();
                }
                next.map_or(Piece::Carry, Piece::Initial)
            }
            _ => return Err(ChangeReason::Stopped),
        };
        Ok(Some(next))
    }
}
