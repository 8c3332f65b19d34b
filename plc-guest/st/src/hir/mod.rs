//! The typed tree: a program after semantic analysis.
//!
//! Everything that ST leaves implicit is explicit here: each expression has its type, each conversion is a node, each
//! name is an index, each variable has its storage. The front end builds the tree; the code generator and the
//! interpreter of the tests read it. Both rely on the rules that are written at each item.
//!
//! What has no node of its own is written with the nodes that exist:
//! - A call of a function block is assignments to its input fields, an [`StatementKind::Invoke`], and assignments from
//!   its output fields. A `VAR_IN_OUT` of a function block is a field of a reference type that the caller sets; an open array is a
//!   parameter instead, as its bounds belong to the call.
//! - EN and ENO are an `IF` around the call.
//! - A task is a routine without parameters that invokes its program instances.
//! - `MUX`, and `LIMIT` of all but reals, are made of [`Intrinsic::Min`], [`Intrinsic::Max`] and [`Intrinsic::Select`].

mod constant;
mod elementary;
mod expr;
mod intrinsic;
mod place;
mod print;
mod program;
mod statement;
mod structure;
mod test;
mod trap;
mod types;

pub use constant::Constant;
pub use elementary::{Class, Elementary};
pub use expr::{Argument, Arithmetic, Comparison, Conversion, Expr, ExprKind, UnaryOperator};
pub use intrinsic::{Channel, Intrinsic, Simulation};
pub use place::{Place, Root, Step};
pub use print::print;
pub use program::{
    Area, DEFAULT_LOOP_BUDGET, Event, Global, GlobalId, Local, LocalId, LocalKind, Location,
    Object, ObjectKind, Port, Program, Retention, Routine, RoutineId, Storage, Task, TaskKind,
};
pub use statement::{Block, CaseArm, ForLoop, Statement, StatementKind};
pub use structure::{Field, Section, Structure, StructureKind};
pub use takt_program::Direction;
pub use test::{Assertion, Compared, Test, Tests};
pub use trap::{Trap, TrapKind};
pub use types::{Type, TypeId, Types};
