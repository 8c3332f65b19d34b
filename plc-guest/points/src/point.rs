//! The points of a program: each value that can be looked at by itself, by name.
//!
//! Arrays, structures and instances of function blocks open up to their parts: `row[2].level`. What an image says has
//! been checked, but it may describe millions of values, so each search has an end.

use takt_program::{Area, Elementary, Flags, Image, TypeId, TypeKind};
use takt_protocol as protocol;

use crate::Value;
use crate::value::digits;

/// Most points of one search.
pub const POINTS_MAX: usize = 10_000;
/// Longest text that is shown of a `STRING`, in characters.
const TEXT_MAX: u32 = 255;

/// One value of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Point {
    /// `PROGRAM.VARIABLE` with the path of a part.
    pub name: String,
    /// Its type, as declared.
    pub type_name: String,
    /// Where it lies.
    pub range: protocol::Range,
    /// Its bit, if it is one.
    pub bit: Option<u8>,
    /// What its bytes mean.
    pub kind: Kind,
    /// What is said of the variable that it is or is a part of.
    pub flags: Flags,
}

/// What the bytes of a point mean.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A value of this type.
    Elementary(Elementary),
    /// One of this type, between two numbers.
    Subrange(Elementary, i64, i64),
    /// One of these names, each with its number.
    Enumeration(Elementary, Vec<(String, i64)>),
    /// A `STRING`.
    Text,
    /// A `WSTRING`.
    WideText,
    /// An address.
    Reference,
}

/// Why a search failed.
#[derive(Debug, thiserror::Error)]
#[error("more than {POINTS_MAX} values have such a name; say more of it")]
pub struct TooMany;

/// A search through the points of one program.
pub struct Search<'a> {
    image: &'a Image<'a>,
    /// Its place in the partition.
    place: u8,
    pattern: &'a str,
    /// Of the variable that is looked at.
    flags: Flags,
    found: Vec<Point>,
}

impl<'a> Search<'a> {
    /// Adds the points of a program whose names match: the name of a variable, or of a part of one, means all of its
    /// parts; `*` is any text.
    ///
    /// # Errors
    /// If there are too many.
    pub fn run(
        program: &str,
        place: u8,
        image: &'a Image<'a>,
        pattern: &'a str,
    ) -> Result<Vec<Point>, TooMany> {
        let mut search = Self { image, place, pattern, flags: Flags::NONE, found: Vec::new() };
        for variable in image.variables().filter(|variable| !variable.is_part()) {
            let Some(area) = area(variable.area) else { continue };
            let name = format!("{program}.{}", variable.name);
            if !may_match(pattern, &name) {
                continue;
            }
            search.flags = variable.flags;
            search.open(name, variable.ty, area, variable.offset, variable.bit)?;
        }
        Ok(search.found)
    }

    fn open(
        &mut self,
        name: String,
        ty: TypeId,
        area: protocol::Area,
        offset: u32,
        bit: Option<u8>,
    ) -> Result<(), TooMany> {
        let Some(ty) = self.image.type_of(ty) else { return Ok(()) };
        let kind = match ty.kind {
            TypeKind::Array { element, lower, upper } => {
                let bytes = self.image.type_of(element).map_or(0, |element| element.bytes);
                for (offset, index) in (offset..).step_by(bytes.max(1) as usize).zip(lower..=upper)
                {
                    let part = format!("{name}[{index}]");
                    if may_match(self.pattern, &part) {
                        self.open(part, element, area, offset, None)?;
                    }
                }
                return Ok(());
            }
            TypeKind::Structure | TypeKind::FunctionBlock => {
                for field in self.image.fields(&ty) {
                    let part = format!("{name}.{}", field.name);
                    if may_match(self.pattern, &part) {
                        self.open(part, field.ty, area, offset + field.offset, None)?;
                    }
                }
                return Ok(());
            }
            TypeKind::Elementary(elementary) => Kind::Elementary(elementary),
            TypeKind::Subrange { base, low, high } => Kind::Subrange(base, low, high),
            TypeKind::Enumeration { base } => {
                let values = self.image.values(&ty).map(|v| (v.name.to_owned(), v.value));
                Kind::Enumeration(base, values.collect())
            }
            TypeKind::String { .. } => Kind::Text,
            TypeKind::WString { .. } => Kind::WideText,
            TypeKind::Reference { .. } => Kind::Reference,
        };
        if !matches(self.pattern, &name) {
            return Ok(());
        }
        if self.found.len() >= POINTS_MAX {
            return Err(TooMany);
        }
        let most = match kind {
            Kind::Text => TEXT_MAX,
            Kind::WideText => 2 * TEXT_MAX,
            _ => 8,
        };
        let bytes = ty.bytes.min(most) as u16;
        let range = protocol::Range { program: self.place, area, offset, bytes };
        let type_name = match kind {
            _ if !ty.name.is_empty() => ty.name.to_owned(),
            Kind::Elementary(elementary)
            | Kind::Subrange(elementary, ..)
            | Kind::Enumeration(elementary, _) => elementary.keyword().to_owned(),
            Kind::Text => "STRING".to_owned(),
            Kind::WideText => "WSTRING".to_owned(),
            Kind::Reference => "REF_TO".to_owned(),
        };
        self.found.push(Point { name, type_name, range, bit, kind, flags: self.flags });
        Ok(())
    }
}

