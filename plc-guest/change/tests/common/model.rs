//! What a change does, by names and values only: what plans are compared with.
#![allow(dead_code, reason = "not every test file needs all of it")]

use super::{Random, Source, Ty};
use takt_program::{Elementary, address};

/// A value by its name: what the model works with.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    Bytes(Vec<u8>),
    /// The elements, with the lowest index.
    Array(i64, Vec<Value>),
    Structure(Vec<(String, Value)>),
    /// The name of the part that it refers to.
    Reference(Option<String>),
}

/// Names of the elementary values of a source with their places and types.
pub fn leaves(source: &Source) -> Vec<(String, u32, Elementary)> {
    fn walk(name: &str, at: u32, ty: &Ty, to: &mut Vec<(String, u32, Elementary)>) {
        match ty {
            Ty::Elementary(e) => to.push((name.to_owned(), at, *e)),
            Ty::Text(_) | Ty::Reference(_) | Ty::Enumeration(..) | Ty::Subrange(..) => {}
            Ty::Array(low, up, element) => {
                for index in *low..=*up {
                    let at = at + (index - low) as u32 * element.bytes();
                    walk(&format!("{name}[{index}]"), at, element, to);
                }
            }
            Ty::Structure(_, fields) => {
                for ((field, ty), offset) in fields.iter().zip(Ty::places(fields)) {
                    walk(&format!("{name}.{field}"), at + offset, ty, to);
                }
            }
        }
    }
    let mut found = Vec::new();
    for ((name, ty), at) in source.0.iter().zip(Ty::places(&source.0)) {
        walk(name, at, ty, &mut found);
    }
    found
}

/// Reads a value out of a state.
fn read(state: &[u8], at: u32, ty: &Ty, leaves: &[(String, u32, Elementary)]) -> Value {
    let bytes = &state[at as usize..(at + ty.bytes()) as usize];
    match ty {
        Ty::Elementary(_) | Ty::Text(_) | Ty::Enumeration(..) | Ty::Subrange(..) => {
            Value::Bytes(bytes.to_vec())
        }
        Ty::Reference(target) => {
            let address = u64::from_le_bytes(bytes.try_into().unwrap());
            let found = leaves.iter().find(|(_, at, ty)| {
                address::STATE + u64::from(*at) == address && ty.bytes() == target.bytes()
            });
            Value::Reference(found.map(|(name, ..)| name.clone()))
        }
        Ty::Array(low, up, element) => {
            let place = |index: i64| at + (index - low) as u32 * element.bytes();
            Value::Array(
                *low,
                (*low..=*up).map(|i| read(state, place(i), element, leaves)).collect(),
            )
        }
        Ty::Structure(_, fields) => {
            let places = Ty::places(fields);
            let values = fields
                .iter()
                .zip(places)
                .map(|((name, ty), offset)| (name.clone(), read(state, at + offset, ty, leaves)));
            Value::Structure(values.collect())
        }
    }
}

fn widened(from: Elementary, to: Elementary, bytes: &[u8]) -> Option<Vec<u8>> {
    use Elementary as E;
    let class = |e| match e {
        E::Sint | E::Int | E::Dint | E::Lint => 's',
        E::Usint | E::Uint | E::Udint | E::Ulint => 'u',
        E::Real | E::Lreal => 'f',
        E::Time | E::Ltime => 't',
        E::Bool => 'b',
        _ => 'w',
    };
    if class(from) == class(to) && from.bytes() == to.bytes() {
        return Some(bytes.to_vec());
    }
    let mut wide = [0; 8];
    wide[..bytes.len()].copy_from_slice(bytes);
    let unsigned = i128::from(u64::from_le_bytes(wide));
    let half = 1i128 << (8 * from.bytes() - 1);
    let number = match class(from) {
        's' if unsigned >= half => unsigned - 2 * half,
        _ => unsigned,
    };
    let (from_bits, to_bits) = (8 * from.bytes(), 8 * to.bytes());
    match (class(from), class(to)) {
        ('s', 's') | ('u', 'u') | ('u', 's') | ('w', 'w') | ('b', 'w') if from_bits < to_bits => {
            Some(number.to_le_bytes()[..to.bytes() as usize].to_vec())
        }
        ('s' | 'u', 'f') if to == E::Real && from_bits <= 16 => {
            Some((number as f32).to_le_bytes().to_vec())
        }
        ('s' | 'u', 'f') if to == E::Lreal && from_bits <= 32 => {
            Some((number as f64).to_le_bytes().to_vec())
        }
        ('f', 'f') if from_bits < to_bits => {
            let value = f32::from_le_bytes(bytes.try_into().unwrap());
            Some(f64::from(value).to_le_bytes().to_vec())
        }
        _ => None,
    }
}

