//! When a task runs.

use crate::declaration::kind;

/// A task at fixed times. Times are nanoseconds; see [`ms`](crate::ms) and [`us`](crate::us).
#[derive(Clone, Copy, Debug)]
pub struct Cyclic {
    /// The time between two releases.
    pub period: u64,
    /// The first release after the partition's start; less than the period.
    pub offset: u64,
    /// 0 is the most urgent.
    pub priority: u8,
    /// The execution time that one job may take; 0: not bounded.
    pub budget: u64,
    /// How long after its release a job must be done; 0: the period.
    pub deadline: u64,
    /// Size of the stack in bytes.
    pub stack: u32,
    /// Overruns in a row that are tolerated.
    pub sensitivity: u16,
}

/// A task that runs when something happens.
#[derive(Clone, Copy, Debug)]
pub struct Event {
    /// What: `channel:`, `doorbell:`, `interrupt:` or `rise:` and a name.
    pub source: &'static str,
    /// The least time between two releases.
    pub minimum: u64,
    /// 0 is the most urgent.
    pub priority: u8,
    /// The execution time that one job may take; 0: not bounded.
    pub budget: u64,
    /// How long after its release a job must be done; 0: the least time.
    pub deadline: u64,
    /// Size of the stack in bytes.
    pub stack: u32,
    /// Overruns in a row that are tolerated.
    pub sensitivity: u16,
}

/// A task that runs when no other has work.
#[derive(Clone, Copy, Debug)]
pub struct Freewheeling {
    /// 255 is the least urgent.
    pub priority: u8,
    /// Size of the stack in bytes.
    pub stack: u32,
}

const STACK: u32 = 16 << 10;

impl Cyclic {
    /// Every 10 ms, priority 0, 16 KiB of stack.
    pub const DEFAULT: Self = Self {
        period: 10_000_000,
        offset: 0,
        priority: 0,
        budget: 0,
        deadline: 0,
        stack: STACK,
        sensitivity: 0,
    };
}

impl Event {
    /// At most every 10 ms, priority 0, 16 KiB of stack; the source is to be given.
    pub const DEFAULT: Self = Self {
        source: "",
        minimum: 10_000_000,
        priority: 0,
        budget: 0,
        deadline: 0,
        stack: STACK,
        sensitivity: 0,
    };
}

impl Freewheeling {
    /// The least urgent priority, 16 KiB of stack.
    pub const DEFAULT: Self = Self { priority: 255, stack: STACK };
}

/// Any of them, as a declaration has it.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// Kind of the declaration.
    pub kind: u32,
    /// Its text.
    pub source: &'static str,
    /// Its numbers.
    pub numbers: [u64; 8],
}

impl Cyclic {
    /// As a declaration has it.
    #[must_use]
    pub const fn schedule(self) -> Schedule {
        let Self { period, offset, priority, budget, deadline, stack, sensitivity } = self;
        let numbers = [
            period,
            offset,
            priority as u64,
            budget,
            deadline,
            stack as u64,
            sensitivity as u64,
            0,
        ];
        Schedule { kind: kind::CYCLIC, source: "", numbers }
    }
}

impl Event {
    /// As a declaration has it.
    #[must_use]
    pub const fn schedule(self) -> Schedule {
        let Self { source, minimum, priority, budget, deadline, stack, sensitivity } = self;
        let numbers =
            [minimum, 0, priority as u64, budget, deadline, stack as u64, sensitivity as u64, 0];
        Schedule { kind: kind::EVENT, source, numbers }
    }
}

impl Freewheeling {
    /// As a declaration has it.
    #[must_use]
    pub const fn schedule(self) -> Schedule {
        let numbers = [0, 0, self.priority as u64, 0, 0, self.stack as u64, 0, 0];
        Schedule { kind: kind::FREEWHEELING, source: "", numbers }
    }
}
