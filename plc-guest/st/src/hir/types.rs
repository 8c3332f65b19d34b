//! Types and their layout in memory.
//!
//! A type is an index into [`Types`]. Types that are equal by structure (arrays, strings, references) are stored once,
//! so that equal indices mean equal types. Structures and enumerations are equal only to themselves.

use std::collections::{HashMap, HashSet};

use super::Constant;
use super::elementary::Elementary;
use super::structure::{Field, Section, Structure, StructureKind};

/// A type of a [`Types`] table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TypeId(pub u32);

/// What a type is.
#[derive(Clone, Debug, PartialEq)]
pub enum Type {
    /// A type of one value.
    Elementary(Elementary),
    /// `STRING[capacity]`: `capacity` bytes and one more. The text ends at the first zero byte.
    String {
        /// The greatest length in bytes.
        capacity: u16,
    },
    /// `WSTRING[capacity]`: likewise of UTF-16 units.
    WString {
        /// The greatest length in units.
        capacity: u16,
    },
    /// Named values of an integer type.
    Enumeration {
        /// The type's name.
        name: String,
        /// The type of its values.
        base: Elementary,
        /// Names and values, as declared.
        values: Vec<(String, i128)>,
    },
    /// An integer type with a narrower range. A value is checked where it is converted to the subrange.
    Subrange {
        /// The type's name.
        name: String,
        /// The type of its values.
        base: Elementary,
        /// The least value.
        lower: i128,
        /// The greatest value.
        upper: i128,
    },
    /// One dimension; an array of several dimensions is an array of arrays, the first index outermost.
    Array {
        /// The type of an element.
        element: TypeId,
        /// The least index.
        lower: i64,
        /// The greatest index, at least `lower`.
        upper: i64,
    },
    /// `ARRAY[*, *] OF element` as the type of a parameter that is passed by reference.
    OpenArray {
        /// The type of an element.
        element: TypeId,
        /// How many dimensions.
        dimensions: u8,
    },
    /// A structure, a function block or a program.
    Structure(Structure),
    /// `REF_TO target`: an address; 0 is NULL.
    Reference {
        /// The type of what is referred to.
        target: TypeId,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Key {
    Elementary(Elementary),
    String(u16),
    WString(u16),
    Array(TypeId, i64, i64),
    OpenArray(TypeId, u8),
    Reference(TypeId),
}

/// All types of a program.
#[derive(Clone, Debug, Default)]
pub struct Types {
    list: Vec<Type>,
    /// How deep each one is.
    depths: Vec<u32>,
    known: HashMap<Key, TypeId>,
}

impl Types {
    /// A table without types.
    pub fn new() -> Types {
        Types::default()
    }

    fn known(&mut self, key: Key, ty: Type) -> TypeId {
        if let Some(&id) = self.known.get(&key) {
            return id;
        }
        let id = self.add(ty);
        self.known.insert(key, id);
        id
    }

    fn add(&mut self, ty: Type) -> TypeId {
        let deepest = match &ty {
            Type::Array { element, .. } | Type::OpenArray { element, .. } => self.depth(*element),
            // It ends there: the structure may have the reference in it.
            Type::Reference { target } if self.structure(*target).is_some() => 0,
            Type::Reference { target } => self.depth(*target),
            _ => 0,
        };
        self.depths.push(1 + deepest);
        self.list.push(ty);
        TypeId(self.list.len() as u32 - 1)
    }

    /// The elementary type.
    pub fn elementary(&mut self, elementary: Elementary) -> TypeId {
        self.known(Key::Elementary(elementary), Type::Elementary(elementary))
    }

    /// `STRING[capacity]`.
    pub fn string(&mut self, capacity: u16) -> TypeId {
        self.known(Key::String(capacity), Type::String { capacity })
    }

    /// `WSTRING[capacity]`.
    pub fn wstring(&mut self, capacity: u16) -> TypeId {
        self.known(Key::WString(capacity), Type::WString { capacity })
    }

    /// `ARRAY[lower..upper] OF element`. The caller has verified `lower <= upper` and that the size fits in the state.
    pub fn array(&mut self, element: TypeId, lower: i64, upper: i64) -> TypeId {
        self.known(Key::Array(element, lower, upper), Type::Array { element, lower, upper })
    }

    /// `ARRAY[*, ...] OF element`.
    pub fn open_array(&mut self, element: TypeId, dimensions: u8) -> TypeId {
        self.known(Key::OpenArray(element, dimensions), Type::OpenArray { element, dimensions })
    }

    /// `REF_TO target`.
    pub fn reference(&mut self, target: TypeId) -> TypeId {
        self.known(Key::Reference(target), Type::Reference { target })
    }

    /// A new enumeration.
    pub fn enumeration(
        &mut self,
        name: &str,
        base: Elementary,
        values: Vec<(String, i128)>,
    ) -> TypeId {
        self.add(Type::Enumeration { name: name.to_owned(), base, values })
    }

    /// A new subrange.
    pub fn subrange(&mut self, name: &str, base: Elementary, lower: i128, upper: i128) -> TypeId {
        self.add(Type::Subrange { name: name.to_owned(), base, lower, upper })
    }

    /// A structure whose fields follow with [`Types::define`], so that a field may refer to the structure.
    pub fn declare(&mut self, name: &str, kind: StructureKind) -> TypeId {
        self.add(Type::Structure(Structure {
            name: name.to_owned(),
            kind,
            fields: Vec::new(),
            size: 0,
            align: 1,
            room: false,
        }))
    }

    /// Gives the structure `id` one more field behind the others, at the next offset that its type's alignment allows.
    /// Returns its index. The field's type must be complete.
    ///
    /// # Panics
    /// If `id` is no structure: an error of the compiler.
    pub fn define(
        &mut self,
        id: TypeId,
        name: &str,
        ty: TypeId,
        initial: Constant,
        section: Section,
        retention: super::Retention,
    ) -> u32 {
        let (size, align) = (self.size(ty), self.align(ty));
        let depth = self.depth(id).max(1 + self.depth(ty));
        self.depths[id.0 as usize] = depth;
        let Type::Structure(structure) = &mut self.list[id.0 as usize] else {
            panic!("fields of a type that is no structure");
        };
        let offset = structure.size.next_multiple_of(align);
        structure.align = structure.align.max(align);
        structure.size = offset + size;
        structure.fields.push(Field {
            name: name.to_owned(),
            ty,
            offset,
            initial,
            section,
            retention,
        });
        structure.fields.len() as u32 - 1
    }

    /// Ends the definition of structure `id`: rounds its size up to its alignment. A structure without fields has size
    /// 1, so that two variables never share an address.
    pub fn complete(&mut self, id: TypeId) {
        if let Type::Structure(structure) = &mut self.list[id.0 as usize] {
            structure.size = structure.size.max(1).next_multiple_of(structure.align);
        }
    }

    /// Ends the definition of structure `id` with room for the fields of later versions, of any type: an eighth of its
    /// size, and at least two variables of 8 bytes. So the usual change of a program moves none of its instances.
    pub fn complete_with_room(&mut self, id: TypeId) {
        if let Type::Structure(structure) = &mut self.list[id.0 as usize] {
            structure.align = 8;
            structure.room = true;
            structure.size = Self::with_room(structure.size);
        }
        self.complete(id);
    }

    /// The size of a structure whose last field ends there, with room for later ones.
    pub fn with_room(end: u32) -> u32 {
        end.next_multiple_of(8) + (end / 8).max(16)
    }

    /// How far into a value of type `id` the field lies to which these indices lead.
    pub fn field_offset(&self, id: TypeId, fields: &[u32]) -> u32 {
        let mut at = (id, 0);
        for index in fields {
            let field =
                self.structure(at.0).and_then(|structure| structure.fields.get(*index as usize));
            let Some(field) = field else { break };
            at = (field.ty, at.1 + field.offset);
        }
        at.1
    }

    /// Gives structure `id` other places for its fields, and another size.
    pub fn place_fields(&mut self, id: TypeId, offsets: &[u32], size: u32) {
        if let Type::Structure(structure) = &mut self.list[id.0 as usize] {
            for (field, offset) in structure.fields.iter_mut().zip(offsets) {
                field.offset = *offset;
            }
            structure.size = size;
        }
    }

    /// What `id` is.
    pub fn get(&self, id: TypeId) -> &Type {
        &self.list[id.0 as usize]
    }

    /// The structure that `id` is.
    pub fn structure(&self, id: TypeId) -> Option<&Structure> {
        match self.get(id) {
            Type::Structure(structure) => Some(structure),
            _ => None,
        }
    }

    /// Whether a value of `id` is an instance of a function block, or has one in it.
    pub fn has_instance(&self, id: TypeId) -> bool {
        let (mut waiting, mut seen) = (vec![id], HashSet::new());
        while let Some(id) = waiting.pop() {
            match self.get(id) {
                Type::Structure(structure) if structure.kind != StructureKind::Struct => {
                    return true;
                }
                Type::Structure(structure) if seen.insert(id) => {
                    waiting.extend(structure.fields.iter().map(|field| field.ty));
                }
                Type::Array { element, .. } | Type::OpenArray { element, .. } => {
                    waiting.push(*element);
                }
                _ => {}
            }
        }
        false
    }

    /// How many types are within each other in `id`, with itself: what walks types goes as deep. A reference goes on to
    /// what it refers to unless that is a structure.
    pub fn depth(&self, id: TypeId) -> u32 {
        self.depths[id.0 as usize]
    }

    /// All types with their indices.
    pub fn iter(&self) -> impl Iterator<Item = (TypeId, &Type)> {
        self.list.iter().enumerate().map(|(index, ty)| (TypeId(index as u32), ty))
    }

    /// The elementary type that values of `id` are represented by: the base of an enumeration or subrange, ULINT for a
    /// reference, `None` for strings and whatever has parts.
    pub fn scalar(&self, id: TypeId) -> Option<Elementary> {
        match self.get(id) {
            Type::Elementary(elementary) => Some(*elementary),
            Type::Enumeration { base, .. } | Type::Subrange { base, .. } => Some(*base),
            Type::Reference { .. } => Some(Elementary::Ulint),
            _ => None,
        }
    }

    /// Whether `id` is a STRING or a WSTRING.
    pub fn is_string(&self, id: TypeId) -> bool {
        matches!(self.get(id), Type::String { .. } | Type::WString { .. })
    }

    /// The size of a value in bytes, a multiple of its alignment. 0 for an open array.
    pub fn size(&self, id: TypeId) -> u32 {
        match self.get(id) {
            Type::Elementary(elementary) => elementary.size(),
            Type::Enumeration { base, .. } | Type::Subrange { base, .. } => base.size(),
            Type::String { capacity } => u32::from(*capacity) + 1,
            Type::WString { capacity } => 2 * (u32::from(*capacity) + 1),
            Type::Array { element, lower, upper } => {
                self.size(*element) * (upper - lower + 1) as u32
            }
            Type::OpenArray { .. } => 0,
            Type::Structure(structure) => structure.size,
            Type::Reference { .. } => 8,
        }
    }

    /// The alignment of a value in bytes.
    pub fn align(&self, id: TypeId) -> u32 {
        match self.get(id) {
            Type::Elementary(elementary) => elementary.size(),
            Type::Enumeration { base, .. } | Type::Subrange { base, .. } => base.size(),
            Type::String { .. } => 1,
            Type::WString { .. } => 2,
            Type::Array { element, .. } | Type::OpenArray { element, .. } => self.align(*element),
            Type::Structure(structure) => structure.align,
            Type::Reference { .. } => 8,
        }
    }

    /// The type as one writes it.
    pub fn name(&self, id: TypeId) -> String {
        match self.get(id) {
            Type::Elementary(elementary) => elementary.name().to_owned(),
            Type::String { capacity } => format!("STRING[{capacity}]"),
            Type::WString { capacity } => format!("WSTRING[{capacity}]"),
            Type::Enumeration { name, .. } | Type::Subrange { name, .. } => name.clone(),
            Type::Array { element, lower, upper } => {
                format!("ARRAY[{lower}..{upper}] OF {}", self.name(*element))
            }
            Type::OpenArray { element, dimensions } => {
                let stars = vec!["*"; usize::from(*dimensions)].join(", ");
                format!("ARRAY[{stars}] OF {}", self.name(*element))
            }
            Type::Structure(structure) => structure.name.clone(),
            Type::Reference { target } => format!("REF_TO {}", self.name(*target)),
        }
    }
}

#[cfg(test)]
#[path = "types_tests.rs"]
mod tests;
