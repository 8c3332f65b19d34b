//! Values, and how they lie in memory.

use takt_st::hir::{Class, Type, TypeId};

use super::{Machine, place::Target};

/// A value of any type.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// BOOL, integers, bit strings, times, references.
    Integer(i128),
    /// REAL (exactly representable) and LREAL.
    Real(f64),
    /// The units of a string.
    Text(Vec<u16>),
    /// Structures and arrays.
    Bytes(Vec<u8>),
}

impl Value {
    pub fn integer(&self) -> i128 {
        match self {
            Value::Integer(value) => *value,
            other => panic!("{other:?} is no integer"),
        }
    }

    pub fn real(&self) -> f64 {
        match self {
            Value::Real(value) => *value,
            other => panic!("{other:?} is no real"),
        }
    }

    pub fn text(self) -> Vec<u16> {
        match self {
            Value::Text(units) => units,
            other => panic!("{other:?} is no string"),
        }
    }

    pub fn is_true(&self) -> bool {
        self.integer() != 0
    }
}

impl Machine<'_> {
    pub(super) fn load(&mut self, address: u64, ty: TypeId) -> Value {
        let size = self.program.types.size(ty) as usize;
        let bytes = self.memory.read(address, size);
        match self.program.types.get(ty) {
            Type::String { capacity } => {
                let bytes =
                    bytes.iter().take(usize::from(*capacity)).take_while(|byte| **byte != 0);
                Value::Text(bytes.map(|&byte| u16::from(byte)).collect())
            }
            Type::WString { capacity } => {
                let units =
                    bytes.chunks_exact(2).map(|unit| u16::from_le_bytes([unit[0], unit[1]]));
                Value::Text(
                    units.take(usize::from(*capacity)).take_while(|unit| *unit != 0).collect(),
                )
            }
            _ => match self.program.types.scalar(ty) {
                Some(elementary) if elementary.class() == Class::Float => Value::Real(match size {
                    4 => f64::from(f32::from_le_bytes(bytes.try_into().expect("4 bytes"))),
                    _ => f64::from_le_bytes(bytes.try_into().expect("8 bytes")),
                }),
                Some(elementary) => {
                    let mut all = [0; 16];
                    all[..size].copy_from_slice(&bytes);
                    Value::Integer(elementary.wrap(i128::from_le_bytes(all)))
                }
                None => Value::Bytes(bytes),
            },
        }
    }

    pub(super) fn store(&mut self, address: u64, ty: TypeId, value: &Value) {
        let size = self.program.types.size(ty) as usize;
        let (capacity, width) = match self.program.types.get(ty) {
            Type::String { capacity } => (*capacity, 1),
            Type::WString { capacity } => (*capacity, 2),
            _ => (0, 0),
        };
        let bytes = match value {
            Value::Integer(value) => value.to_le_bytes()[..size].to_vec(),
            Value::Real(value) if size == 4 => (*value as f32).to_le_bytes().to_vec(),
            Value::Real(value) => value.to_le_bytes().to_vec(),
            Value::Bytes(bytes) => bytes.clone(),
            Value::Text(units) => {
                let units = &units[..units.len().min(usize::from(capacity))];
                let mut bytes = Vec::new();
                for unit in units.iter().chain([&0]) {
                    bytes.extend(&unit.to_le_bytes()[..width]);
                }
                bytes
            }
        };
        self.memory.write(address, &bytes);
    }

    pub(super) fn load_target(&mut self, target: &Target, ty: TypeId) -> Value {
        match target.bit {
            None => self.load(target.address, ty),
            Some(bit) => {
                Value::Integer(i128::from(self.memory.read(target.address, 1)[0] >> bit & 1))
            }
        }
    }

    pub(super) fn store_target(&mut self, target: &Target, ty: TypeId, value: &Value) {
        match target.bit {
            None => self.store(target.address, ty, value),
            Some(bit) => {
                let byte = self.memory.read(target.address, 1)[0];
                let set = u8::from(value.is_true()) << bit;
                self.memory.write(target.address, &[byte & !(1 << bit) | set]);
            }
        }
    }
}
