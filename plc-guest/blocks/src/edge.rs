//! Edge detection `R_TRIG` and `F_TRIG`: an output that is TRUE for one call.
//!
//! As the standard has it, the input counts as having been on the other side before the first call: the
//! first call of [`RTrig`] with TRUE and the first call of [`FTrig`] with FALSE both see an edge.
//!
//! Reference: IEC 61131-3:2013, table 44.

/// TRUE in a call whose input is TRUE and was FALSE in the last.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RTrig {
    memory: bool,
    q: bool,
}

impl RTrig {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { memory: false, q: false }
    }

    /// Whether the input has risen.
    pub const fn update(&mut self, clk: bool) -> bool {
        self.q = clk && !self.memory;
        self.memory = clk;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }
}

/// TRUE in a call whose input is FALSE and was TRUE in the last.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FTrig {
    memory: bool,
    q: bool,
}

impl FTrig {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { memory: false, q: false }
    }

    /// Whether the input has fallen.
    pub const fn update(&mut self, clk: bool) -> bool {
        self.q = !clk && !self.memory;
        self.memory = !clk;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }
}
