//! Random programs, as their authors write them: names and types, from which images and values are made.
#![allow(dead_code, reason = "not every test file needs all of it")]

pub mod model;

use takt_change::{Memory, Room, TwoStates};
use takt_program::build::{Builder, Field, Kind, Task, Type, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds, TypeId};

/// Numbers that a seed repeats (xorshift64*).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 16
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    pub fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
}

/// A type as an author writes it.
#[derive(Clone, Debug, PartialEq)]
pub enum Ty {
    Elementary(Elementary),
    Text(u32),
    Array(i64, i64, Box<Ty>),
    Structure(String, Vec<(String, Ty)>),
    Reference(Elementary),
    /// Of so many names, which are numbered from 0.
    Enumeration(String, i64),
    Subrange(Elementary, i64, i64),
}

pub const ELEMENTARY: [Elementary; 12] = [
    Elementary::Bool,
    Elementary::Sint,
    Elementary::Int,
    Elementary::Dint,
    Elementary::Lint,
    Elementary::Usint,
    Elementary::Uint,
    Elementary::Word,
    Elementary::Real,
    Elementary::Lreal,
    Elementary::Time,
    Elementary::Ltime,
];

impl Ty {
    pub fn random(random: &mut Random, depth: u32, serial: &mut u32) -> Self {
        let elementary =
            |random: &mut Random| ELEMENTARY[random.below(ELEMENTARY.len() as u64) as usize];
        match random.below(if depth == 0 { 9 } else { 13 }) {
            0..=5 => Self::Elementary(elementary(random)),
            6 => Self::Text(random.below(12) as u32 + 1),
            7 => Self::Reference(elementary(random)),
            8 if random.one_in(2) => {
                *serial += 1;
                Self::Enumeration(format!("E{serial}"), random.below(3) as i64 + 1)
            }
            8 => {
                let low = random.below(6) as i64 - 3;
                Self::Subrange(Elementary::Int, low, low + random.below(6) as i64)
            }
            9 | 10 => {
                let low = random.below(4) as i64 - 2;
                let up = low + random.below(5) as i64;
                Self::Array(low, up, Box::new(Self::random(random, depth - 1, serial)))
            }
            _ => {
                *serial += 1;
                let name = format!("S{serial}");
                let fields = random.below(4) + 1;
                let fields = (0..fields)
                    .map(|n| (format!("f{n}"), Self::random(random, depth - 1, serial)))
                    .collect();
                Self::Structure(name, fields)
            }
        }
    }

    /// The same after the author's next idea.
    pub fn edited(&self, random: &mut Random, serial: &mut u32) -> Self {
        match self {
            _ if random.one_in(9) => Self::random(random, 1, serial),
            Self::Text(length) if random.one_in(3) => Self::Text(length + random.below(6) as u32),
            Self::Array(low, up, element) => {
                let low = low + if random.one_in(4) { random.below(3) as i64 - 1 } else { 0 };
                let up = up + if random.one_in(2) { random.below(4) as i64 - 1 } else { 0 };
                Self::Array(low, up.max(low), Box::new(element.edited(random, serial)))
            }
            Self::Structure(name, fields) => {
                let mut fields: Vec<_> = fields
                    .iter()
                    .map(|(name, ty)| (name.clone(), ty.edited(random, serial)))
                    .collect();
                edit_list(&mut fields, random, serial, 1);
                if fields.is_empty() {
                    fields.push(("only".into(), Self::Elementary(Elementary::Bool)));
                }
                Self::Structure(name.clone(), fields)
            }
            Self::Enumeration(name, names) if random.one_in(2) => {
                Self::Enumeration(name.clone(), (names + random.below(3) as i64 - 1).max(1))
            }
            Self::Subrange(base, low, high) if random.one_in(2) => {
                let base = if random.one_in(4) { Elementary::Dint } else { *base };
                let low = low + random.below(3) as i64 - 1;
                Self::Subrange(base, low, (high + random.below(3) as i64 - 1).max(low))
            }
            other => other.clone(),
        }
    }

    /// What one value is kept as.
    pub fn base(&self) -> Option<Elementary> {
        match self {
            Self::Elementary(base) | Self::Subrange(base, ..) => Some(*base),
            Self::Enumeration(..) => Some(Elementary::Int),
            _ => None,
        }
    }

