//! Layouts: the bytes of a message as named values of the types of IEC 61131-3.
//!
//! A controller and a script have to mean the same bytes. The layout says which, in the words of the
//! controller's language: types of table 10 of the standard, little-endian, one behind the other
//! without gaps.

use std::fs;

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value as Json;
use takt_port::channel::MESSAGE_MAX;

/// A type of IEC 61131-3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Type {
    Bool,
    /// Bit strings and unsigned numbers of so many bytes.
    Unsigned(usize),
    /// Signed numbers of so many bytes.
    Signed(usize),
    Real,
    Lreal,
}

const TYPES: [(&str, Type); 15] = [
    ("bool", Type::Bool),
    ("byte", Type::Unsigned(1)),
    ("word", Type::Unsigned(2)),
    ("dword", Type::Unsigned(4)),
    ("lword", Type::Unsigned(8)),
    ("sint", Type::Signed(1)),
    ("int", Type::Signed(2)),
    ("dint", Type::Signed(4)),
    ("lint", Type::Signed(8)),
    ("usint", Type::Unsigned(1)),
    ("uint", Type::Unsigned(2)),
    ("udint", Type::Unsigned(4)),
    ("ulint", Type::Unsigned(8)),
    ("real", Type::Real),
    ("lreal", Type::Lreal),
];

impl Type {
    fn bytes(self) -> usize {
        match self {
            Self::Bool => 1,
            Self::Unsigned(bytes) | Self::Signed(bytes) => bytes,
            Self::Real => 4,
            Self::Lreal => 8,
        }
    }

    /// A value of this type from its bytes, of which there are enough.
    fn decode(self, bytes: &[u8]) -> Value {
        let mut word = [0; 8];
        word.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        let word = u64::from_le_bytes(word);
        match self {
            Self::Bool => Value::Bool(word != 0),
            Self::Unsigned(_) => Value::Unsigned(word),
            Self::Signed(bytes) => {
                let unused = 64 - 8 * bytes as u32;
                Value::Signed((word << unused).cast_signed() >> unused)
            }
            Self::Real => Value::Real(f32::from_bits(word as u32)),
            Self::Lreal => Value::Lreal(f64::from_bits(word)),
        }
    }

    /// The word whose low bytes are a value that is written like this.
    fn encode(self, text: &str) -> Option<u64> {
        match self {
            Self::Bool => match text {
                "true" | "1" => Some(1),
                "false" | "0" => Some(0),
                _ => None,
            },
            Self::Unsigned(bytes) => {
                let value: u64 = text.parse().ok()?;
                (bytes == 8 || value >> (8 * bytes) == 0).then_some(value)
            }
            Self::Signed(bytes) => {
                let value: i64 = text.parse().ok()?;
                let unused = 64 - 8 * bytes as u32;
                (value << unused >> unused == value).then_some(value.cast_unsigned())
            }
            Self::Real => {
                let value = text.parse::<f32>().ok()?;
                (!value.is_infinite() || is_infinity(text)).then(|| u64::from(value.to_bits()))
            }
            Self::Lreal => {
                let value = text.parse::<f64>().ok()?;
                (!value.is_infinite() || is_infinity(text)).then(|| value.to_bits())
            }
        }
    }
}

/// A number that is too large for its type reads as infinite too.
fn is_infinity(number: &str) -> bool {
    !number.bytes().any(|byte| byte.is_ascii_digit())
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Value {
    Bool(bool),
    Unsigned(u64),
    Signed(i64),
    Real(f32),
    Lreal(f64),
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bool(value) => value.fmt(f),
            Self::Unsigned(value) => value.fmt(f),
            Self::Signed(value) => value.fmt(f),
            Self::Real(value) => value.fmt(f),
            Self::Lreal(value) => value.fmt(f),
        }
    }
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match *self {
            Self::Bool(value) => serializer.serialize_bool(value),
            Self::Unsigned(value) => serializer.serialize_u64(value),
            Self::Signed(value) => serializer.serialize_i64(value),
            Self::Real(value) if value.is_finite() => serializer.serialize_f32(value),
            Self::Lreal(value) if value.is_finite() => serializer.serialize_f64(value),
            // JSON has no numbers for these; as text they can be read back.
            Self::Real(_) | Self::Lreal(_) => serializer.collect_str(self),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Field {
    name: String,
    kind: Type,
    /// Its number of values; `None` is one that is no array.
    array: Option<usize>,
}

impl Field {
    fn bytes(&self) -> usize {
        self.kind.bytes() * self.array.unwrap_or(1)
    }
}

/// What a message consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    fields: Vec<Field>,
}

impl Layout {
    /// A layout, or `@` and the name of a file with one.
    pub fn from_argument(argument: &str) -> Result<Layout, String> {
        match argument.strip_prefix('@') {
            None => Self::parse(argument),
            Some(path) => {
                let text = fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
                Self::parse(&text)
            }
        }
    }

    fn parse(text: &str) -> Result<Layout, String> {
        let mut fields: Vec<Field> = Vec::new();
        for part in text.split([',', '\n']).map(str::trim).filter(|part| !part.is_empty()) {
            let field = field(part)?;
            if fields.iter().any(|other| other.name == field.name) {
                return Err(format!("{} is there twice", field.name));
            }
            fields.push(field);
        }
        let layout = Layout { fields };
        match layout.bytes() {
            0 => Err("a layout has at least one value, such as level:lreal".to_owned()),
            bytes if bytes > MESSAGE_MAX as usize => {
                Err(format!("a layout of {bytes} bytes: no message is longer than {MESSAGE_MAX}"))
            }
            _ => Ok(layout),
        }
    }

