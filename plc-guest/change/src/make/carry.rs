//! Where each value of a version gets to in another one.

use std::collections::{HashMap, HashSet};
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use takt_program::{Area, Image, Type, TypeId, TypeKind, Variable};

use super::entry::{Entry, Fate};
use super::footprint::shared;
use super::likeness::{Likeness, base, same_name};
use super::refusal::Refusal;
use super::targets::Targets;
use crate::conversion::{Conversion, alike};

/// Most pairs of parts that are looked at: all variables of the largest image, and many parts.
const LOOKS: u32 = 1 << 20;
/// Most things that engineers are told.
const ENTRIES: usize = 100_000;

/// What happens to some bytes of the new state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    pub to: u32,
    pub what: What,
}

/// Where bytes come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// From this place of the old state, as they are.
    Carry { from: u32, bytes: u32 },
    /// From this place, converted.
    Convert { from: u32, count: u32, conversion: Conversion },
    /// From the initial state.
    Initial { bytes: u32 },
}

impl What {
    pub const fn bytes(&self) -> u32 {
        match *self {
            Self::Carry { bytes, .. } | Self::Initial { bytes } => bytes,
            Self::Convert { count, conversion, .. } => count * conversion.to().bytes(),
        }
    }
}

/// What becomes of the state of one version in another.
#[derive(Clone, Debug, Default)]
pub struct Carried {
    /// All bytes of all variables of the new version.
    pub pieces: Vec<Piece>,
    /// References that come along: where they are, and where they get to.
    pub references: Vec<(u32, u32)>,
    /// What engineers are told.
    pub entries: Vec<Entry>,
    pub refusals: Vec<Refusal>,
    /// True if something has no like in the new version.
    pub drops: bool,
    /// True if it was given up, as there were too many parts.
    pub too_many: bool,
}

/// A pair of parts of the same name.
#[derive(Clone, Copy)]
struct Pair<'n> {
    name: &'n str,
    old: TypeId,
    new: TypeId,
    from: u32,
    to: u32,
    /// False for all elements of an array but the first, whose fate is told for all.
    told: bool,
}

struct Carrier<'a> {
    is_back: bool,
    likeness: Likeness<'a>,
    /// That of the other way: an enumeration with one more name is like the old one on the way there alone.
    reverse: Likeness<'a>,
    carried: Carried,
    targets: Targets,
    looks: u32,
}

impl Carried {
    /// Matches the variables of the state, for the way there.
    pub fn there(old: &Image<'_>, new: &Image<'_>) -> Self {
        Self::from(old, new, false)
    }

    /// The same for the way back, which has to bring back what has come there.
    pub fn back(new: &Image<'_>, old: &Image<'_>) -> Self {
        Self::from(new, old, true)
    }

    fn from(old: &Image<'_>, new: &Image<'_>, is_back: bool) -> Self {
        let mut carrier = Carrier {
            is_back,
            likeness: Likeness::new(old, new),
            reverse: Likeness::new(new, old),
            carried: Self::default(),
            targets: Targets::default(),
            looks: 0,
        };
        let is_whole = |v: &Variable<'_>| v.area == Area::State && !v.is_part();
        let of_state = |image: &Image<'_>, name: &str| {
            image.variable(name).filter(is_whole).map(|v| (v.ty, v.offset))
        };
        for variable in new.variables().filter(is_whole) {
            match of_state(old, variable.name) {
                None => carrier.begin(variable.name, variable.ty, variable.offset, Fate::New, true),
                Some((ty, from)) => carrier.pair(Pair {
                    name: variable.name,
                    old: ty,
                    new: variable.ty,
                    from,
                    to: variable.offset,
                    told: true,
                }),
            }
        }
        for variable in old.variables().filter(is_whole) {
            if of_state(new, variable.name).is_none() {
                carrier.drop(variable.name.to_string(), variable.ty);
            }
        }
        let kept = carrier.carried.kept();
        carrier.check_shared(old, &kept);
        carrier.check_shared(new, &kept);
        carrier.carried.refusals.extend(carrier.targets.refusals());
        carrier.carried.entries.sort_by_cached_key(|entry| entry.name.to_ascii_lowercase());
        carrier.carried
    }

    /// What stays as it is, as a whole, in small letters.
    pub fn kept(&self) -> HashSet<String> {
        let kept = self.entries.iter().filter(|e| e.fate == Fate::Kept);
        kept.map(|e| e.name.to_ascii_lowercase()).collect()
    }

    /// Whether a reference may lose its target: what is gone, or has another type.
    pub fn loses(&self) -> bool {
        self.drops || self.pieces.iter().any(|piece| matches!(piece.what, What::Convert { .. }))
    }

    /// Whether anything gets to another place, or is gone: then references must follow.
    pub fn moves(&self) -> bool {
        self.drops
            || self.pieces.iter().any(|piece| match piece.what {
                What::Carry { from, .. } => from != piece.to,
                What::Convert { .. } => true,
                What::Initial { .. } => false,
            })
    }
}

