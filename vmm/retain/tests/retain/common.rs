//! Images with retained variables.

use std::sync::{PoisonError, RwLock, RwLockReadGuard};

use takt_program::build::{Builder, Field, Kind, Task, Type, Variable};
use takt_program::{Area, CodeOffset, Elementary, Flags, Image, Nanoseconds};
use takt_retain::Layout;

/// Held for writing while a process is started: until it has executed its program it has the locks of all files that are
/// open here.
pub static STARTING: RwLock<()> = RwLock::new(());

/// While this lives, no process is started.
pub fn files_are_our_own() -> RwLockReadGuard<'static, ()> {
    STARTING.read().unwrap_or_else(PoisonError::into_inner)
}

/// An image with these variables: name, type, flags; 16 bytes apart, so none touches another.
pub fn image(patch: u16, variables: &[(&str, Own, Flags)]) -> Vec<u8> {
    let mut image = Builder::new("tank");
    image.version.patch = patch;
    image.code = vec![0xc3];
    image.state_bytes = 64 * variables.len() as u32 + 8;
    image.state = vec![0xee; 8];
    image.task(Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0)));
    for (at, (name, own, flags)) in (0..).zip(variables) {
        let ty = own.add(&mut image);
        image.variable(Variable::new(name, ty, Area::State, 64 * at).with(*flags));
    }
    image.build().unwrap()
}

/// A type.
#[derive(Clone, Copy)]
pub enum Own {
    One(Elementary),
    /// Of DINT.
    Array(i64, i64),
    /// `(a : INT; b : ARRAY [1..2] OF BOOL; c : REF_TO DINT)`.
    Block,
    Enumeration(&'static [&'static str]),
    Text(u32),
}

impl Own {
    fn add(self, image: &mut Builder) -> takt_program::TypeId {
        match self {
            Self::One(ty) => image.elementary(ty),
            Self::Array(lower, upper) => {
                let element = image.elementary(Elementary::Dint);
                let bytes = 4 * (upper - lower + 1) as u32;
                image.ty(Type::new(bytes, Kind::Array { element, lower, upper }))
            }
            Self::Block => {
                let int = image.elementary(Elementary::Int);
                let bool = image.elementary(Elementary::Bool);
                let bools =
                    image.ty(Type::new(2, Kind::Array { element: bool, lower: 1, upper: 2 }));
                let dint = image.elementary(Elementary::Dint);
                let reference = image.ty(Type::new(8, Kind::Reference { target: dint }));
                let field = |name: &str, ty, offset| Field { name: name.into(), ty, offset };
                let fields =
                    vec![field("a", int, 0), field("b", bools, 2), field("c", reference, 8)];
                image.ty(Type::new(16, Kind::FunctionBlock { fields }).named("MIX"))
            }
            Self::Enumeration(names) => {
                let values = (0..).zip(names).map(|(number, name)| ((*name).to_owned(), number));
                let kind = Kind::Enumeration { base: Elementary::Sint, values: values.collect() };
                image.ty(Type::new(1, kind).named("STEP"))
            }
            Self::Text(length) => image.ty(Type::new(length + 1, Kind::String { length })),
        }
    }
}

/// The layout of an image.
pub fn layout(bytes: &[u8]) -> Layout {
    Layout::of(&Image::parse(bytes).unwrap())
}

/// Some values: each byte is the number of its place and this.
pub fn block(layout: &Layout, seed: u8) -> Vec<u8> {
    (0..layout.initial().len()).map(|at| (at as u8).wrapping_mul(7).wrapping_add(seed)).collect()
}
