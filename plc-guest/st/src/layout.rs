//! Places of variables that a new version takes over from the running one.
//!
//! A change of a running program is cheap and harmless if nothing moves: so a variable that both versions have, with
//! the same size, stays where it is. A new one goes where nothing of the new version lies, at the first place that is
//! large enough, and else behind the end. The same holds for the fields of structures and the variables of function
//! blocks and programs.
//!
//! Not so for messages of channels and for inputs and outputs: others know their layout, and the size of messages. Structures
//! in them lie as in a first version.
//!
//! A function block that grows beyond its old size makes what contains it larger, too. What is then too large for its
//! old place moves; what lies behind it stays.

use std::collections::{BTreeMap, HashMap, HashSet};

use takt_program::{Image, TypeKind};

use crate::hir::{Area, ExprKind, Intrinsic, Program, Type, TypeId, Types};
use crate::native::walk;

/// Where something lay: the first byte, and how many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    offset: u32,
    size: u32,
}

/// What is to be placed: its size, its alignment, and where it lay.
struct Part {
    size: u32,
    align: u32,
    old: Option<Place>,
}

/// Places by names in upper case.
type Places = HashMap<String, Place>;

/// Gives variables and fields the places that they have in an older version of the program.
pub fn keep(program: &mut Program, old: &Image<'_>) {
    let mut structures = Structures { old: fields(old), done: known_outside(program) };
    let ids: Vec<TypeId> = program.types.iter().map(|(id, _)| id).collect();
    for id in ids {
        structures.lay_out(program, id);
    }
    let before: Places = old
        .variables()
        .filter(|variable| variable.area == takt_program::Area::State)
        .map(|variable| {
            let place = Place { offset: variable.offset, size: variable.bytes };
            (variable.name.to_ascii_uppercase(), place)
        })
        .collect();
    let own: Vec<usize> = (0..program.globals.len())
        .filter(|index| program.globals[*index].storage.area == Area::State)
        .collect();
    let parts: Vec<Part> = own
        .iter()
        .map(|index| {
            let global = &program.globals[*index];
            Part {
                size: program.types.size(global.ty),
                align: program.types.align(global.ty),
                old: before.get(&global.name.to_ascii_uppercase()).copied(),
            }
        })
        .collect();
    for (index, offset) in own.into_iter().zip(place(&parts).0) {
        program.globals[index].storage.offset = offset;
    }
}

/// The types of messages, inputs and outputs, with all that are in them.
fn known_outside(program: &Program) -> HashSet<TypeId> {
    let areas = [Area::Input, Area::Output];
    let globals = program.globals.iter().filter(|global| areas.contains(&global.storage.area));
    let mut waiting: Vec<TypeId> = globals.map(|global| global.ty).collect();
    for routine in &program.routines {
        walk::expressions(&routine.body, &mut |expr| {
            if let ExprKind::Intrinsic(
                Intrinsic::ChannelRead(_) | Intrinsic::ChannelWrite(_),
                arguments,
            ) = &expr.kind
                && let Some(ExprKind::Reference(place)) = arguments.first().map(|one| &one.kind)
            {
                waiting.push(place.ty);
            }
        });
    }
    let mut known = HashSet::new();
    while let Some(id) = waiting.pop() {
        if known.insert(id) {
            match program.types.get(id) {
                Type::Array { element, .. } => waiting.push(*element),
                Type::Structure(structure) => {
                    waiting.extend(structure.fields.iter().map(|field| field.ty));
                }
                _ => {}
            }
        }
    }
    known
}

/// The fields of all structures, function blocks and programs that have a name, by that name.
fn fields(old: &Image<'_>) -> HashMap<String, (Places, u32)> {
    old.types()
        .filter(|ty| {
            !ty.name.is_empty() && matches!(ty.kind, TypeKind::Structure | TypeKind::FunctionBlock)
        })
        .map(|ty| {
            let places = old.fields(&ty).map(|field| {
                let size = old.type_of(field.ty).map_or(0, |ty| ty.bytes);
                (field.name.to_ascii_uppercase(), Place { offset: field.offset, size })
            });
            (ty.name.to_ascii_uppercase(), (places.collect(), ty.bytes))
        })
        .collect()
}

