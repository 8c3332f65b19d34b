//! A new name for what is declared.

use std::collections::BTreeMap;

use lsp_types::{
    DocumentChanges, OneOf, OptionalVersionedTextDocumentIdentifier, PrepareRenameResponse,
    TextDocumentEdit, TextEdit, WorkspaceEdit,
};
use takt_st::query::rename;

use crate::analysis::{Analysis, File};
use crate::uri::Name;

/// The other projects that are open.
#[derive(Default)]
pub struct Others {
    /// Their texts, each with a project that has it.
    pub texts: BTreeMap<Name, String>,
    /// One that cannot be read whole, and why: it may have any text.
    pub unseen: Option<(String, String)>,
}

/// The name at a byte, if it can be changed.
pub fn prepare(
    analysis: &Analysis,
    file: &File,
    offset: u32,
    others: &Others,
) -> Result<PrepareRenameResponse, String> {
    alone(file, others)?;
    let (one, _) = rename::prepare(&analysis.sources, &analysis.index, file.id, offset)
        .map_err(|error| error.to_string())?;
    // As it is written here: case does not count, and may differ.
    let placeholder = analysis.sources.text(one.span).to_owned();
    let range = analysis.range(file, one.span);
    Ok(PrepareRenameResponse::RangeWithPlaceholder { range, placeholder })
}

/// Refuses a text that another project has too, where uses are that would stay as they are.
fn alone(file: &File, others: &Others) -> Result<(), String> {
    if let Some(project) = others.texts.get(&file.name) {
        return Err(format!(
            "not all uses can be seen: {} is also a source of the project {project}, which is open",
            file.name.shown()
        ));
    }
    others.unseen.as_ref().map_or(Ok(()), |(project, reason)| {
        Err(format!("not all uses can be seen: the project {project} is open: {reason}"))
    })
}

/// The changes that give the name at a byte another text. With `versions` the editor refuses them for texts that it
/// has changed since.
pub fn edit(
    analysis: &Analysis,
    file: &File,
    offset: u32,
    new: &str,
    versions: bool,
    others: &Others,
) -> Result<WorkspaceEdit, String> {
    if let Some(reason) = analysis.unseen() {
        return Err(format!("not all uses can be seen: {reason}"));
    }
    let own = analysis.files.len();
    let place = (file.id, offset);
    let places = rename::rename(&analysis.sources, own, &analysis.index, place, new)
        .map_err(|error| error.to_string())?;
    let is_changed = |file: &&File| places.iter().any(|span| span.file == file.id);
    analysis.files.iter().filter(is_changed).try_for_each(|file| alone(file, others))?;
    let changed = analysis.files.iter().filter_map(|file| {
        let places = places.iter().filter(|span| span.file == file.id);
        let edits: Vec<TextEdit> = places
            .map(|span| TextEdit { range: analysis.range(file, *span), new_text: new.to_owned() })
            .collect();
        (!edits.is_empty()).then_some((file, edits))
    });
    if !versions {
        // The protocol's own type; what its keys hide is never changed.
        #[allow(clippy::mutable_key_type)]
        let changes = changed.map(|(file, edits)| (file.uri.clone(), edits)).collect();
        return Ok(WorkspaceEdit { changes: Some(changes), ..WorkspaceEdit::default() });
    }
    let edits = changed.map(|(file, edits)| TextDocumentEdit {
        text_document: OptionalVersionedTextDocumentIdentifier {
            uri: file.uri.clone(),
            version: file.version,
        },
        edits: edits.into_iter().map(OneOf::Left).collect(),
    });
    let document_changes = Some(DocumentChanges::Edits(edits.collect()));
    Ok(WorkspaceEdit { document_changes, ..WorkspaceEdit::default() })
}
