//! Bodies of program organisation units.

use crate::element::Element;
use crate::error::{Defect, DefectKind};

/// The statements of the only body of a unit, ending with a line break.
pub fn statements(pou: Element<'_>) -> Result<String, Defect> {
    let Some(body) = pou.child("body") else {
        return Err(pou.defect(DefectKind::MissingBody));
    };
    // Each is a sheet of its own, and which goes first no one says.
    if let Some(second) = pou.children().filter(|child| child.tag() == "body").nth(1) {
        return Err(second.defect(DefectKind::SecondBody));
    }
    let language = body.inner("ST")?;
    match language.tag() {
        "ST" => Ok(lines(&language.text())),
        "FBD" | "LD" | "SFC" | "IL" => {
            Err(language.defect(DefectKind::Language { language: language.tag().to_owned() }))
        }
        _ => Err(language.not_supported()),
    }
}

/// Without the empty lines around it and without the white space that the file's own indentation adds.
fn lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    let ends = (
        lines.iter().position(|line| !line.is_empty()),
        lines.iter().rposition(|line| !line.is_empty()),
    );
    let (Some(first), Some(last)) = ends else {
        return String::new();
    };
    let lines = &lines[first..=last];
    let indent = |line: &&str| line.len() - line.trim_start().len();
    // The first line begins right behind the tag in some files: its indentation is not that of the others.
    let common = lines.iter().skip(1).filter(|line| !line.is_empty()).map(indent).min();
    let common = common.unwrap_or(usize::MAX).min(lines.iter().map(indent).max().unwrap_or(0));
    let mut text = String::new();
    for line in lines {
        text.push_str(line.get(indent(line).min(common)..).unwrap_or(line));
        text.push('\n');
    }
    text
}
