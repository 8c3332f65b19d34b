//! What of a program may be looked at and changed from outside.

use takt_abi::live::{Area, Range};

use crate::config::Program;

/// Of one program.
pub struct ProgramLimits {
    /// Its name.
    pub name: String,
    /// Bytes that may be watched in a cycle.
    pub watch: u64,
    /// Whether its values may be written and forced.
    pub force: bool,
    /// Bytes of state, inputs, outputs and markers.
    pub areas: [u32; 4],
}

impl ProgramLimits {
    /// What a separate piece of memory counts beside its bytes.
    pub const EACH_RANGE: u64 = 8;

    /// Those of a program of the file.
    #[must_use]
    pub fn new(program: &Program) -> Self {
        Self {
            name: program.name.clone(),
            watch: program.watch.0,
            force: program.allow_force,
            areas: program.area_bytes(),
        }
    }

    /// Those of the program of a range, which must lie in it.
    ///
    /// # Errors
    /// What is wrong with the range.
    pub fn find<'a>(all: &'a [Self], range: &Range) -> Result<&'a Self, String> {
        let Some(limits) = all.get(usize::from(range.program)) else {
            let last = all.len().saturating_sub(1);
            return Err(format!("there is no program {}: 0 to {last}", range.program));
        };
        let bytes = limits.areas[range.area as usize - Area::State as usize];
        let end = u64::from(range.offset) + u64::from(range.bytes);
        if end > u64::from(bytes) {
            return Err(format!(
                "{} bytes at {} of area {} of the program {}, which has {bytes} bytes there",
                range.bytes, range.offset, range.area as u8, limits.name
            ));
        }
        Ok(limits)
    }
}
