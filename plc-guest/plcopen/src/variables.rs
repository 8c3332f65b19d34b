//! Sections of variables: `<inputVars>` and the like.

use crate::element::Element;
use crate::error::Defect;
use crate::type_spec::type_spec;
use crate::value::initial_value;

/// A section with its keyword, or nothing if it has no variables.
pub fn section(vars: Element<'_>) -> Result<String, Defect> {
    let keyword = match vars.tag() {
        "localVars" => "VAR",
        "tempVars" => "VAR_TEMP",
        "inputVars" => "VAR_INPUT",
        "outputVars" => "VAR_OUTPUT",
        "inOutVars" => "VAR_IN_OUT",
        "externalVars" => "VAR_EXTERNAL",
        "globalVars" => "VAR_GLOBAL",
        _ => return Err(vars.not_supported()),
    };
    let mut text = String::new();
    for variable in vars.children() {
        if variable.tag() != "variable" {
            return Err(variable.not_supported());
        }
        text.push_str(&self::variable(variable)?);
    }
    if text.is_empty() {
        return Ok(text);
    }
    let mut words = vec![keyword];
    for (attribute, word) in [
        ("constant", "CONSTANT"),
        ("retain", "RETAIN"),
        ("nonretain", "NON_RETAIN"),
        ("persistent", "PERSISTENT"),
    ] {
        if vars.flag(attribute) {
            words.push(word);
        }
    }
    Ok(format!("{}\n{text}END_VAR\n", words.join(" ")))
}

fn variable(variable: Element<'_>) -> Result<String, Defect> {
    let name = variable.name()?;
    let address = match variable.attribute("address") {
        Some(address) => format!(" AT {}", direct_address(variable, address.trim())?),
        None => String::new(),
    };
    let spec = type_spec(variable.required("type")?.inner("a type")?, 1)?;
    let initial = initial_value(variable)?;
    Ok(format!("{}    {name}{address} : {spec}{initial};\n", documentation(variable, 1)))
}

fn direct_address<'a>(variable: Element<'_>, address: &'a str) -> Result<&'a str, Defect> {
    let rest = address.strip_prefix('%').unwrap_or_default();
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '*');
    if !rest.is_empty() && rest.chars().all(plain) {
        Ok(address)
    } else {
        Err(variable.value(address, "address such as %IX0.0"))
    }
}

/// The documentation of an element as comments, a line each.
pub fn documentation(of: Element<'_>, depth: u32) -> String {
    let indent = "    ".repeat(depth as usize);
    let text = of.documentation();
    let lines = text.split(['\n', '\r']).map(str::trim).filter(|line| !line.is_empty());
    lines.map(|line| format!("{indent}// {line}\n")).collect()
}