impl<'a> Carrier<'a> {
    fn piece(&mut self, to: u32, what: What) {
        if self.carried.pieces.len() < LOOKS as usize {
            self.carried.pieces.push(Piece { to, what });
        } else {
            self.carried.too_many = true;
        }
    }

    fn tell(&mut self, told: bool, name: String, ty: String, fate: Fate) {
        if told && self.carried.entries.len() < ENTRIES {
            self.carried.entries.push(Entry { name, ty, fate });
        }
    }

    /// A part begins with its initial value.
    fn begin(&mut self, name: &str, ty: TypeId, to: u32, fate: Fate, told: bool) {
        let Some(found) = self.likeness.new.type_of(ty) else { return };
        self.piece(to, What::Initial { bytes: found.bytes });
        if told {
            let ty = self.likeness.new.type_name(ty).to_string();
            self.tell(true, name.to_string(), ty, fate);
        }
    }

    fn drop(&mut self, name: String, ty: TypeId) {
        self.carried.drops = true;
        let ty = self.likeness.old.type_name(ty).to_string();
        self.tell(true, name, ty, Fate::Dropped);
    }

    fn look(&mut self) -> bool {
        self.looks += 1;
        self.carried.too_many |= self.looks > LOOKS;
        !self.carried.too_many
    }

    fn pair(&mut self, pair: Pair<'_>) {
        if !self.look() {
            return;
        }
        let (old_image, new_image) = (self.likeness.old, self.likeness.new);
        let types = (old_image.type_of(pair.old), new_image.type_of(pair.new));
        let (Some(old), Some(new)) = types else { return };
        if self.likeness.same(pair.old, pair.new) {
            self.piece(pair.to, What::Carry { from: pair.from, bytes: new.bytes });
            self.references(pair);
            let fate = if pair.from == pair.to { Fate::Kept } else { Fate::Moved };
            if pair.told {
                self.tell(
                    true,
                    pair.name.to_string(),
                    new_image.type_name(pair.new).to_string(),
                    fate,
                );
            }
            return;
        }
        match (old.kind, new.kind) {
            (
                TypeKind::Array { element: a, lower: old_low, upper: old_up },
                TypeKind::Array { element: b, lower, upper },
            ) => {
                let (old, new) = ((a, old_low, old_up), (b, lower, upper));
                self.elements(pair, old, new);
            }
            (TypeKind::Structure, TypeKind::Structure)
            | (TypeKind::FunctionBlock, TypeKind::FunctionBlock)
                if same_name(old.name, new.name) =>
            {
                self.fields(pair, &old, &new);
            }
            (TypeKind::String { length: a }, TypeKind::String { length: b })
            | (TypeKind::WString { length: a }, TypeKind::WString { length: b })
                if a <= b && old.bytes <= new.bytes =>
            {
                self.piece(pair.to, What::Carry { from: pair.from, bytes: old.bytes });
                let rest = new.bytes - old.bytes;
                if rest > 0 {
                    self.piece(pair.to + old.bytes, What::Initial { bytes: rest });
                }
                self.told_converted(pair);
            }
            _ => self.value(pair, &old, &new),
        }
    }

