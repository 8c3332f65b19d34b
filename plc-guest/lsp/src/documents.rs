//! The texts that are open in the editor.

use std::collections::HashMap;

use lsp_types::{TextDocumentContentChangeEvent, Uri};
use takt_st::limits;

use crate::position::Lines;
use crate::uri::Name;

/// What is told of a text that was lost.
pub const LOST: &str = "it has become too large to be followed; close it and open it again";

/// One text.
#[derive(Debug)]
pub struct Document {
    /// What the client calls it.
    pub uri: Uri,
    /// The client's number for this state of it.
    pub version: i32,
    /// As it is in the editor; none once it was lost, until all of it comes again.
    pub text: Option<String>,
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

    /// Changes a text, one change after the other. A text that becomes too large is lost: what changes there later has
    /// no place that is known here.
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
        let was_lost = document.text.is_none();
        for change in changes {
            let Some(range) = change.range else {
                document.text = Some(change.text);
                continue;
            };
            let Some(text) = &mut document.text else { continue };
            let lines = Lines::new(text);
            let start = lines.offset(text, range.start);
            let end = lines.offset(text, range.end).max(start);
            text.replace_range(start..end, &change.text);
            if text.len() > 4 * limits::FILE_BYTES {
                document.text = None;
            }
        }
        match document.text {
            None if !was_lost => Err(format!("{}: {LOST}", uri.as_str())),
            _ => Ok(()),
        }
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
