//! Program organisation units.

use crate::body;
use crate::element::Element;
use crate::error::Defect;
use crate::type_spec::type_spec;
use crate::variables::{documentation, section};

/// A `<pou>` as its name and the text of its file.
pub fn unit(pou: Element<'_>) -> Result<(String, String), Defect> {
    let name = pou.name()?;
    let keyword = match pou.required_attribute("pouType")? {
        "program" => "PROGRAM",
        "functionBlock" => "FUNCTION_BLOCK",
        "function" => "FUNCTION",
        other => return Err(pou.value(other, "kind of unit: program, functionBlock or function")),
    };
    let mut text = format!("{}{keyword} {name}", documentation(pou, 0));
    let mut sections = String::new();
    for child in pou.child("interface").iter().flat_map(Element::children) {
        if child.tag() == "returnType" {
            text.push_str(&format!(" : {}", type_spec(child.inner("a type")?, 1)?));
        } else {
            sections.push_str(&section(child)?);
        }
    }
    let body = body::statements(pou)?;
    Ok((name.to_owned(), format!("{text}\n{sections}{body}END_{keyword}\n")))
}

/// What of a unit is refused although the unit itself is imported.
pub fn left_out(pou: Element<'_>) -> impl Iterator<Item = Element<'_>> {
    let parts = ["actions", "transitions"].into_iter().filter_map(move |part| pou.child(part));
    parts.flat_map(|part| part.children())
}