/// The structures of a program while their fields are placed, inner ones first.
struct Structures {
    old: HashMap<String, (Places, u32)>,
    done: HashSet<TypeId>,
}

impl Structures {
    fn lay_out(&mut self, program: &mut Program, id: TypeId) {
        if !self.done.insert(id) {
            return;
        }
        let fields = match program.types.get(id) {
            Type::Array { element, .. } => return self.lay_out(program, *element),
            Type::Structure(structure) => structure.fields.clone(),
            _ => return,
        };
        for field in &fields {
            self.lay_out(program, field.ty);
        }
        let Some(structure) = program.types.structure(id) else { return };
        let (name, align) = (structure.name.to_ascii_uppercase(), structure.align);
        let room = |end| if structure.room { Types::with_room(end) } else { end };
        let known = self.old.get(&name);
        let parts: Vec<Part> = fields
            .iter()
            .map(|field| Part {
                size: program.types.size(field.ty),
                align: program.types.align(field.ty),
                old: known
                    .and_then(|(places, _)| places.get(&field.name.to_ascii_uppercase()).copied()),
            })
            .collect();
        let (offsets, end) = place(&parts);
        // The room that is left behind the last field gets smaller, until the structure has to grow.
        let size = match known {
            Some((_, old_size)) if end <= *old_size => *old_size,
            _ => room(end).max(1).next_multiple_of(align),
        };
        program.types.place_fields(id, &offsets, size.next_multiple_of(align));
    }
}

/// A place for each part, and the byte behind the last.
fn place(parts: &[Part]) -> (Vec<u32>, u32) {
    let mut offsets: Vec<Option<u32>> = vec![None; parts.len()];
    let mut taken = Taken::default();
    let fits = |part: &Part, place: &Place| place.offset.is_multiple_of(part.align.max(1));
    // What has not changed, and then what has another size and finds room at its old place.
    for same in [true, false] {
        for (part, offset) in parts.iter().zip(&mut offsets) {
            if let Some(old) = &part.old
                && offset.is_none()
                && (old.size == part.size) == same
                && fits(part, old)
                && taken.take(old.offset, part.size)
            {
                *offset = Some(old.offset);
            }
        }
    }
    let placed = parts.iter().zip(offsets).map(|(part, offset)| match offset {
        Some(offset) => offset,
        None => taken.first_free(part.size, part.align.max(1)),
    });
    let placed: Vec<u32> = placed.collect();
    (placed, taken.end())
}

/// Stretches that are in use, ascending and apart from each other.
#[derive(Default)]
struct Taken {
    stretches: BTreeMap<u32, u32>,
    /// Before which byte nothing of this size and alignment is free: what is taken stays taken.
    full: HashMap<(u32, u32), u32>,
}

impl Taken {
    /// A stretch that is taken and meets this one.
    fn in_the_way(&self, start: u32, size: u32) -> Option<(u32, u32)> {
        let last = self.stretches.range(..start.saturating_add(size)).next_back()?;
        (*last.1 > start).then_some((*last.0, *last.1))
    }

    /// Takes a stretch, unless a part of it is taken.
    fn take(&mut self, start: u32, size: u32) -> bool {
        let Some(end) = start.checked_add(size) else { return false };
        let free = self.in_the_way(start, size).is_none();
        if free && size > 0 {
            self.stretches.insert(start, end);
        }
        free
    }

    /// Takes the first stretch of this size and alignment that is free.
    fn first_free(&mut self, size: u32, align: u32) -> u32 {
        let mut at = self.full.get(&(size, align)).copied().unwrap_or(0);
        while let Some((_, end)) = self.in_the_way(at, size) {
            at = end.next_multiple_of(align);
        }
        self.take(at, size);
        self.full.insert((size, align), at);
        at
    }

    fn end(&self) -> u32 {
        self.stretches.last_key_value().map_or(0, |(_, end)| *end)
    }
}

#[cfg(test)]
#[path = "layout_tests.rs"]
mod tests;