impl Point {
    /// Where it is, as IEC 61131-3 writes it; a dash for what has no address.
    #[must_use]
    pub fn address(&self) -> String {
        let area = match self.range.area {
            protocol::Area::State => return "-".to_owned(),
            protocol::Area::Input => 'I',
            protocol::Area::Output => 'Q',
            protocol::Area::Marker => 'M',
        };
        match self.bit {
            Some(bit) => format!("%{area}X{}.{bit}", self.range.offset),
            None => format!("%{area}B{}", self.range.offset),
        }
    }

    /// Whether the program lets an operator keep it at a value.
    #[must_use]
    pub fn is_forceable(&self) -> bool {
        self.flags.has(Flags::FORCEABLE)
    }

    /// Whether it has one value for good.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.flags.has(Flags::CONSTANT)
    }

    /// Its value in these bytes, as text.
    #[must_use]
    pub fn show(&self, bytes: &[u8]) -> String {
        match &self.kind {
            Kind::Elementary(elementary) | Kind::Subrange(elementary, ..) => {
                let value = Value::from_raw(*elementary, self.bit, raw(bytes));
                shown(*elementary, value)
            }
            Kind::Enumeration(base, names) => {
                let value = Value::from_raw(*base, None, raw(bytes));
                let named = names.iter().find(|(_, number)| value == number_of(*base, *number));
                named.map_or_else(|| value.to_string(), |(name, _)| name.clone())
            }
            Kind::Text => {
                let text: Vec<char> =
                    bytes.iter().take_while(|b| **b != 0).map(|b| char::from(*b)).collect();
                quoted('\'', text)
            }
            Kind::WideText => {
                let units = bytes.as_chunks::<2>().0.iter().map(|unit| u16::from_le_bytes(*unit));
                let units: Vec<u16> = units.take_while(|unit| *unit != 0).collect();
                quoted('"', char::decode_utf16(units).map(|c| c.unwrap_or('\u{fffd}')))
            }
            Kind::Reference => format!("16#{:X}", raw(bytes)),
        }
    }

    /// Its value in these bytes, to compare and to draw; none of a text or a reference.
    #[must_use]
    pub fn value(&self, bytes: &[u8]) -> Option<Value> {
        Some(Value::from_raw(self.base()?, self.bit, raw(bytes)))
    }

    /// Its elementary type; none of a text or a reference.
    #[must_use]
    pub fn base(&self) -> Option<Elementary> {
        match &self.kind {
            Kind::Elementary(base) | Kind::Subrange(base, ..) | Kind::Enumeration(base, _) => {
                Some(*base)
            }
            Kind::Text | Kind::WideText | Kind::Reference => None,
        }
    }
}

fn raw(bytes: &[u8]) -> u64 {
    let mut raw = [0; 8];
    raw.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    u64::from_le_bytes(raw)
}

/// A number of an enumeration or a subrange as a value.
#[must_use]
pub fn number_of(base: Elementary, number: i64) -> Value {
    Value::from_raw(base, None, number.cast_unsigned())
}

/// A value as it is shown and written.
#[must_use]
pub fn shown(elementary: Elementary, value: Value) -> String {
    use Elementary as E;
    match (elementary, value) {
        (_, Value::Bool(on)) => if on { "TRUE" } else { "FALSE" }.to_owned(),
        (E::Byte | E::Word | E::Dword | E::Lword, Value::Unsigned(bits)) => {
            format!("16#{bits:0width$X}", width = 2 * elementary.bytes() as usize)
        }
        // With as many digits as a REAL has, not those of an LREAL of the same value.
        (E::Real, Value::Float(number)) => digits(number as f32),
        (_, value) => value.to_string(),
    }
}

