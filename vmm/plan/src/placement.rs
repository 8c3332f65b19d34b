//! Where the programs of a PLC lie in its memory.
//!
//! Behind the guest's own image, one after the other: bank 0 with the image, bank 1, the state, a second one if the file asks for
//! it, the retained values. What is left
//! of the memory is the guest's to work with. None of it depends on anything but the partition file and the
//! images, so a file that does not fit is refused before anything is started.

use takt_abi::memory::IMAGE_BASE;
use takt_abi::program::ProgramTable;

use super::diagnostic::Diagnostic;
use super::partition::Checked;
use super::programs::Program;
use super::units::Bytes;

/// Programs begin at a multiple of this: the guest maps its own image by pages of its own.
const BASE_STEP: u64 = 2 << 20;

/// Places the programs of a partition behind a guest whose image ends at `guest_end`. Their sizes are
/// multiples of the page size.
pub fn place(checked: &mut Checked, guest_end: u64) -> Result<(), Diagnostic> {
    if checked.programs.is_empty() {
        return Ok(());
    }
    let start = guest_end.max(IMAGE_BASE + 1).next_multiple_of(BASE_STEP);
    let mut end = start;
    let mut take = |bytes: u64| {
        let at = end;
        end += bytes;
        at
    };
    for program in &mut checked.programs {
        let second_state = program.second_state;
        let place = &mut program.program.place;
        place.image = take(place.bank_bytes);
        place.second_bank = take(place.bank_bytes);
        place.state = take(place.state_bytes);
        if second_state {
            place.second_state = take(place.state_bytes);
        }
        place.retained = take(place.retained_bytes);
    }
    let work: u64 = checked.programs.iter().map(|program| program.work).sum();
    let memory = checked.partition.memory_bytes();
    if end + work > memory {
        let needed = Bytes((end + work).next_multiple_of(1 << 20));
        let found = format!(
            "its programs need {} for banks and state, and {} to run in, behind the guest, which ends at {}",
            Bytes(end - start),
            Bytes(work),
            Bytes(start)
        );
        let allowed = format!("a `memory` of at least {needed}, or smaller banks and states");
        return Err(Diagnostic::new(checked.memory.clone(), found, allowed));
    }
    checked.partition.programs = checked.programs.iter().map(|p| p.program.clone()).collect();
    Ok(())
}

/// The table that the guest finds; `None` without programs.
#[must_use]
pub fn table(programs: &[Program], memory_bytes: u64) -> Option<ProgramTable> {
    let last = programs.last()?;
    let work = last.place.retained + last.place.retained_bytes;
    let mut table = ProgramTable {
        count: programs.len() as u32,
        work,
        work_bytes: memory_bytes.saturating_sub(work),
        ..ProgramTable::EMPTY
    };
    table.programs.iter_mut().zip(programs).for_each(|(entry, p)| *entry = p.place);
    Some(table)
}
