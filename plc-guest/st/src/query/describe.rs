//! A declaration as one writes it, for the box that an editor shows beside a name.

use super::{Index, Symbol, SymbolId, SymbolKind};
use crate::source::{Sources, Span};
use crate::syntax::ast::{SectionKind, UnitKind};

/// The parameters, values or fields that are shown of one declaration.
const PARTS: usize = 32;

/// The characters that are shown of a type or of an initial value.
const WIDTH: usize = 160;

/// The declaration in a few lines of Structured Text.
#[must_use]
pub fn declaration(sources: &Sources, index: &Index, id: SymbolId) -> String {
    let symbol = index.symbol(id);
    let container = symbol.container.map(|container| &*index.symbol(container).name);
    match symbol.kind {
        SymbolKind::Variable(section) => {
            let constant = if symbol.constant { " CONSTANT" } else { "" };
            format!("{}{constant} {}", keyword(section), variable(sources, symbol))
        }
        SymbolKind::Field => {
            let of = container.unwrap_or_default();
            format!("{of}.{}", variable(sources, symbol))
        }
        SymbolKind::Enumerator => {
            let of = container.filter(|name| !name.is_empty());
            let of = of.map(|name| format!("{name}#")).unwrap_or_default();
            let number = symbol.initial.map(|span| format!(" := {}", shown(sources, span)));
            format!("{of}{}{}", symbol.name, number.unwrap_or_default())
        }
        SymbolKind::Unit(kind) => unit(sources, index, symbol, kind),
        SymbolKind::Structure => {
            let head = format!("TYPE {} : STRUCT", symbol.name);
            with_parts(sources, index, head, symbol.members.iter(), false)
        }
        SymbolKind::Enumeration => {
            let names = symbol.members.iter().map(|id| &*index.symbol(*id).name);
            let mut names: Vec<&str> = names.take(PARTS).collect();
            if symbol.members.len() > names.len() {
                names.push("...");
            }
            format!("TYPE {} : ({})", symbol.name, names.join(", "))
        }
        SymbolKind::Type => {
            let spec = symbol.spec.map(|spec| shown(sources, spec)).unwrap_or_default();
            format!("TYPE {} : {spec}", symbol.name)
        }
        SymbolKind::Configuration => format!("CONFIGURATION {}", symbol.name),
        SymbolKind::Resource => format!("RESOURCE {}", symbol.name),
        SymbolKind::Task | SymbolKind::Instance => shown(sources, symbol.extent),
    }
}

/// The type of a variable or of a function's result as it is written.
#[must_use]
pub fn type_of(sources: &Sources, symbol: &Symbol) -> Option<String> {
    symbol.spec.map(|spec| shown(sources, spec))
}

fn unit(sources: &Sources, index: &Index, symbol: &Symbol, kind: UnitKind) -> String {
    let word = match kind {
        UnitKind::Program => "PROGRAM",
        UnitKind::Function => "FUNCTION",
        UnitKind::FunctionBlock => "FUNCTION_BLOCK",
        UnitKind::Test => "TEST",
    };
    let result = symbol.spec.map(|spec| format!(" : {}", shown(sources, spec)));
    let head = format!("{word} {}{}", symbol.name, result.unwrap_or_default());
    let parameters = symbol.members.iter().filter(|id| index.symbol(**id).is_parameter());
    with_parts(sources, index, head, parameters, true)
}

fn with_parts<'i>(
    sources: &Sources,
    index: &Index,
    mut text: String,
    parts: impl Iterator<Item = &'i SymbolId>,
    sections: bool,
) -> String {
    for (at, id) in parts.enumerate() {
        if at == PARTS {
            text.push_str("\n    ...");
            break;
        }
        let symbol = index.symbol(*id);
        let section = match symbol.kind {
            SymbolKind::Variable(section) if sections => format!("{} ", keyword(section)),
            _ => String::new(),
        };
        text.push_str(&format!("\n    {section}{}", variable(sources, symbol)));
    }
    text
}

fn variable(sources: &Sources, symbol: &Symbol) -> String {
    let mut text = symbol.name.clone();
    if let Some(address) = symbol.address {
        text.push_str(&format!(" AT {}", shown(sources, address)));
    }
    if let Some(spec) = symbol.spec {
        text.push_str(&format!(" : {}", shown(sources, spec)));
    }
    if let Some(initial) = symbol.initial {
        text.push_str(&format!(" := {}", shown(sources, initial)));
    }
    text
}

/// The text of a place in one line that is not too long.
fn shown(sources: &Sources, span: Span) -> String {
    let text = sources.text(span);
    let words: Vec<&str> = text.split_whitespace().take(WIDTH).collect();
    let line = words.join(" ");
    let mut cut: String = line.chars().take(WIDTH).collect();
    if cut.len() < line.len() || words.len() == WIDTH {
        cut.push_str("...");
    }
    cut
}

fn keyword(section: SectionKind) -> &'static str {
    match section {
        SectionKind::Local => "VAR",
        SectionKind::Input => "VAR_INPUT",
        SectionKind::Output => "VAR_OUTPUT",
        SectionKind::InOut => "VAR_IN_OUT",
        SectionKind::Temporary => "VAR_TEMP",
        SectionKind::External => "VAR_EXTERNAL",
        SectionKind::Global => "VAR_GLOBAL",
    }
}
