//! When a value of one type is, byte by byte, one of another.

use std::collections::HashMap;
use std::string::String;
use std::vec::Vec;

use takt_program::{Elementary, Image, Type, TypeId, TypeKind};

use crate::conversion::alike;

/// Compares types of two images, each pair once.
pub struct Likeness<'a> {
    pub old: Image<'a>,
    pub new: Image<'a>,
    known: HashMap<(TypeId, TypeId), bool>,
    references: [HashMap<TypeId, bool>; 2],
}

/// Whether names are the same, as IEC 61131-3 compares them.
pub fn same_name(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

impl<'a> Likeness<'a> {
    pub fn new(old: &Image<'a>, new: &Image<'a>) -> Self {
        let references = [HashMap::new(), HashMap::new()];
        Self { old: *old, new: *new, known: HashMap::new(), references }
    }

    /// Whether each value of the old type is one of the new type, with the same parts at the same places.
    pub fn same(&mut self, old: TypeId, new: TypeId) -> bool {
        if let Some(known) = self.known.get(&(old, new)) {
            return *known;
        }
        let same = match (self.old.type_of(old), self.new.type_of(new)) {
            (Some(old), Some(new)) => old.bytes == new.bytes && self.same_kind(&old, &new),
            _ => false,
        };
        self.known.insert((old, new), same);
        same
    }

    fn same_kind(&mut self, old: &Type<'a>, new: &Type<'a>) -> bool {
        match (old.kind, new.kind) {
            (TypeKind::String { length: a }, TypeKind::String { length: b })
            | (TypeKind::WString { length: a }, TypeKind::WString { length: b }) => a == b,
            (
                TypeKind::Array { element: a, lower: low_a, upper: up_a },
                TypeKind::Array { element: b, lower: low_b, upper: up_b },
            ) => (low_a, up_a) == (low_b, up_b) && self.same(a, b),
            (TypeKind::Structure, TypeKind::Structure)
            | (TypeKind::FunctionBlock, TypeKind::FunctionBlock) => self.same_fields(old, new),
            // What they refer to is compared where the references are collected.
            (TypeKind::Reference { .. }, TypeKind::Reference { .. }) => true,
            _ => {
                let (a, b) = (base(old), base(new));
                a.zip(b).is_some_and(|(a, b)| alike(a, b)) && self.takes_values(old, new)
            }
        }
    }

    fn same_fields(&mut self, old: &Type<'a>, new: &Type<'a>) -> bool {
        let a: Vec<_> = self.old.fields(old).collect();
        let b: Vec<_> = self.new.fields(new).collect();
        same_name(old.name, new.name)
            && a.len() == b.len()
            && a.iter().zip(&b).all(|(a, b)| {
                same_name(a.name, b.name) && a.offset == b.offset && self.same(a.ty, b.ty)
            })
    }

    /// Whether each value that the old type names or allows means the same in the new type.
    pub fn takes_values(&self, old: &Type<'a>, new: &Type<'a>) -> bool {
        match (old.kind, new.kind) {
            (TypeKind::Enumeration { .. }, TypeKind::Enumeration { .. }) => {
                let there: HashMap<String, i64> =
                    self.new.values(new).map(|v| (v.name.to_ascii_lowercase(), v.value)).collect();
                same_name(old.name, new.name)
                    && self
                        .old
                        .values(old)
                        .all(|v| there.get(&v.name.to_ascii_lowercase()) == Some(&v.value))
            }
            (
                TypeKind::Subrange { low: old_low, high: old_high, base },
                TypeKind::Subrange { low, high, base: new_base },
            ) => {
                let (unsigned, new_unsigned) = (is_unsigned(base), is_unsigned(new_base));
                number(low, new_unsigned) <= number(old_low, unsigned)
                    && number(old_high, unsigned) <= number(high, new_unsigned)
            }
            // Any number is one of the base, but not the other way round.
            (_, TypeKind::Enumeration { .. } | TypeKind::Subrange { .. }) => false,
            _ => true,
        }
    }

    /// Whether a type of the old image, or of the new one, has a reference in it.
    pub fn has_reference(&mut self, in_new: bool, id: TypeId) -> bool {
        let known = &self.references[usize::from(in_new)];
        if let Some(known) = known.get(&id) {
            return *known;
        }
        let image = if in_new { self.new } else { self.old };
        let Some(ty) = image.type_of(id) else { return false };
        let has = match ty.kind {
            TypeKind::Reference { .. } => true,
            TypeKind::Array { element, .. } => self.has_reference(in_new, element),
            TypeKind::Structure | TypeKind::FunctionBlock => {
                let mut fields = image.fields(&ty);
                fields.any(|field| self.has_reference(in_new, field.ty))
            }
            _ => false,
        };
        self.references[usize::from(in_new)].insert(id, has);
        has
    }
}

fn is_unsigned(base: Elementary) -> bool {
    use Elementary as E;
    !matches!(base, E::Sint | E::Int | E::Dint | E::Lint)
}

fn number(bound: i64, unsigned: bool) -> i128 {
    if unsigned { i128::from(bound as u64) } else { bound.into() }
}

/// What a value of this type is kept as, if that is one elementary value.
pub fn base(ty: &Type<'_>) -> Option<Elementary> {
    match ty.kind {
        TypeKind::Elementary(base)
        | TypeKind::Enumeration { base }
        | TypeKind::Subrange { base, .. } => Some(base),
        _ => None,
    }
}