    fn told_converted(&mut self, pair: Pair<'_>) {
        if pair.told {
            let from = self.likeness.old.type_name(pair.old).to_string();
            let ty = self.likeness.new.type_name(pair.new).to_string();
            self.tell(true, pair.name.to_string(), ty, Fate::Converted { from });
        }
    }

    /// One value to another type.
    fn value(&mut self, pair: Pair<'_>, old: &Type<'a>, new: &Type<'a>) {
        let bases = base(old).zip(base(new));
        let fits = self.likeness.takes_values(old, new);
        match bases.filter(|_| fits) {
            Some((a, b)) if alike(a, b) => {
                self.piece(pair.to, What::Carry { from: pair.from, bytes: new.bytes });
                self.told_converted(pair);
            }
            Some((a, b)) if Conversion::between(a, b).is_some() => {
                if let Some(conversion) = Conversion::between(a, b) {
                    self.piece(pair.to, What::Convert { from: pair.from, count: 1, conversion });
                }
                self.told_converted(pair);
            }
            _ => {
                self.carried.drops = true;
                let from = self.likeness.old.type_name(pair.old).to_string();
                self.begin(pair.name, pair.new, pair.to, Fate::Anew { from }, pair.told);
            }
        }
    }

    fn fields(&mut self, pair: Pair<'_>, old: &Type<'a>, new: &Type<'a>) {
        let (old_image, new_image) = (self.likeness.old, self.likeness.new);
        let known: HashMap<String, _> =
            old_image.fields(old).map(|f| (f.name.to_ascii_lowercase(), f)).collect();
        let mut taken = HashSet::new();
        for field in new_image.fields(new) {
            let name =
                if pair.told { format!("{}.{}", pair.name, field.name) } else { String::new() };
            let to = pair.to + field.offset;
            match known.get(&field.name.to_ascii_lowercase()) {
                None => self.begin(&name, field.ty, to, Fate::New, pair.told),
                Some(there) => {
                    taken.insert(there.offset);
                    let (old, from) = (there.ty, pair.from + there.offset);
                    self.pair(Pair { name: &name, old, new: field.ty, from, to, ..pair });
                }
            }
        }
        for field in old_image.fields(old).filter(|field| !taken.contains(&field.offset)) {
            self.carried.drops = true;
            if pair.told {
                self.drop(format!("{}.{}", pair.name, field.name), field.ty);
            }
        }
    }

    fn elements(&mut self, pair: Pair<'_>, old: (TypeId, i64, i64), new: (TypeId, i64, i64)) {
        let ((a, old_low, old_up), (b, new_low, new_up)) = (old, new);
        let alike = self.likeness.same(a, b) || self.reverse.same(b, a);
        let is_value = self.likeness.old.type_of(a).is_some_and(|ty| base(&ty).is_some());
        // A value of another type is converted or begins anew, and a reference to it becomes NULL.
        let follows = (new_low..=new_up).contains(&old_low) && (alike || !is_value);
        if follows && (!alike || old_up > new_up) {
            self.targets.breaks(pair.old, pair.name);
        }
        let bytes = |image: &Image<'_>, id| image.type_of(id).map_or(0, |ty| ty.bytes);
        let (old_size, new_size) = (bytes(&self.likeness.old, a), bytes(&self.likeness.new, b));
        // Within a state, so within a u32.
        let from = |index: i64| pair.from + (index - old_low) as u32 * old_size;
        let to = |index: i64| pair.to + (index - new_low) as u32 * new_size;
        let (low, up) = (old_low.max(new_low), old_up.min(new_up));
        let range = |low: i64, up: i64| {
            if low == up {
                format!("{}[{low}]", pair.name)
            } else {
                format!("{}[{low}..{up}]", pair.name)
            }
        };
        if low <= up {
            let name = range(low, up);
            if self.likeness.same(a, b) {
                let count = (up - low + 1) as u32;
                self.piece(to(low), What::Carry { from: from(low), bytes: count * new_size });
                let fate = if from(low) == to(low) { Fate::Kept } else { Fate::Moved };
                if pair.told {
                    self.tell(true, name, self.likeness.new.type_name(b).to_string(), fate);
                }
                for index in low..=up {
                    let (from, to) = (from(index), to(index));
                    if !self.likeness.has_reference(true, b) || !self.look() {
                        break;
                    }
                    self.references(Pair { old: a, new: b, from, to, ..pair });
                }
            } else {
                for index in low..=up {
                    let told = pair.told && index == low;
                    let (from, to) = (from(index), to(index));
                    self.pair(Pair { name: &name, old: a, new: b, from, to, told });
                    if self.carried.too_many {
                        break;
                    }
                }
            }
        }
        for (first, last) in outside(new_low, new_up, low, up) {
            let bytes = (last - first + 1) as u32 * new_size;
            self.piece(to(first), What::Initial { bytes });
            let ty = self.likeness.new.type_name(b).to_string();
            self.tell(pair.told, range(first, last), ty, Fate::New);
        }
        for (first, last) in outside(old_low, old_up, low, up) {
            self.carried.drops = true;
            if pair.told {
                self.drop(range(first, last), a);
            }
        }
    }