/// Whether each value of the old type means the same in the new one.
fn means_the_same(old: &Ty, new: &Ty) -> bool {
    match (old, new) {
        (Ty::Enumeration(a, few), Ty::Enumeration(b, many)) => a == b && few <= many,
        (Ty::Subrange(_, a, b), Ty::Subrange(_, low, high)) => low <= a && b <= high,
        (_, Ty::Enumeration(..) | Ty::Subrange(..)) => false,
        _ => true,
    }
}

/// One value in another type.
fn one_value(old: &Ty, new: &Ty, bytes: &[u8]) -> Option<Vec<u8>> {
    let (a, b) = old.base().zip(new.base())?;
    means_the_same(old, new).then(|| widened(a, b, bytes))?
}

/// The value of the new version: the old one where there is one of the name and a fitting type.
/// With `both`, only what gets back unchanged, too.
fn carry(old: &Value, old_ty: &Ty, new_ty: &Ty, initial: &Value, both: bool) -> Value {
    match (old_ty, new_ty, old, initial) {
        (a, b, Value::Bytes(bytes), _) if a.base().is_some() => {
            let gets_back = || one_value(b, a, &vec![0; b.bytes() as usize]).is_some();
            let there = one_value(a, b, bytes).filter(|_| !both || gets_back());
            there.map_or_else(|| initial.clone(), Value::Bytes)
        }
        (Ty::Text(a), Ty::Text(b), Value::Bytes(bytes), Value::Bytes(rest))
            if a == b || (a < b && !both) =>
        {
            let mut text = bytes.clone();
            text.extend_from_slice(&rest[bytes.len()..]);
            Value::Bytes(text)
        }
        (Ty::Reference(_), Ty::Reference(_), old, _) => old.clone(),
        (
            Ty::Array(_, _, a),
            Ty::Array(_, _, b),
            Value::Array(from, old),
            Value::Array(to, new),
        ) => {
            let elements = (*to..).zip(new).map(|(index, initial)| {
                let there = usize::try_from(index - from).ok().and_then(|at| old.get(at));
                there.map_or_else(|| initial.clone(), |old| carry(old, a, b, initial, both))
            });
            Value::Array(*to, elements.collect())
        }
        (
            Ty::Structure(a, old_fields),
            Ty::Structure(b, fields),
            Value::Structure(old),
            Value::Structure(new),
        ) if a == b => {
            let values = fields.iter().zip(new).map(|((name, ty), (_, initial))| {
                let there = old_fields.iter().zip(old).find(|((other, _), _)| other == name);
                let value = match there {
                    Some(((_, old_ty), (_, old))) => carry(old, old_ty, ty, initial, both),
                    None => initial.clone(),
                };
                (name.clone(), value)
            });
            Value::Structure(values.collect())
        }
        _ => initial.clone(),
    }
}

