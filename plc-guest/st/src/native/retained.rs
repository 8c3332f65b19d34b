//! What of a variable outlives a start.
//!
//! An image tells that of whole variables. An instance of a program or function block is one variable, whose own variables
//! are RETAIN or not. Where they differ, what is retained of the instance is in the table a second time, part by part
//! ([`takt_program::Flags::PART`]).

use std::collections::HashMap;

use crate::hir::{Global, Retention, Type, TypeId, Types};

/// A part of a variable, all of which is retained in one way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// `INSTANCE.VARIABLE`.
    pub name: String,
    pub ty: TypeId,
    /// In the area.
    pub offset: u32,
    pub retention: Retention,
}

/// Finds what is retained.
pub struct Retained<'p> {
    types: &'p Types,
    /// How all of a type is retained, if it is retained in one way, by how what has it is.
    known: HashMap<(TypeId, Retention), Option<Retention>>,
    /// See [`Retained::restarts`].
    anew: HashMap<(TypeId, Retention, bool), bool>,
}

impl<'p> Retained<'p> {
    pub fn new(types: &'p Types) -> Self {
        Self { types, known: HashMap::new(), anew: HashMap::new() }
    }

    /// How the whole of a variable is retained, and where that differs, its retained parts; at most so many and one more.
    pub fn of(&mut self, global: &Global, most: usize) -> (Retention, Vec<Part>) {
        if let Some(retention) = self.uniform(global.ty, global.retention) {
            return (retention, Vec::new());
        }
        let whole = Part {
            name: global.name.clone(),
            ty: global.ty,
            offset: global.storage.offset,
            retention: global.retention,
        };
        let mut parts = Vec::new();
        self.open(whole, most, &mut parts);
        (Retention::None, parts)
    }

    /// Whether a part of a type, which is retained so, is NON_RETAIN and would be kept; `anew` if all of it is.
    pub fn restarts(&mut self, ty: TypeId, outer: Retention, anew: bool) -> bool {
        if let Some(known) = self.anew.get(&(ty, outer, anew)) {
            return *known;
        }
        let found = match self.types.get(ty) {
            Type::Array { element, .. } => self.restarts(*element, outer, anew),
            Type::Structure(structure) => structure.fields.iter().any(|field| {
                let own = field.retention;
                let anew = own == Retention::Never || anew && own == Retention::None;
                self.restarts(field.ty, outer.max(own), anew)
            }),
            _ => anew && outer > Retention::None,
        };
        self.anew.insert((ty, outer, anew), found);
        found
    }

    fn uniform(&mut self, ty: TypeId, outer: Retention) -> Option<Retention> {
        if let Some(known) = self.known.get(&(ty, outer)) {
            return *known;
        }
        let found = match self.types.get(ty) {
            Type::Array { element, .. } => self.uniform(*element, outer),
            Type::Structure(structure) => {
                let fields = structure.fields.iter();
                let mut all =
                    fields.map(|field| self.uniform(field.ty, outer.max(field.retention)));
                let first = all.next().unwrap_or(Some(outer));
                first.filter(|first| all.all(|other| other == Some(*first)))
            }
            _ => Some(outer),
        };
        self.known.insert((ty, outer), found);
        found
    }

    fn open(&mut self, part: Part, most: usize, to: &mut Vec<Part>) {
        if to.len() > most {
            return;
        }
        if let Some(retention) = self.uniform(part.ty, part.retention) {
            if retention != Retention::None {
                to.push(Part { retention, ..part });
            }
            return;
        }
        let Part { name, ty, offset, retention } = part;
        match self.types.get(ty) {
            Type::Array { element, lower, upper } => {
                let bytes = self.types.size(*element);
                for (index, place) in (*lower..=*upper).zip(0_u32..) {
                    let (name, offset) = (format!("{name}[{index}]"), offset + place * bytes);
                    self.open(Part { name, ty: *element, offset, retention }, most, to);
                }
            }
            Type::Structure(structure) => {
                for field in &structure.fields {
                    let name = format!("{name}.{}", field.name);
                    let (offset, retention) =
                        (offset + field.offset, retention.max(field.retention));
                    self.open(Part { name, ty: field.ty, offset, retention }, most, to);
                }
            }
            _ => {}
        }
    }
}
