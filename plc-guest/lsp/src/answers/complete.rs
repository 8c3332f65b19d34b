//! Which names can be typed at a place.

use lsp_types::{CompletionItem, CompletionItemKind, CompletionList};
use takt_st::query::complete::{self, Candidate};
use takt_st::query::{SymbolKind, describe};
use takt_st::syntax::ast::{SectionKind, UnitKind};

use crate::analysis::{Analysis, File};

/// What can stand at a byte.
pub fn at(analysis: &Analysis, file: &File, offset: u32) -> CompletionList {
    let (all, more) = complete::at(&analysis.sources, &analysis.index, file.id, offset);
    let items = all.into_iter().map(|one| item(analysis, one)).collect();
    CompletionList { is_incomplete: more, items }
}

fn item(analysis: &Analysis, one: Candidate) -> CompletionItem {
    let symbol = one.symbol.map(|id| analysis.index.symbol(id));
    let kind = match symbol.map(|symbol| symbol.kind) {
        Some(SymbolKind::Unit(UnitKind::Function)) => CompletionItemKind::FUNCTION,
        Some(SymbolKind::Unit(UnitKind::FunctionBlock)) => CompletionItemKind::CLASS,
        Some(SymbolKind::Unit(UnitKind::Program)) => CompletionItemKind::MODULE,
        Some(SymbolKind::Enumeration) => CompletionItemKind::ENUM,
        Some(SymbolKind::Structure | SymbolKind::Type) => CompletionItemKind::STRUCT,
        Some(SymbolKind::Enumerator) => CompletionItemKind::ENUM_MEMBER,
        Some(SymbolKind::Field) => CompletionItemKind::FIELD,
        Some(SymbolKind::Variable(SectionKind::Input | SectionKind::Output)) => {
            CompletionItemKind::FIELD
        }
        Some(_) => CompletionItemKind::VARIABLE,
        None if one.form.is_some() => CompletionItemKind::FUNCTION,
        None if one.origin == complete::Origin::Language => CompletionItemKind::KEYWORD,
        None => CompletionItemKind::STRUCT,
    };
    let detail = one.form.or_else(|| {
        let symbol = symbol?;
        describe::type_of(&analysis.sources, symbol).or_else(|| {
            let container = analysis.index.symbol(symbol.container?);
            Some(container.name.clone()).filter(|name| !name.is_empty())
        })
    });
    CompletionItem {
        // The nearest first, by name within that.
        sort_text: Some(format!("{}{}", one.origin as u8, one.label.to_ascii_lowercase())),
        filter_text: one.insert.is_some().then(|| one.label.clone()),
        label: one.label,
        insert_text: one.insert,
        kind: Some(kind),
        detail,
        ..CompletionItem::default()
    }
}
