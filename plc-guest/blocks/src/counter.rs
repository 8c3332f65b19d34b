//! Counters `CTU`, `CTD` and `CTUD`.
//!
//! They count rising edges, and stop at the ends of their type: a counter never wraps. The standard
//! counts in INT, DINT, LINT, UDINT and ULINT, which are the types with [`Count`].
//!
//! Reference: IEC 61131-3:2013, table 45.

use crate::edge::RTrig;

/// An integer that a counter counts in.
pub trait Count: Copy + Ord + Default {
    /// Nothing counted.
    const ZERO: Self;
    /// The next number, or the same at the end of the type.
    fn up(self) -> Self;
    /// The number before, or the same at the end of the type.
    fn down(self) -> Self;
}

macro_rules! count {
    ($($integer:ty),*) => {
        $(impl Count for $integer {
            const ZERO: Self = 0;
            fn up(self) -> Self {
                self.saturating_add(1)
            }
            fn down(self) -> Self {
                self.saturating_sub(1)
            }
        })*
    };
}

count!(i16, i32, i64, u32, u64);

/// Up-counter.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ctu<T> {
    cv: T,
    edge: RTrig,
    q: bool,
}

impl<T: Count> Ctu<T> {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { cv: T::ZERO, edge: RTrig::new(), q: false }
    }

    /// Counts an edge of `cu`, or resets; returns whether the count has reached `pv`.
    pub fn update(&mut self, cu: bool, reset: bool, pv: T) -> bool {
        let up = self.edge.update(cu);
        if reset {
            self.cv = T::ZERO;
        } else if up {
            self.cv = self.cv.up();
        }
        self.q = self.cv >= pv;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }

    /// The count.
    #[must_use]
    pub const fn cv(&self) -> T {
        self.cv
    }
}

/// Down-counter.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ctd<T> {
    cv: T,
    edge: RTrig,
    q: bool,
}

impl<T: Count> Ctd<T> {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { cv: T::ZERO, edge: RTrig::new(), q: false }
    }

    /// Counts an edge of `cd`, or loads `pv`; returns whether the count has reached zero.
    pub fn update(&mut self, cd: bool, load: bool, pv: T) -> bool {
        let down = self.edge.update(cd);
        if load {
            self.cv = pv;
        } else if down {
            self.cv = self.cv.down();
        }
        self.q = self.cv <= T::ZERO;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }

    /// The count.
    #[must_use]
    pub const fn cv(&self) -> T {
        self.cv
    }
}

/// Up-down-counter. Edges of both inputs in one call cancel out.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ctud<T> {
    cv: T,
    up_edge: RTrig,
    down_edge: RTrig,
    qu: bool,
    qd: bool,
}

impl<T: Count> Ctud<T> {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { cv: T::ZERO, up_edge: RTrig::new(), down_edge: RTrig::new(), qu: false, qd: false }
    }

    /// Counts edges, or resets, or loads `pv`, in falling order of precedence: reset, load, count.
    pub fn update(&mut self, cu: bool, cd: bool, reset: bool, load: bool, pv: T) {
        let (up, down) = (self.up_edge.update(cu), self.down_edge.update(cd));
        if reset {
            self.cv = T::ZERO;
        } else if load {
            self.cv = pv;
        } else if up && !down {
            self.cv = self.cv.up();
        } else if down && !up {
            self.cv = self.cv.down();
        }
        self.qu = self.cv >= pv;
        self.qd = self.cv <= T::ZERO;
    }

    /// Whether the count had reached `pv` at the last update.
    #[must_use]
    pub const fn qu(&self) -> bool {
        self.qu
    }

    /// Whether the count had reached zero at the last update.
    #[must_use]
    pub const fn qd(&self) -> bool {
        self.qd
    }

    /// The count.
    #[must_use]
    pub const fn cv(&self) -> T {
        self.cv
    }
}
