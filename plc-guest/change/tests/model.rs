//! Random programs and random edits of them: a plan does what a model does that knows names and values only.

mod common;

use common::{Random, Source, TestMemory, Ty};
use takt_change::make::{Change, Refusal};
use takt_change::{Plan, Ready};
use takt_program::{Elementary, Image, address};

/// In a build without optimisation a case takes twenty times as long.
const CASES: u64 = if cfg!(debug_assertions) { 4_000 } else { 100_000 };

/// A value by its name: what the model works with.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Bytes(Vec<u8>),
    /// The elements, with the lowest index.
    Array(i64, Vec<Value>),
    Structure(Vec<(String, Value)>),
    /// The name of the part that it refers to.
    Reference(Option<String>),
}

/// Names of the elementary values of a source with their places and types.
fn leaves(source: &Source) -> Vec<(String, u32, Elementary)> {
    fn walk(name: &str, at: u32, ty: &Ty, to: &mut Vec<(String, u32, Elementary)>) {
        match ty {
            Ty::Elementary(e) => to.push((name.to_owned(), at, *e)),
            Ty::Text(_) | Ty::Reference(_) => {}
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
        Ty::Elementary(_) | Ty::Text(_) => Value::Bytes(bytes.to_vec()),
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

/// The value of the new version: the old one where there is one of the name and a fitting type.
fn carry(old: &Value, old_ty: &Ty, new_ty: &Ty, initial: &Value) -> Value {
    match (old_ty, new_ty, old, initial) {
        (Ty::Elementary(a), Ty::Elementary(b), Value::Bytes(bytes), _) => {
            widened(*a, *b, bytes).map_or_else(|| initial.clone(), Value::Bytes)
        }
        (Ty::Text(a), Ty::Text(b), Value::Bytes(bytes), Value::Bytes(rest)) if a <= b => {
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
                there.map_or_else(|| initial.clone(), |old| carry(old, a, b, initial))
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
                    Some(((_, old_ty), (_, old))) => carry(old, old_ty, ty, initial),
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
fn values(source: &Source, state: &[u8]) -> Vec<(String, Value)> {
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
fn expected(old: &Source, state: &[u8], new: &Source, initial: &[u8]) -> Vec<(String, Value)> {
    let before = values(old, state);
    let there = carried_leaves(old, new);
    let after = values(new, initial).into_iter().zip(&new.0).map(|((name, initial), (_, ty))| {
        let known = old.0.iter().zip(&before).find(|((other, _), _)| *other == name);
        let value = match known {
            Some(((_, old_ty), (_, value))) => {
                let mut value = value.clone();
                forget(&mut value, &there);
                carry(&value, old_ty, ty, &initial)
            }
            None => initial,
        };
        (name, value)
    });
    after.collect()
}

/// A random state, with references to places of their types.
fn random_state(random: &mut Random, source: &Source, wild: bool) -> Vec<u8> {
    fn fill(
        random: &mut Random,
        at: u32,
        ty: &Ty,
        leaves: &[(String, u32, Elementary)],
        state: &mut [u8],
    ) {
        match ty {
            Ty::Elementary(_) | Ty::Text(_) => {
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

#[test]
fn a_plan_does_what_a_model_by_names_does_and_the_way_back_too() {
    let (mut planned, mut moved, mut converted, mut references, mut early) = (0, 0, 0, 0, 0);
    for seed in 1..=CASES {
        let random = &mut Random::new(seed);
        let mut serial = 0;
        let old = Source::random(random, &mut serial);
        let mut new = old.edited(random, &mut serial);
        if random.one_in(3) {
            new = new.edited(random, &mut serial);
        }
        let initial = random_state(random, &new, false);
        let old_initial = random_state(random, &old, false);
        let (old_file, new_file) = (old.image(&old_initial), new.image(&initial));
        let (a, b) = (Image::parse(&old_file).unwrap(), Image::parse(&new_file).unwrap());
        let change = Change::between(&a, &b);
        let Some(plans) = &change.plans else {
            for refusal in &change.refusals {
                // A reference to a type that has changed; elementary targets never do.
                assert!(
                    matches!(refusal, Refusal::Reference { .. } | Refusal::Cost { .. }),
                    "seed {seed}: {refusal}"
                );
            }
            continue;
        };
        planned += 1;
        let state = random_state(random, &old, true);
        let bytes = a.state_bytes().max(b.state_bytes());
        let mut memory = TestMemory::new(&state, bytes, &b);
        let plan = Plan::parse(&plans.forward, &a, &b).unwrap();
        let ready = Ready::new(plan);
        let mut done = Some(0);
        while let Some(now) = done {
            done = ready.prepare(now, 1 + random.below(9), &mut memory);
        }
        assert_eq!(
            &memory.state[..state.len()],
            &state[..],
            "seed {seed}: too early\n{old:?}\n{new:?}"
        );
        ready.apply(&mut memory);
        let found = values(&new, &memory.state);
        let wanted = expected(&old, &state, &new, &initial);
        assert_eq!(found, wanted, "seed {seed}\n{old:?}\n{new:?}");

        // The new version computes, and then the way is back.
        let during = random_state(random, &new, true);
        for ((_, ty), at) in new.0.iter().zip(Ty::places(&new.0)) {
            let range = at as usize..(at + ty.bytes()) as usize;
            memory.state[range.clone()].copy_from_slice(&during[range]);
        }
        memory.initial = old_initial.clone();
        memory.initial.resize(a.state_bytes() as usize, 0);
        let back = Plan::parse(&plans.back, &b, &a).unwrap();
        Ready::new(back).apply(&mut memory);
        let found = values(&old, &memory.state);
        let wanted = expected(&new, &during, &old, &state);
        assert_eq!(found, wanted, "seed {seed}, back\n{old:?}\n{new:?}");

        let cost = plan.cost();
        moved += u64::from(cost.moved > 0);
        converted += u64::from(cost.converted > 0);
        references += u64::from(cost.references > 0);
        early += u64::from(cost.early > 0);
    }
    // The cases are what they are meant to be.
    assert!(planned > CASES * 8 / 10, "{planned}");
    for count in [moved, converted, references, early] {
        assert!(count > CASES / 50, "{moved} {converted} {references} {early}");
    }
}
