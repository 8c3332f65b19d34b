//! Which types can be connected: that of the output that a value comes from, and that of the input that takes it.
//!
//! Bytes are copied and never converted. So a REAL that is read as a DINT is a wrong number, and nothing would notice it
//! while the system runs: 1.0 becomes 1,065,353,216. Here both types are known, and the line can be shown.
//!
//! Bit strings (BYTE, WORD, DWORD, LWORD) are connected to every type: they say nothing of what their bits mean, and programs
//! take bits out of them, or make a number of them, in so many words. An address at which the program declares no
//! point is such a bit string. All else needs the same type, part by part in arrays and structures. Signed and unsigned integers are not
//! the same: -1 would be 65,535.

use std::rc::Rc;

use takt_program::{Elementary, Image, TypeId, TypeKind};

use super::point::Point;
use super::writers::{Bits, meet};

/// A part of a point that has no parts itself.
#[derive(Clone, Debug)]
pub struct Part {
    pub bits: Bits,
    kind: Kind,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Kind {
    /// An elementary type or a subrange of one.
    Elementary(Elementary),
    /// Its base, and its values by number.
    Enumeration(Elementary, Rc<[(i64, String)]>),
    /// Most characters of a STRING, or of a WSTRING.
    Text { length: u32, wide: bool },
    /// An address in the memory of one program.
    Reference,
}

impl Part {
    fn is_bits(&self) -> bool {
        matches!(self.kind, Kind::Elementary(ty) if is_bit_string(ty))
    }

    /// Of what an output must be for an input that is this.
    pub fn allowed(&self) -> String {
        let bytes = (self.bits.1 - self.bits.0).div_ceil(8);
        let raw = match bytes {
            1 => ", or BYTE for the bits alone",
            2 => ", or WORD for the bits alone",
            4 => ", or DWORD for the bits alone",
            8 => ", or LWORD for the bits alone",
            _ => "",
        };
        match &self.kind {
            Kind::Elementary(ty) if is_bit_string(*ty) => format!("any type of {bytes} bytes"),
            Kind::Elementary(Elementary::Bool) => "type BOOL".to_owned(),
            Kind::Elementary(ty) => {
                let same = Elementary::ALL.iter().filter(|other| meaning(**other) == meaning(*ty));
                let same: Vec<&str> = same.map(|ty| ty.keyword()).collect();
                format!("type {}{raw}", same.join(" or "))
            }
            Kind::Enumeration(base, _) => {
                format!("type {}{raw}, or an enumeration of the same values", base.keyword())
            }
            Kind::Text { length, wide: false } => format!("type STRING[{length}]"),
            Kind::Text { length, wide: true } => format!("type WSTRING[{length}]"),
            Kind::Reference => "a type whose values mean something in another program".to_owned(),
        }
    }
}

/// The parts of a point that takes these bits, in their order.
pub fn parts(point: &Point, image: &Image<'_>, bits: Bits) -> Vec<Part> {
    let mut all = Vec::new();
    match (point.id, point.ty) {
        (Some(id), _) => collect(image, id, bits, &mut all),
        (None, Some(ty)) => all.push(Part { bits, kind: Kind::Elementary(ty) }),
        (None, None) => {}
    }
    all
}

/// Types are nested to a limit, and each part has bytes of its own, so this ends.
fn collect(image: &Image<'_>, id: TypeId, bits: Bits, all: &mut Vec<Part>) {
    let Some(ty) = image.type_of(id) else { return };
    let kind = match ty.kind {
        TypeKind::Elementary(base) | TypeKind::Subrange { base, .. } => Kind::Elementary(base),
        TypeKind::Enumeration { base } => {
            let values = image.values(&ty).map(|value| (value.value, value.name.to_owned()));
            Kind::Enumeration(base, values.collect())
        }
        TypeKind::String { length } => Kind::Text { length, wide: false },
        TypeKind::WString { length } => Kind::Text { length, wide: true },
        TypeKind::Reference { .. } => Kind::Reference,
        TypeKind::Array { element, .. } => {
            let one = image.type_of(element).map_or(0, |ty| 8 * u64::from(ty.bytes));
            let mut model = Vec::new();
            collect(image, element, (0, one), &mut model);
            let starts = (bits.0..bits.1).step_by(one.max(1) as usize);
            let moved = starts.flat_map(|at| model.iter().map(move |part| part.moved(at)));
            all.extend(moved);
            return;
        }
        TypeKind::Structure | TypeKind::FunctionBlock => {
            for field in image.fields(&ty) {
                let first = bits.0 + 8 * u64::from(field.offset);
                let bytes = image.type_of(field.ty).map_or(0, |ty| u64::from(ty.bytes));
                collect(image, field.ty, (first, first + 8 * bytes), all);
            }
            return;
        }
    };
    all.push(Part { bits, kind });
}

impl Part {
    fn moved(&self, by: u64) -> Self {
        Self { bits: (self.bits.0 + by, self.bits.1 + by), kind: self.kind.clone() }
    }
}

/// The first part of the input that has bits of the output with another meaning, if there is one.
pub fn conflict<'a>(output: &[Part], input: &'a [Part]) -> Option<&'a Part> {
    let (mut from, mut to) = (output.iter().peekable(), input.iter().peekable());
    while let (Some(one), Some(other)) = (from.peek(), to.peek()) {
        if meet(one.bits, other.bits) && !go_together(one, other) {
            return Some(other);
        }
        // Both are in order, so what ends first meets nothing that follows.
        if one.bits.1 <= other.bits.1 {
            from.next()
        } else {
            to.next()
        };
    }
    None
}

fn go_together(output: &Part, input: &Part) -> bool {
    if output.is_bits() || input.is_bits() {
        return true;
    }
    let same_bits = output.bits == input.bits;
    match (&output.kind, &input.kind) {
        // One bit, or a byte that is 0 or 1.
        (Kind::Elementary(Elementary::Bool), Kind::Elementary(Elementary::Bool)) => {
            output.bits.0 == input.bits.0
        }
        (Kind::Elementary(one), Kind::Elementary(other)) => {
            same_bits && meaning(*one) == meaning(*other)
        }
        (Kind::Enumeration(base, _), Kind::Elementary(other))
        | (Kind::Elementary(other), Kind::Enumeration(base, _)) => same_bits && base == other,
        (Kind::Enumeration(base, from), Kind::Enumeration(other, to)) => {
            let known = |(value, name): &(i64, String)| {
                to.iter().any(|(v, n)| v == value && n.eq_ignore_ascii_case(name))
            };
            same_bits && base == other && (Rc::ptr_eq(from, to) || from.iter().all(known))
        }
        (one, other) => same_bits && one == other && *one != Kind::Reference,
    }
}

const fn is_bit_string(ty: Elementary) -> bool {
    matches!(ty, Elementary::Byte | Elementary::Word | Elementary::Dword | Elementary::Lword)
}

/// The long types of times and dates have the same values as the short ones.
const fn meaning(ty: Elementary) -> Elementary {
    match ty {
        Elementary::Ltime => Elementary::Time,
        Elementary::Ldate => Elementary::Date,
        Elementary::Ltod => Elementary::Tod,
        Elementary::Ldt => Elementary::Dt,
        other => other,
    }
}
