//! Configurations: resources, tasks and program instances.

use crate::element::Element;
use crate::error::Defect;
use crate::variables::section;

/// A `<configuration>` as its name and the text of its file.
pub fn configuration(configuration: Element<'_>) -> Result<(String, String), Defect> {
    let name = configuration.name()?;
    let mut text = format!("CONFIGURATION {name}\n");
    for globals in named(configuration, "globalVars") {
        text.push_str(&section(globals)?);
    }
    for child in configuration.children() {
        match child.tag() {
            "globalVars" => {}
            "resource" => text.push_str(&resource(child)?),
            _ => return Err(child.not_supported()),
        }
    }
    text.push_str("END_CONFIGURATION\n");
    Ok((name.to_owned(), text))
}

fn named<'a>(of: Element<'a>, tag: &'static str) -> impl Iterator<Item = Element<'a>> {
    of.children().filter(move |child| child.tag() == tag)
}

fn resource(resource: Element<'_>) -> Result<String, Defect> {
    let name = resource.name()?;
    let mut text = format!("RESOURCE {name} ON PLC\n");
    for globals in named(resource, "globalVars") {
        text.push_str(&section(globals)?);
    }
    // A task is declared before the programs that it runs.
    let mut instances = String::new();
    for child in resource.children() {
        match child.tag() {
            "globalVars" => {}
            "task" => {
                let task = child.name()?;
                text.push_str(&format!("    TASK {task} ({});\n", properties(child)?));
                for program in child.children() {
                    instances.push_str(&instance(program, &format!(" WITH {task}"))?);
                }
            }
            "pouInstance" => instances.push_str(&instance(child, "")?),
            _ => return Err(child.not_supported()),
        }
    }
    Ok(format!("{text}{instances}END_RESOURCE\n"))
}

fn properties(task: Element<'_>) -> Result<String, Defect> {
    let mut all = Vec::new();
    if let Some(interval) = task.attribute("interval") {
        all.push(format!("INTERVAL := {}", duration(task, interval.trim())?));
    }
    if task.attribute("single").is_some() {
        all.push(format!("SINGLE := {}", task.name_in("single")?));
    }
    all.push(format!("PRIORITY := {}", task.integer("priority")?));
    Ok(all.join(", "))
}

/// The format has literals of the language here, and some tools the durations of XML (`PT0.02S`).
fn duration(task: Element<'_>, text: &str) -> Result<String, Defect> {
    let literal = text.split_once('#').filter(|(prefix, rest)| {
        let prefix = prefix.to_ascii_uppercase();
        matches!(&*prefix, "T" | "TIME" | "LT" | "LTIME") && is_amount(rest)
    });
    let seconds = text.strip_prefix("PT").and_then(|rest| rest.strip_suffix('S'));
    match (literal, seconds) {
        (Some(_), _) => Ok(text.to_owned()),
        (None, Some(seconds)) if is_amount(seconds) && !seconds.contains(char::is_alphabetic) => {
            Ok(format!("T#{seconds}s"))
        }
        _ => Err(task.value(text, "duration such as T#10ms or PT0.01S")),
    }
}

fn is_amount(text: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_');
    text.starts_with(|c: char| c.is_ascii_digit()) && text.chars().all(allowed)
}

fn instance(program: Element<'_>, with: &str) -> Result<String, Defect> {
    if program.tag() != "pouInstance" {
        return Err(program.not_supported());
    }
    let (name, kind) = (program.name()?, program.name_in("typeName")?);
    Ok(format!("    PROGRAM {name}{with} : {kind};\n"))
}