    pub fn bytes(&self) -> u32 {
        match self {
            Self::Elementary(e) | Self::Subrange(e, ..) => e.bytes(),
            Self::Enumeration(..) => Elementary::Int.bytes(),
            Self::Text(length) => length + 1,
            Self::Array(low, up, element) => (up - low + 1) as u32 * element.bytes(),
            Self::Structure(_, fields) => {
                let (end, align) = fields.iter().fold((0u32, 1), |(end, align), (_, ty)| {
                    let place = end.next_multiple_of(ty.alignment());
                    (place + ty.bytes(), align.max(ty.alignment()))
                });
                end.next_multiple_of(align)
            }
            Self::Reference(_) => 8,
        }
    }

    pub fn alignment(&self) -> u32 {
        match self {
            Self::Elementary(e) | Self::Subrange(e, ..) => e.bytes(),
            Self::Enumeration(..) => Elementary::Int.bytes(),
            Self::Text(_) => 1,
            Self::Array(_, _, element) => element.alignment(),
            Self::Structure(_, fields) => {
                fields.iter().map(|(_, ty)| ty.alignment()).max().unwrap_or(1)
            }
            Self::Reference(_) => 8,
        }
    }

    /// Places of the fields.
    pub fn places(fields: &[(String, Ty)]) -> Vec<u32> {
        let mut end = 0u32;
        let places = fields.iter().map(|(_, ty)| {
            let place = end.next_multiple_of(ty.alignment());
            end = place + ty.bytes();
            place
        });
        places.collect()
    }

    fn add(&self, builder: &mut Builder) -> TypeId {
        match self {
            Self::Elementary(e) => builder.elementary(*e),
            Self::Text(length) => {
                builder.ty(Type::new(length + 1, Kind::String { length: *length }))
            }
            Self::Array(lower, upper, element) => {
                let element = element.add(builder);
                let kind = Kind::Array { element, lower: *lower, upper: *upper };
                builder.ty(Type::new(self.bytes(), kind))
            }
            Self::Structure(name, fields) => {
                let places = Self::places(fields);
                let fields: Vec<Field> = fields
                    .iter()
                    .zip(places)
                    .map(|((name, ty), offset)| Field {
                        name: name.clone(),
                        ty: ty.add(builder),
                        offset,
                    })
                    .collect();
                builder.ty(Type::new(self.bytes(), Kind::Structure { fields }).named(name))
            }
            Self::Enumeration(name, names) => {
                let base = Elementary::Int;
                let values = (0..*names).map(|value| (format!("n{value}"), value)).collect();
                builder.ty(Type::new(base.bytes(), Kind::Enumeration { base, values }).named(name))
            }
            Self::Subrange(base, low, high) => {
                let kind = Kind::Subrange { base: *base, low: *low, high: *high };
                builder.ty(Type::new(base.bytes(), kind))
            }
            Self::Reference(target) => {
                let target = builder.elementary(*target);
                builder.ty(Type::new(8, Kind::Reference { target }))
            }
        }
    }
}

/// Removes, adds, renames and reorders.
pub fn edit_list(list: &mut Vec<(String, Ty)>, random: &mut Random, serial: &mut u32, depth: u32) {
    if random.one_in(4) && !list.is_empty() {
        let at = random.below(list.len() as u64) as usize;
        list.remove(at);
    }
    if random.one_in(3) {
        let at = random.below(list.len() as u64 + 1) as usize;
        *serial += 1;
        list.insert(at, (format!("n{serial}"), Ty::random(random, depth, serial)));
    }
    if random.one_in(6) && list.len() > 1 {
        let (a, b) = (random.below(list.len() as u64), random.below(list.len() as u64));
        list.swap(a as usize, b as usize);
    }
}

/// A version of a program: its variables in the order in which they lie.
#[derive(Clone, Debug)]
pub struct Source(pub Vec<(String, Ty)>);

impl Source {
    pub fn random(random: &mut Random, serial: &mut u32) -> Self {
        let count = random.below(8);
        let list = (0..count).map(|n| (format!("v{n}"), Ty::random(random, 2, serial)));
        Self(list.collect())
    }

    pub fn edited(&self, random: &mut Random, serial: &mut u32) -> Self {
        let mut list: Vec<_> =
            self.0.iter().map(|(name, ty)| (name.clone(), ty.edited(random, serial))).collect();
        edit_list(&mut list, random, serial, 2);
        Self(list)
    }