    fn bytes(&self) -> usize {
        self.fields.iter().map(Field::bytes).sum()
    }

    /// The values of a message.
    pub fn decode<'a>(&'a self, bytes: &'a [u8]) -> Result<Values<'a>, String> {
        if bytes.len() == self.bytes() {
            return Ok(Values { layout: self, bytes });
        }
        Err(format!("the message has {} bytes, the layout {}", bytes.len(), self.bytes()))
    }

    /// A message from a line such as `level=1.25 n=1,2,3,4`, in any order.
    pub fn encode_text(&self, line: &str) -> Result<Vec<u8>, String> {
        let mut given: Vec<(&str, &str)> = Vec::new();
        for word in line.split_whitespace() {
            let pair = word.split_once('=');
            given.push(pair.ok_or_else(|| format!("{word} is not of the form name=value"))?);
        }
        self.check_names(given.iter().map(|(name, _)| *name))?;
        self.encode(|field| {
            let values = given.iter().find(|(name, _)| *name == field.name).map(|(_, v)| *v);
            values.map(|values| match field.array {
                Some(_) => values.split(',').map(str::to_owned).collect(),
                None => vec![values.to_owned()],
            })
        })
    }

    /// A message from a JSON object with the names of the fields.
    pub fn encode_json(&self, json: &Json) -> Result<Vec<u8>, String> {
        let object = json.as_object().ok_or("fields is not an object")?;
        self.check_names(object.keys().map(String::as_str))?;
        self.encode(|field| {
            let text = |value: &Json| match value {
                Json::String(text) => text.clone(),
                other => other.to_string(),
            };
            object.get(&field.name).map(|value| match (value, field.array) {
                (Json::Array(values), Some(_)) => values.iter().map(text).collect(),
                (value, _) => vec![text(value)],
            })
        })
    }

    fn check_names<'a>(&self, mut names: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let unknown = names.find(|name| !self.fields.iter().any(|field| field.name == *name));
        unknown.map_or(Ok(()), |name| Err(format!("the layout has no {name}")))
    }

    fn encode(&self, values: impl Fn(&Field) -> Option<Vec<String>>) -> Result<Vec<u8>, String> {
        let mut bytes = Vec::with_capacity(self.bytes());
        for field in &self.fields {
            let name = &field.name;
            let values = values(field).ok_or_else(|| format!("{name} is missing"))?;
            let expected = field.array.unwrap_or(1);
            if values.len() != expected {
                return Err(format!("{name} has {} values, the layout {expected}", values.len()));
            }
            for value in values {
                let word = field.kind.encode(&value);
                let word = word.ok_or_else(|| {
                    format!("{name}: {value} is not a value of {}", type_names(field.kind))
                })?;
                bytes.extend_from_slice(&word.to_le_bytes()[..field.kind.bytes()]);
            }
        }
        Ok(bytes)
    }
}

/// A message and what it consists of; as long as each other.
#[derive(Debug)]
pub struct Values<'a> {
    layout: &'a Layout,
    bytes: &'a [u8],
}

impl Values<'_> {
    fn fields(&self) -> impl Iterator<Item = (&Field, Vec<Value>)> {
        let mut rest = self.bytes;
        self.layout.fields.iter().map(move |field| {
            let (bytes, others) = rest.split_at(field.bytes());
            rest = others;
            let values = bytes.chunks(field.kind.bytes()).map(|bytes| field.kind.decode(bytes));
            (field, values.collect())
        })
    }
}

impl std::fmt::Display for Values<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (number, (field, values)) in self.fields().enumerate() {
            let values: Vec<String> = values.iter().map(Value::to_string).collect();
            let space = if number == 0 { "" } else { " " };
            write!(f, "{space}{}={}", field.name, values.join(","))?;
        }
        Ok(())
    }
}

impl Serialize for Values<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.layout.fields.len()))?;
        for (field, values) in self.fields() {
            match (field.array, &values[..]) {
                (None, [value]) => map.serialize_entry(&field.name, value)?,
                _ => map.serialize_entry(&field.name, &values)?,
            }
        }
        map.end()
    }
}

fn field(part: &str) -> Result<Field, String> {
    let wrong = |what: &str| format!("{part}: {what}");
    let (name, kind) =
        part.split_once(':').ok_or_else(|| wrong("a value is name:type or name:type[n]"))?;
    let (name, kind) = (name.trim(), kind.trim());
    if name.is_empty() || name.contains(|c: char| c.is_whitespace() || c == '=') {
        return Err(wrong("a name is one word without ="));
    }
    let (kind, array) = match kind.split_once('[') {
        None => (kind, None),
        Some((kind, length)) => {
            let length = length.strip_suffix(']').and_then(|n| n.trim().parse::<usize>().ok());
            let length = length.filter(|n| (1..=MESSAGE_MAX as usize).contains(n));
            let length =
                length.ok_or_else(|| wrong(&format!("an array has [1] to [{MESSAGE_MAX}]")))?;
            (kind.trim(), Some(length))
        }
    };
    let found = TYPES.iter().find(|(known, _)| kind.eq_ignore_ascii_case(known));
    let (_, kind) = found.ok_or_else(|| {
        let known = TYPES.map(|(name, _)| name).join(", ");
        wrong(&format!("there is no type {kind}; allowed are {known}"))
    })?;
    Ok(Field { name: name.to_owned(), kind: *kind, array })
}

fn type_names(kind: Type) -> String {
    let names: Vec<&str> =
        TYPES.iter().filter(|(_, known)| *known == kind).map(|(name, _)| *name).collect();
    names.join(" or ")
}

#[cfg(test)]
#[path = "layout_tests.rs"]
mod tests;
