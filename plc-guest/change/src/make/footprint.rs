//! Which bytes of the state variables name.
//!
//! Structured Text has no state but its variables. Programs in C and Rust can have `static` data that no table
//! names. It is not known where such bytes belong in another version, so a program with them is not changed
//! while it runs. Gaps that alignment makes between two variables are no state; what hides in a gap of that kind cannot be seen.

use core::ops::Range;
use std::collections::HashMap;
use std::string::{String, ToString};
use std::vec::Vec;

use takt_program::{Area, Image, TypeId, TypeKind, Variable};

/// What linkers align large objects to.
const LARGE_ALIGNMENT: u32 = 32;

/// Where `takt plc build` begins the zeros of C and Rust behind the initial values: at a multiple of this (`program.ld`).
const ZEROS_ALIGNMENT: u32 = 64;

/// The variables of the state, in the order of their places.
pub fn state_variables<'a>(image: &Image<'a>) -> Vec<Variable<'a>> {
    let is_whole = |v: &Variable<'_>| v.area == Area::State && !v.is_part();
    let mut variables: Vec<_> = image.variables().filter(is_whole).collect();
    variables.sort_by_key(|v| (v.offset, core::cmp::Reverse(v.bytes)));
    variables
}

/// The ranges of the state that no variable names, without gaps of alignment.
pub fn nameless(image: &Image<'_>) -> impl Iterator<Item = Range<u32>> + use<> {
    let mut alignments = Alignments { image, known: HashMap::new() };
    let (initial, bytes) = (image.state().len() as u32, image.state_bytes());
    let sections = [0..initial, initial.next_multiple_of(ZEROS_ALIGNMENT)..bytes];
    let mut gaps = Vec::new();
    let mut add = |gap: Range<u32>, alignment| {
        for section in &sections {
            let part = gap.start.max(section.start)..gap.end.min(section.end);
            // A section begins with its first object and ends with its last one: there is nothing to align there.
            let is_between = section.start < part.start && part.end < section.end;
            let least = if is_between { alignment } else { 1 };
            gaps.extend((part.len() as u32 >= least).then_some(part));
        }
    };
    let mut end = 0;
    for variable in state_variables(image) {
        if variable.offset > end {
            let alignment = match alignments.of(variable.ty) {
                _ if variable.bytes >= LARGE_ALIGNMENT => LARGE_ALIGNMENT,
                alignment => alignment,
            };
            add(end..variable.offset, alignment);
        }
        end = end.max(variable.offset + variable.bytes);
    }
    add(end..bytes, 1);
    gaps.into_iter()
}

/// Pairs of variables that share bytes.
pub fn shared(image: &Image<'_>) -> Vec<(String, String)> {
    let mut pairs = Vec::new();
    let mut furthest: Option<Variable<'_>> = None;
    for variable in state_variables(image) {
        let end = |v: &Variable<'_>| v.offset + v.bytes;
        if let Some(other) = furthest.filter(|other| end(other) > variable.offset) {
            pairs.push((other.name.to_string(), variable.name.to_string()));
        }
        if furthest.is_none_or(|other| end(&variable) > end(&other)) {
            furthest = Some(variable);
        }
    }
    pairs
}

struct Alignments<'a, 'b> {
    image: &'b Image<'a>,
    known: HashMap<TypeId, u32>,
}

impl Alignments<'_, '_> {
    fn of(&mut self, id: TypeId) -> u32 {
        if let Some(known) = self.known.get(&id) {
            return *known;
        }
        let Some(ty) = self.image.type_of(id) else { return 1 };
        let alignment = match ty.kind {
            TypeKind::Elementary(base)
            | TypeKind::Enumeration { base }
            | TypeKind::Subrange { base, .. } => base.bytes(),
            TypeKind::String { .. } => 1,
            TypeKind::WString { .. } => 2,
            TypeKind::Array { element, .. } => self.of(element),
            TypeKind::Structure | TypeKind::FunctionBlock => {
                let fields: Vec<TypeId> = self.image.fields(&ty).map(|field| field.ty).collect();
                fields.into_iter().map(|field| self.of(field)).max().unwrap_or(1)
            }
            TypeKind::Reference { .. } => 8,
        };
        self.known.insert(id, alignment);
        alignment
    }
}