    pub fn state_bytes(&self) -> u32 {
        let places = Ty::places(&self.0);
        places.iter().zip(&self.0).map(|(at, (_, ty))| at + ty.bytes()).max().unwrap_or(0)
    }

    /// The image, with this initial state.
    pub fn image(&self, initial: &[u8]) -> Vec<u8> {
        let mut builder = Builder::new("p");
        builder.code = vec![0xc3];
        builder.state = initial.to_vec();
        builder.state_bytes = self.state_bytes();
        for ((name, ty), place) in self.0.iter().zip(Ty::places(&self.0)) {
            let id = ty.add(&mut builder);
            builder.variable(Variable::new(name, id, Area::State, place));
        }
        builder.task(Task::cyclic("t", Nanoseconds(1_000_000), CodeOffset(0)));
        builder.build().unwrap()
    }
}

/// Memory that stops the test at an access outside of what a checked plan may reach.
pub struct TestMemory {
    pub state: Vec<u8>,
    pub initial: Vec<u8>,
    pub gathered: Vec<u8>,
    pub saved: Vec<u8>,
}

impl TestMemory {
    /// For states of at most so many bytes.
    pub fn new(state: &[u8], bytes: u32, image: &Image<'_>) -> Self {
        let mut state = state.to_vec();
        state.resize(bytes as usize, 0xee);
        let mut initial = image.state().to_vec();
        initial.resize(image.state_bytes() as usize, 0);
        Self {
            state,
            initial,
            gathered: vec![0xdd; takt_change::cost::GATHER_BYTES as usize],
            saved: vec![0xcc; takt_change::cost::SAVED_BYTES as usize],
        }
    }

    fn room(&self, room: Room) -> (&[u8], usize) {
        match room {
            Room::State(at) => (&self.state, at as usize),
            Room::Initial(at) => (&self.initial, at as usize),
            Room::Gathered(at) => (&self.gathered, at as usize),
            Room::Saved(at) => (&self.saved, at as usize),
        }
    }

    fn room_mut(&mut self, room: Room) -> (&mut [u8], usize) {
        match room {
            Room::State(at) => (&mut self.state, at as usize),
            Room::Initial(_) => panic!("the initial state is written"),
            Room::Gathered(at) => (&mut self.gathered, at as usize),
            Room::Saved(at) => (&mut self.saved, at as usize),
        }
    }
}

impl Memory for TestMemory {
    fn copy(&mut self, from: Room, to: Room, bytes: u32) {
        let (source, at) = self.room(from);
        let bytes = source[at..at + bytes as usize].to_vec();
        let (target, at) = self.room_mut(to);
        target[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    fn number(&self, at: Room, bytes: u32) -> u64 {
        let (source, at) = self.room(at);
        let mut number = [0; 8];
        number[..bytes as usize].copy_from_slice(&source[at..at + bytes as usize]);
        u64::from_le_bytes(number)
    }

    fn set_number(&mut self, at: Room, bytes: u32, value: u64) {
        let (target, at) = self.room_mut(at);
        target[at..at + bytes as usize].copy_from_slice(&value.to_le_bytes()[..bytes as usize]);
    }
}

/// Two states that stop the test at an access outside of them.
pub struct TestStates<'a> {
    pub old: &'a [u8],
    pub new: &'a mut [u8],
    pub lost: Vec<u32>,
}

impl TwoStates for TestStates<'_> {
    fn copy(&mut self, from: u32, to: u32, bytes: u32) {
        let (from, to, bytes) = (from as usize, to as usize, bytes as usize);
        self.new[to..to + bytes].copy_from_slice(&self.old[from..from + bytes]);
    }

    fn number(&self, from: u32, bytes: u32) -> u64 {
        let mut number = [0; 8];
        let from = from as usize;
        number[..bytes as usize].copy_from_slice(&self.old[from..from + bytes as usize]);
        u64::from_le_bytes(number)
    }

    fn set_number(&mut self, to: u32, bytes: u32, value: u64) {
        let to = to as usize;
        let bytes = &value.to_le_bytes()[..bytes as usize];
        self.new[to..to + bytes.len()].copy_from_slice(bytes);
    }

    fn lost(&mut self, to: u32) {
        self.lost.push(to);
    }
}