fn quoted(quote: char, text: impl IntoIterator<Item = char>) -> String {
    let text: String = text.into_iter().flat_map(char::escape_default).collect();
    format!("{quote}{text}{quote}")
}

fn area(area: Area) -> Option<protocol::Area> {
    Some(match area {
        Area::State => protocol::Area::State,
        Area::Input => protocol::Area::Input,
        Area::Output => protocol::Area::Output,
        Area::Marker => protocol::Area::Marker,
        Area::Constant => return None,
    })
}

/// Whether parts of what has this name can match.
fn may_match(pattern: &str, name: &str) -> bool {
    let fixed = pattern.split('*').next().unwrap_or_default();
    let common = fixed.len().min(name.len());
    let same = |a: &str, b: &str| {
        a.get(..common).zip(b.get(..common)).is_some_and(|(a, b)| a.eq_ignore_ascii_case(b))
    };
    same(fixed, name)
}

/// Whether a value of this name is meant.
#[must_use]
pub fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name) = (pattern.to_ascii_lowercase(), name.to_ascii_lowercase());
    if !pattern.contains('*') {
        let rest = name.strip_prefix(&pattern);
        return rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']));
    }
    let mut parts = pattern.split('*');
    let Some(mut rest) = parts.next().and_then(|first| name.strip_prefix(first)) else {
        return false;
    };
    let Some(last) = parts.next_back() else { return rest.is_empty() };
    for part in parts {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_program::CodeOffset;
    use takt_program::Nanoseconds;
    use takt_program::build::{Builder, Kind, Task, Type, Variable};

    /// `level : REAL; row : ARRAY [1..2] OF INT; on AT %QX3.5 : BOOL; step : (idle := 0, filling := 2)`.
    fn image() -> Vec<u8> {
        let mut image = Builder::new("tank");
        image.code = vec![0xc3];
        image.state_bytes = 16;
        image.output_bytes = 8;
        let values = vec![("idle".to_owned(), 0), ("filling".to_owned(), -2)];
        let step = Kind::Enumeration { base: Elementary::Sint, values };
        let step = image.ty(Type::new(1, step).named("STEP"));
        let share = Kind::Subrange { base: Elementary::Sint, low: -5, high: 100 };
        let share = image.ty(Type::new(1, share));
        image.task(Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0)));
        let real = image.elementary(Elementary::Real);
        let int = image.elementary(Elementary::Int);
        let bool = image.elementary(Elementary::Bool);
        let row = image.ty(Type::new(4, Kind::Array { element: int, lower: 1, upper: 2 }));
        image.variable(Variable::new("level", real, Area::State, 0));
        image.variable(Variable::new("row", row, Area::State, 4));
        image.variable(Variable::new("step", step, Area::State, 8));
        image.variable(Variable::new("share", share, Area::State, 9));
        image.variable(Variable { bit: Some(5), ..Variable::new("on", bool, Area::Output, 3) });
        image.build().unwrap()
    }

    fn search(pattern: &str) -> Vec<Point> {
        let bytes = image();
        let image = Image::parse(&bytes).unwrap();
        Search::run("tank", 1, &image, pattern).unwrap()
    }

    fn names(pattern: &str) -> Vec<String> {
        search(pattern).into_iter().map(|point| point.name).collect()
    }

    #[test]
    fn a_name_means_all_of_its_parts_and_no_other() {
        assert_eq!(names("tank.row"), ["tank.row[1]", "tank.row[2]"]);
        assert_eq!(names("TANK.Row[2]"), ["tank.row[2]"]);
        assert_eq!(names("tank.le"), [""; 0]);
        assert_eq!(names("*le*"), ["tank.level"]);
        assert_eq!(names("tank.*[1]"), ["tank.row[1]"]);
        assert_eq!(names("*").len(), 6);
        assert_eq!(search("tank.row[2]")[0].range.offset, 6);
    }

    #[test]
    fn a_value_is_shown_by_its_type() {
        let shown = |name: &str, bytes: &[u8]| search(name).remove(0).show(bytes);
        assert_eq!(shown("tank.level", &0.1_f32.to_le_bytes()), "0.1");
        assert_eq!(shown("tank.row[1]", &[0xfd, 0xff]), "-3");
        assert_eq!(shown("tank.step", &[0xfe]), "filling");
        assert_eq!(shown("tank.step", &[7]), "7");
        assert_eq!(shown("tank.on", &[0b0010_0000]), "TRUE");
        assert_eq!(shown("tank.on", &[0b1101_1111]), "FALSE");
        assert_eq!(search("tank.on")[0].address(), "%QX3.5");
    }
}
