//! Places: what can be read, assigned and referred to.

use super::{Expr, GlobalId, LocalId, TypeId};

/// A variable or a part of one.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Where the path begins.
    pub root: Root,
    /// From the root to the part.
    pub path: Vec<Step>,
    /// The type of the part.
    pub ty: TypeId,
}

/// Where a path begins.
#[derive(Clone, Debug, PartialEq)]
pub enum Root {
    /// A global variable or a program instance.
    Global(GlobalId),
    /// A parameter, a local variable or the result. One that is passed by reference stands for what it refers to.
    Local(LocalId),
    /// The instance whose body runs. Only in a routine that has one.
    Instance,
    /// What a reference refers to. NULL traps.
    Deref(Box<Expr>),
}

/// One step of a path.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// A field of a structure, by its index.
    Field(u32),
    /// An element of an array. The index is of a signed or unsigned integer type; one outside of the bounds traps.
    Index(Box<Expr>),
    /// An element of an open array: one index per dimension.
    OpenIndex(Vec<Expr>),
    /// A character of a string, at a position from 1. The index is of an integer type; one outside of the string's length
    /// traps. The last step of a path; its type is CHAR or WCHAR.
    Unit(Box<Expr>),
    /// A bit of an integer or bit string, 0 the least significant. The last step of a path; its type is BOOL.
    Bit(u8),
    /// Some bytes of an integer or bit string (`%B1`, `%W0`), as a value of the given type. The last step of a path.
    Part {
        /// The offset in bytes from the least significant byte.
        offset: u32,
        /// The type of the part.
        ty: TypeId,
    },
}

impl Place {
    /// The whole of a global variable.
    pub fn global(id: GlobalId, ty: TypeId) -> Place {
        Place { root: Root::Global(id), path: Vec::new(), ty }
    }

    /// The whole of a local variable.
    pub fn local(id: LocalId, ty: TypeId) -> Place {
        Place { root: Root::Local(id), path: Vec::new(), ty }
    }

    /// The instance whose body runs.
    pub fn instance(ty: TypeId) -> Place {
        Place { root: Root::Instance, path: Vec::new(), ty }
    }

    /// What `reference` refers to.
    pub fn deref(reference: Expr, target: TypeId) -> Place {
        Place { root: Root::Deref(Box::new(reference)), path: Vec::new(), ty: target }
    }

    /// The field `index`, of type `ty`, of the structure at this place.
    pub fn field(self, index: u32, ty: TypeId) -> Place {
        self.with(Step::Field(index), ty)
    }

    /// The element at `index`, of type `ty`, of the array at this place.
    pub fn index(self, index: Expr, ty: TypeId) -> Place {
        self.with(Step::Index(Box::new(index)), ty)
    }

    fn with(mut self, step: Step, ty: TypeId) -> Place {
        // Most paths have one step.
        self.path.reserve_exact(1);
        self.path.push(step);
        self.ty = ty;
        self
    }
}