    /// Collects the references in a part that is carried as it is.
    fn references(&mut self, pair: Pair<'_>) {
        if !self.likeness.has_reference(true, pair.new) || !self.look() {
            return;
        }
        let (old_image, new_image) = (self.likeness.old, self.likeness.new);
        let types = (old_image.type_of(pair.old), new_image.type_of(pair.new));
        let (Some(old), Some(new)) = types else { return };
        match (old.kind, new.kind) {
            (TypeKind::Reference { target: a }, TypeKind::Reference { target: b }) => {
                // A reference to its own type stands for one whose target the image does not tell.
                let told = a != pair.old && b != pair.new;
                // What came there by a reference has to get back by it, or it would lead to the place that its target has there.
                let alike = self.likeness.same(a, b) || (self.is_back && self.reverse.same(b, a));
                if told && alike {
                    self.carried.references.push((pair.from, pair.to));
                    self.targets.refer_to(a);
                } else {
                    self.carried.refusals.push(Refusal::Reference { name: pair.name.to_string() });
                }
            }
            (TypeKind::Array { element: a, lower, upper }, TypeKind::Array { element: b, .. }) => {
                let size = new_image.type_of(b).map_or(0, |ty| ty.bytes);
                for index in 0..=(upper - lower) {
                    let offset = index as u32 * size;
                    let (from, to) = (pair.from + offset, pair.to + offset);
                    self.references(Pair { old: a, new: b, from, to, ..pair });
                    if self.carried.too_many {
                        break;
                    }
                }
            }
            _ => {
                let (a, b) = (old_image.fields(&old), new_image.fields(&new));
                for (a, b) in a.zip(b) {
                    let (from, to) = (pair.from + a.offset, pair.to + b.offset);
                    self.references(Pair { old: a.ty, new: b.ty, from, to, ..pair });
                }
            }
        }
    }

    /// Variables that share bytes are carried twice, so they must both stay.
    fn check_shared(&mut self, image: &Image<'_>, kept: &HashSet<String>) {
        let keeps = |name: &str| kept.contains(&name.to_ascii_lowercase());
        for (one, other) in shared(image) {
            if !keeps(&one) || !keeps(&other) {
                self.carried.refusals.push(Refusal::Shared { one, other });
            }
        }
    }
}

/// The parts of `from..=to` that are not in `low..=up`, which may be empty.
fn outside(from: i64, to: i64, low: i64, up: i64) -> impl Iterator<Item = (i64, i64)> {
    let parts = if low > up {
        [Some((from, to)), None]
    } else {
        [low.checked_sub(1).map(|last| (from, last)), up.checked_add(1).map(|first| (first, to))]
    };
    parts.into_iter().flatten().filter(|(first, last)| first <= last)
}
