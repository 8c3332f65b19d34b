//! Random typed trees.
//!
//! They are made to be well-formed, to end, and to trap seldom: most divisors are odd, most indices are taken modulo
//! the size of the array. What is left of traps is meant to be there.

mod expr;
mod place;
mod program;
mod statement;

use takt_st::hir::{
    Elementary, Expr, ExprKind, Local, Location, Place, Program, RoutineId, TypeId,
};

/// SplitMix64 of Steele, Lea and Flood: small, and every seed is good.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    pub fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }
}

/// A function that can be called, with what its caller needs to know.
#[derive(Clone)]
pub struct Callable {
    pub id: RoutineId,
    pub parameters: Vec<Local>,
    pub result: Option<TypeId>,
}

/// The state of a generation.
pub struct Generator {
    pub random: Random,
    pub program: Program,
    /// Places that can be read, in the routine that is being made.
    pub readable: Vec<Place>,
    /// Places that can be assigned.
    pub writable: Vec<Place>,
    pub functions: Vec<Callable>,
    /// Instances that can be invoked, with the body.
    pub instances: Vec<(Place, Callable)>,
    pub locals: Vec<Local>,
    /// Open arrays among the parameters.
    pub open: Vec<Place>,
    lines: u32,
    /// The variables of the FOR loops around that count from one constant to another, with these.
    pub counters: Vec<(Place, i128, i128)>,
    pub loops: u32,
    pub size: u32,
}

/// A random program with one task.
pub fn generate(seed: u64) -> Program {
    program::generate(seed)
}

impl Generator {
    /// A new place in an imaginary source, so that each node has its own.
    pub fn here(&mut self) -> Location {
        self.lines += 1;
        Location { file: 0, line: self.lines, column: 1 }
    }

    pub fn node(&mut self, ty: TypeId, kind: ExprKind) -> Expr {
        let location = self.here();
        Expr::new(ty, kind, location)
    }

    pub fn elementary(&mut self, elementary: Elementary) -> TypeId {
        self.program.types.elementary(elementary)
    }
}