/// Where a part of the old version is whole in the new one: names with types alike, from the variable down.
fn carried_leaves(old: &Source, new: &Source) -> Vec<String> {
    fn walk(name: &str, a: &Ty, b: &Ty, to: &mut Vec<String>) {
        match (a, b) {
            (Ty::Elementary(a), Ty::Elementary(b)) => {
                let zero = vec![0; a.bytes() as usize];
                if a.bytes() == b.bytes() && widened(*a, *b, &zero).is_some() {
                    to.push(name.to_owned());
                }
            }
            (Ty::Array(low, up, a), Ty::Array(new_low, new_up, b)) => {
                for index in *low.max(new_low)..=*up.min(new_up) {
                    walk(&format!("{name}[{index}]"), a, b, to);
                }
            }
            (Ty::Structure(x, a), Ty::Structure(y, b)) if x == y => {
                for (field, a) in a {
                    if let Some((_, b)) = b.iter().find(|(other, _)| other == field) {
                        walk(&format!("{name}.{field}"), a, b, to);
                    }
                }
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    for (name, a) in &old.0 {
        if let Some((_, b)) = new.0.iter().find(|(other, _)| other == name) {
            walk(name, a, b, &mut found);
        }
    }
    found
}

/// The state as names and values; references that lead to something gone lead nowhere.
pub fn values(source: &Source, state: &[u8]) -> Vec<(String, Value)> {
    let leaves = leaves(source);
    let places = Ty::places(&source.0);
    let read =
        |((name, ty), at): (&(String, Ty), u32)| (name.clone(), read(state, at, ty, &leaves));
    source.0.iter().zip(places).map(read).collect()
}

fn forget(value: &mut Value, there: &[String]) {
    match value {
        Value::Bytes(_) => {}
        Value::Reference(target) => {
            if target.as_ref().is_some_and(|name| !there.contains(name)) {
                *target = None;
            }
        }
        Value::Array(_, values) => values.iter_mut().for_each(|value| forget(value, there)),
        Value::Structure(fields) => fields.iter_mut().for_each(|(_, value)| forget(value, there)),
    }
}

/// What the model expects after the change of `state`, where parts without a like take those of `initial`.
pub fn expected(old: &Source, state: &[u8], new: &Source, initial: &[u8]) -> Vec<(String, Value)> {
    expected_of(old, state, new, initial, false)
}

/// The same if only those values are carried that get back unchanged, too.
pub fn expected_both_ways(
    old: &Source,
    state: &[u8],
    new: &Source,
    initial: &[u8],
) -> Vec<(String, Value)> {
    expected_of(old, state, new, initial, true)
}

fn expected_of(
    old: &Source,
    state: &[u8],
    new: &Source,
    initial: &[u8],
    both: bool,
) -> Vec<(String, Value)> {
    let before = values(old, state);
    let there = carried_leaves(old, new);
    let after = values(new, initial).into_iter().zip(&new.0).map(|((name, initial), (_, ty))| {
        let known = old.0.iter().zip(&before).find(|((other, _), _)| *other == name);
        let value = match known {
            Some(((_, old_ty), (_, value))) => {
                let mut value = value.clone();
                forget(&mut value, &there);
                carry(&value, old_ty, ty, &initial, both)
            }
            None => initial,
        };
        (name, value)
    });
    after.collect()
}

/// A random state, with references to places of their types.
pub fn random_state(random: &mut Random, source: &Source, wild: bool) -> Vec<u8> {
    fn fill(
        random: &mut Random,
        at: u32,
        ty: &Ty,
        leaves: &[(String, u32, Elementary)],
        state: &mut [u8],
    ) {
        match ty {
            Ty::Elementary(_) | Ty::Text(_) | Ty::Enumeration(..) | Ty::Subrange(..) => {
                for byte in &mut state[at as usize..(at + ty.bytes()) as usize] {
                    *byte = random.next() as u8;
                }
                if *ty == Ty::Elementary(Elementary::Bool) {
                    state[at as usize] &= 1;
                }
                if let Ty::Elementary(e @ (Elementary::Real | Elementary::Lreal)) = ty {
                    // A number: what a NaN's payload becomes is the processor's business.
                    let (small, large) = (random.next() as f32, random.next() as f64);
                    let place = at as usize;
                    match e {
                        Elementary::Real => {
                            state[place..place + 4].copy_from_slice(&small.to_le_bytes())
                        }
                        _ => state[place..place + 8].copy_from_slice(&large.to_le_bytes()),
                    }
                }
            }
            Ty::Reference(target) => {
                let fitting: Vec<_> = leaves.iter().filter(|(.., ty)| ty == target).collect();
                let value = match random.below(4) {
                    0 => 0,
                    _ if fitting.is_empty() => 0,
                    _ => {
                        let (_, at, _) = fitting[random.below(fitting.len() as u64) as usize];
                        address::STATE + u64::from(*at)
                    }
                };
                state[at as usize..at as usize + 8].copy_from_slice(&value.to_le_bytes());
            }
            Ty::Array(low, up, element) => {
                for n in 0..=(up - low) as u32 {
                    fill(random, at + n * element.bytes(), element, leaves, state);
                }
            }
            Ty::Structure(_, fields) => {
                for ((_, ty), offset) in fields.iter().zip(Ty::places(fields)) {
                    fill(random, at + offset, ty, leaves, state);
                }
            }
        }
    }
    let mut state = vec![0; source.state_bytes() as usize];
    // An initial state has no addresses.
    let leaves = if wild { leaves(source) } else { Vec::new() };
    for ((_, ty), at) in source.0.iter().zip(Ty::places(&source.0)) {
        fill(random, at, ty, &leaves, &mut state);
    }
    state
}
