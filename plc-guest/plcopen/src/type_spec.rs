//! Types: elements such as `<INT/>`, `<array>` and `<derived>` as they are written in Structured Text.

use crate::element::Element;
use crate::error::{Defect, DefectKind};
use crate::value::initial_value;
use crate::variables::documentation;

/// How deep types and values may be within each other.
pub const MAXIMUM_DEPTH: u32 = 32;

/// The elementary types, whose elements have their names.
const ELEMENTARY: &[&str] = &[
    "BOOL", "BYTE", "WORD", "DWORD", "LWORD", "SINT", "INT", "DINT", "LINT", "USINT", "UINT",
    "UDINT", "ULINT", "REAL", "LREAL", "TIME", "LTIME", "DATE", "LDATE", "TOD", "LTOD", "DT",
    "LDT", "CHAR", "WCHAR",
];

/// A `<dataType>` as a line of a TYPE block, or several for a structure.
pub fn declaration(data_type: Element<'_>) -> Result<String, Defect> {
    let name = data_type.name()?;
    let spec = data_type.required("baseType")?.inner("a type")?;
    let initial = initial_value(data_type)?;
    let text = type_spec(spec, 1)?;
    Ok(format!("{}    {name} : {text}{initial};\n", documentation(data_type, 1)))
}

/// A type as it is written after a colon, at `depth` levels of indentation.
pub fn type_spec(spec: Element<'_>, depth: u32) -> Result<String, Defect> {
    if depth > MAXIMUM_DEPTH {
        return Err(spec.defect(DefectKind::TooDeep { maximum: MAXIMUM_DEPTH }));
    }
    match spec.tag() {
        "string" => string(spec, "STRING"),
        "wstring" => string(spec, "WSTRING"),
        "derived" => Ok(spec.name()?.to_owned()),
        "array" => array(spec, depth),
        "subrangeSigned" | "subrangeUnsigned" => subrange(spec, depth),
        "enum" => enumeration(spec, depth),
        "struct" => structure(spec, depth),
        "pointer" => {
            let target = spec.required("baseType")?.inner("a type")?;
            Ok(format!("REF_TO {}", type_spec(target, depth + 1)?))
        }
        // Some exporters write these in lower case.
        tag => match ELEMENTARY.iter().find(|known| known.eq_ignore_ascii_case(tag)) {
            Some(known) => Ok((*known).to_owned()),
            None if matches!(tag, "date" | "tod" | "dt") => Ok(tag.to_ascii_uppercase()),
            None => Err(spec.not_supported()),
        },
    }
}

fn string(spec: Element<'_>, keyword: &str) -> Result<String, Defect> {
    match spec.attribute("length") {
        Some(_) => Ok(format!("{keyword}[{}]", spec.integer("length")?)),
        None => Ok(keyword.to_owned()),
    }
}

fn array(spec: Element<'_>, depth: u32) -> Result<String, Defect> {
    let mut bounds = Vec::new();
    for dimension in spec.children().filter(|child| child.tag() == "dimension") {
        bounds.push(format!("{}..{}", bound(dimension, "lower")?, bound(dimension, "upper")?));
    }
    let element = spec.required("baseType")?.inner("a type")?;
    if bounds.is_empty() {
        return Err(spec.value("", "array without a <dimension>"));
    }
    Ok(format!("ARRAY[{}] OF {}", bounds.join(", "), type_spec(element, depth + 1)?))
}

/// A bound of an array: a number, or the name of a constant.
fn bound<'a>(dimension: Element<'a>, attribute: &'static str) -> Result<&'a str, Defect> {
    match dimension.attribute(attribute) {
        Some(value) if crate::element::is_name(value.trim()) => Ok(value.trim()),
        _ => dimension.integer(attribute),
    }
}

fn subrange(spec: Element<'_>, depth: u32) -> Result<String, Defect> {
    let range = spec.required("range")?;
    let base = type_spec(spec.required("baseType")?.inner("a type")?, depth + 1)?;
    Ok(format!("{base} ({}..{})", range.integer("lower")?, range.integer("upper")?))
}

fn enumeration(spec: Element<'_>, depth: u32) -> Result<String, Defect> {
    let mut values = Vec::new();
    for value in spec.required("values")?.children() {
        let name = value.name()?;
        values.push(match value.attribute("value") {
            Some(_) => format!("{name} := {}", value.integer("value")?),
            None => name.to_owned(),
        });
    }
    let base = match spec.child("baseType") {
        Some(base) => format!("{} ", type_spec(base.inner("a type")?, depth + 1)?),
        None => String::new(),
    };
    Ok(format!("{base}({})", values.join(", ")))
}

fn structure(spec: Element<'_>, depth: u32) -> Result<String, Defect> {
    let indent = "    ".repeat(depth as usize);
    let mut text = String::from("STRUCT\n");
    for member in spec.children() {
        let name = member.name()?;
        let spec = type_spec(member.required("type")?.inner("a type")?, depth + 1)?;
        let initial = initial_value(member)?;
        text.push_str(&documentation(member, depth + 1));
        text.push_str(&format!("{indent}    {name} : {spec}{initial};\n"));
    }
    text.push_str(&format!("{indent}END_STRUCT"));
    Ok(text)
}
