//! What a text declares, as a tree.

use lsp_types::{DocumentSymbol, SymbolKind as Kind};
use takt_st::query::{SymbolId, SymbolKind, describe};
use takt_st::syntax::ast::UnitKind;

use crate::analysis::{Analysis, File};

/// The declarations of a text.
pub fn of(analysis: &Analysis, file: &File) -> Vec<DocumentSymbol> {
    let top = analysis.index.symbols().filter(|(_, symbol)| {
        symbol.span.file == file.id && symbol.container.is_none() && !symbol.name.is_empty()
    });
    top.map(|(id, _)| outline(analysis, file, id)).collect()
}

fn outline(analysis: &Analysis, file: &File, id: SymbolId) -> DocumentSymbol {
    let symbol = analysis.index.symbol(id);
    let members = symbol.members.iter().map(|id| outline(analysis, file, *id));
    let children: Vec<DocumentSymbol> = members.collect();
    let selection = analysis.range(file, symbol.span);
    let mut range = analysis.range(file, symbol.extent);
    // The protocol wants the name within the whole.
    range.start = range.start.min(selection.start);
    range.end = range.end.max(selection.end);
    // Kept by the protocol for older clients, and without another way to leave it out.
    #[allow(deprecated)]
    DocumentSymbol {
        name: symbol.name.clone(),
        detail: describe::type_of(&analysis.sources, symbol),
        kind: kind(symbol.kind, symbol.constant),
        tags: None,
        deprecated: None,
        range,
        selection_range: selection,
        children: (!children.is_empty()).then_some(children),
    }
}

fn kind(kind: SymbolKind, constant: bool) -> Kind {
    match kind {
        SymbolKind::Unit(UnitKind::Program) => Kind::MODULE,
        SymbolKind::Unit(UnitKind::FunctionBlock) => Kind::CLASS,
        SymbolKind::Unit(UnitKind::Function) => Kind::FUNCTION,
        SymbolKind::Unit(UnitKind::Test) => Kind::METHOD,
        SymbolKind::Enumeration => Kind::ENUM,
        SymbolKind::Structure | SymbolKind::Type => Kind::STRUCT,
        SymbolKind::Enumerator => Kind::ENUM_MEMBER,
        SymbolKind::Field => Kind::FIELD,
        SymbolKind::Variable(_) if constant => Kind::CONSTANT,
        SymbolKind::Variable(_) => Kind::VARIABLE,
        SymbolKind::Configuration | SymbolKind::Resource => Kind::NAMESPACE,
        SymbolKind::Task => Kind::EVENT,
        SymbolKind::Instance => Kind::OBJECT,
    }
}
