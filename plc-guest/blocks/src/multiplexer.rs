//! Multiplexer: one of several inputs, by number.
//!
//! Reference: `MUX` of IEC 61131-3:2013, table 32. The standard calls a number out of range an error;
//! here the last good one stays selected, and the block says so.

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Multiplexer {
    selected: u32,
    out_of_range: bool,
}

impl Multiplexer {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { selected: 0, out_of_range: false }
    }

    /// The input with number `select`, counted from 0. None if there are no inputs.
    pub fn update<T: Copy>(&mut self, select: u32, inputs: &[T]) -> Option<T> {
        let chosen = inputs.get(select as usize).copied();
        self.out_of_range = chosen.is_none();
        if chosen.is_some() {
            self.selected = select;
        }
        // Fewer inputs than in the last call may be too few for what was selected then.
        chosen.or_else(|| inputs.get(self.selected as usize).or(inputs.last()).copied())
    }

    /// Whether the last number was out of range.
    #[must_use]
    pub const fn out_of_range(&self) -> bool {
        self.out_of_range
    }
}
