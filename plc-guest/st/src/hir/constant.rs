//! Values that are known when the program is compiled.

use std::sync::Arc;

use super::{GlobalId, TypeId, Types, types::Type};

/// A value. Its type is where it is used.
#[derive(Clone, Debug, PartialEq)]
pub enum Constant {
    /// What the type begins with if nothing else is said: the fields' own initial values for a structure, the lower
    /// bound of a subrange that does not contain 0, the first value of an enumeration, else zero, empty or NULL.
    Default,
    /// BOOL, integers, bit strings, characters, times, enumerations and subranges.
    Integer(i128),
    /// REAL and LREAL. A REAL is rounded when the tree is made.
    Real(f64),
    /// STRING, at most as long as the type's capacity.
    String(Vec<u8>),
    /// WSTRING, at most as long as the type's capacity.
    WString(Vec<u16>),
    /// `REF(variable)` of a variable in the state, or of a field of one: the indices of fields on the way to it.
    Address(GlobalId, Vec<u32>),
    /// Array or structure: one value for each element or field, in order. Missing ones at the end are
    /// [`Constant::Default`]. They are shared: many variables may have the values of one type.
    Aggregate(Arc<[Constant]>),
    /// Array: as many elements of the same value as the array has.
    Fill(Box<Constant>),
}

impl Types {
    /// The integer that a scalar type begins with.
    pub fn first_value(&self, id: TypeId) -> i128 {
        match self.get(id) {
            Type::Enumeration { values, .. } => values.first().map_or(0, |(_, value)| *value),
            Type::Subrange { lower, upper, .. } if *lower > 0 || *upper < 0 => *lower,
            _ => 0,
        }
    }

    /// Writes `value` of type `id` to `bytes`, which has the type's size. `address` gives the address of a
    /// global variable's field, by the indices on the way to it.
    pub fn encode(
        &self,
        id: TypeId,
        value: &Constant,
        bytes: &mut [u8],
        address: &dyn Fn(GlobalId, &[u32]) -> u64,
    ) {
        match (self.get(id), value) {
            (Type::Array { element, lower, upper }, value) => {
                let count = (upper - lower + 1) as usize;
                let size = self.size(*element) as usize;
                for (index, part) in bytes.chunks_exact_mut(size).take(count).enumerate() {
                    let initial = match value {
                        Constant::Aggregate(values) => {
                            values.get(index).unwrap_or(&Constant::Default)
                        }
                        Constant::Fill(value) => value,
                        _ => &Constant::Default,
                    };
                    self.encode(*element, initial, part, address);
                }
            }
            (Type::Structure(structure), value) => {
                for (index, field) in structure.fields.iter().enumerate() {
                    let given = match value {
                        Constant::Aggregate(values) => values.get(index),
                        _ => None,
                    };
                    let initial = match given {
                        None | Some(Constant::Default) => &field.initial,
                        Some(given) => given,
                    };
                    let start = field.offset as usize;
                    let end = start + self.size(field.ty) as usize;
                    self.encode(field.ty, initial, &mut bytes[start..end], address);
                }
            }
            (Type::String { .. }, Constant::String(text)) => {
                bytes[..text.len()].copy_from_slice(text);
                bytes[text.len()..].fill(0);
            }
            (Type::WString { .. }, Constant::WString(text)) => {
                bytes.fill(0);
                for (unit, place) in text.iter().zip(bytes.chunks_exact_mut(2)) {
                    place.copy_from_slice(&unit.to_le_bytes());
                }
            }
            (Type::String { .. } | Type::WString { .. } | Type::OpenArray { .. }, _) => {
                bytes.fill(0)
            }
            (_, Constant::Real(value)) if bytes.len() == 4 => {
                bytes.copy_from_slice(&(*value as f32).to_le_bytes())
            }
            (_, Constant::Real(value)) => bytes.copy_from_slice(&value.to_le_bytes()),
            (_, Constant::Address(global, fields)) => {
                bytes.copy_from_slice(&address(*global, fields).to_le_bytes());
            }
            (_, value) => {
                let integer = match value {
                    Constant::Integer(integer) => *integer,
                    _ => self.first_value(id),
                };
                let size = bytes.len();
                bytes.copy_from_slice(&integer.to_le_bytes()[..size]);
            }
        }
    }
}
