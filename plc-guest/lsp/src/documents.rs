//! The texts that are open in the editor.

use std::collections::HashMap;

use lsp_types::{TextDocumentContentChangeEvent, Uri};
use takt_st::limits;

use crate::position::Lines;
use crate::uri::Name;

/// One text.
#[derive(Debug)]
pub struct Document {
    /// What the client calls it.
    pub uri: Uri,
    /// The client's number for this state of it.
    pub version: i32,
    /// As it is in the editor.
    pub text: String,
}

/// All open texts.
#[derive(Debug, Default)]
pub struct Documents {
    open: HashMap<Name, Document>,
}

impl Documents {
    /// Opens a text, or opens it anew.
    pub fn open(&mut self, document: Document) -> Result<(), String> {
        let name = Name::new(&document.uri);
        if self.open.len() >= limits::FILES && !self.open.contains_key(&name) {
            return Err(format!("more than {} files are open", limits::FILES));
        }
        self.open.insert(name, document);
        Ok(())
    }

    /// Changes a text, one change after the other.
    pub fn change(
        &mut self,
        uri: &Uri,
        version: i32,
        changes: Vec<TextDocumentContentChangeEvent>,
    ) -> Result<(), String> {
        let Some(document) = self.open.get_mut(&Name::new(uri)) else {
            return Err(format!("a change of {}, which is not open", uri.as_str()));
        };
        document.version = version;
        for change in changes {
            let Some(range) = change.range else {
                document.text = change.text;
                continue;
            };
            let lines = Lines::new(&document.text);
            let start = lines.offset(&document.text, range.start);
            let end = lines.offset(&document.text, range.end).max(start);
            document.text.replace_range(start..end, &change.text);
            // A text as large as this is told of as an error, and need not grow.
            if document.text.len() > 4 * limits::FILE_BYTES {
                return Err(format!("{} has become too large", uri.as_str()));
            }
        }
        Ok(())
    }

    /// Closes a text.
    pub fn close(&mut self, uri: &Uri) {
        self.open.remove(&Name::new(uri));
    }

    /// A text.
    pub fn get(&self, name: &Name) -> Option<&Document> {
        self.open.get(name)
    }

    /// The names of all texts.
    pub fn names(&self) -> impl Iterator<Item = &Name> {
        self.open.keys()
    }
}
