//! The notifications: what has changed in the editor and on the disk.

use std::collections::BTreeSet;

use lsp_server::Request;
use lsp_types::notification as notify;
use lsp_types::notification::Notification as _;
use lsp_types::request as ask;
use lsp_types::request::Request as _;
use lsp_types::{TextDocumentItem, Uri};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::Server;
use crate::documents::Document;
use crate::uri::Name;
use crate::workspace::Project;

impl Server {
    /// Takes note that a text has changed.
    fn changed(&mut self, project: Project) {
        self.analyses.remove(&project);
        self.waiting.insert(project);
    }

    fn changed_text(&mut self, uri: &Uri) {
        let name = Name::new(uri);
        let own = self.workspace.project_of(&name);
        // A text of a library is one of other projects too.
        let with = self.analyses.iter().filter(|(_, analysis)| analysis.file(&name).is_some());
        let mut projects: Vec<Project> = with.map(|(project, _)| project.clone()).collect();
        projects.push(own);
        projects.into_iter().for_each(|project| self.changed(project));
    }

    /// Something may have changed on the disk, or which text is of which project.
    fn changed_all(&mut self) {
        let open = self.documents.names().map(|name| self.workspace.project_of(name));
        let read = self.published.keys().chain(self.analyses.keys()).cloned();
        let known: BTreeSet<Project> = open.chain(self.workspace.projects()).chain(read).collect();
        known.into_iter().for_each(|project| self.changed(project));
    }

    /// Takes a notification. The error is for the user.
    pub(super) fn notification(&mut self, method: &str, params: Value) -> Result<(), String> {
        match method {
            notify::Initialized::METHOD => {
                if self.client.watches {
                    self.watch();
                }
                self.changed_all();
            }
            notify::DidOpenTextDocument::METHOD => {
                let params: lsp_types::DidOpenTextDocumentParams = told(method, params)?;
                let TextDocumentItem { uri, version, text, .. } = params.text_document;
                self.changed_text(&uri);
                self.documents.open(Document { uri, version, text: Some(text) })?;
            }
            notify::DidChangeTextDocument::METHOD => {
                let params: lsp_types::DidChangeTextDocumentParams = told(method, params)?;
                let document = params.text_document;
                self.changed_text(&document.uri);
                self.documents.change(&document.uri, document.version, params.content_changes)?;
            }
            notify::DidCloseTextDocument::METHOD => {
                let params: lsp_types::DidCloseTextDocumentParams = told(method, params)?;
                self.documents.close(&params.text_document.uri);
                self.changed_text(&params.text_document.uri);
            }
            notify::DidSaveTextDocument::METHOD => {
                let params: lsp_types::DidSaveTextDocumentParams = told(method, params)?;
                self.changed_text(&params.text_document.uri);
            }
            notify::DidChangeWatchedFiles::METHOD => self.changed_all(),
            notify::DidChangeWorkspaceFolders::METHOD => {
                let params: lsp_types::DidChangeWorkspaceFoldersParams = told(method, params)?;
                for folder in &params.event.removed {
                    self.workspace.remove(&Name::new(&folder.uri));
                }
                for folder in &params.event.added {
                    self.workspace.add(&Name::new(&folder.uri));
                }
                self.changed_all();
            }
            // Settings, cancelled requests, traces and whatever a client may do without.
            _ => {}
        }
        Ok(())
    }

    /// Asks the client to tell of changes on the disk.
    fn watch(&mut self) {
        let watchers = json!([{ "globPattern": "**/{*.st,*.ST,takt-plc.toml}" }]);
        let one = json!({
            "id": "sources",
            "method": notify::DidChangeWatchedFiles::METHOD,
            "registerOptions": { "watchers": watchers },
        });
        self.out.push(
            Request {
                id: "watch".to_owned().into(),
                method: ask::RegisterCapability::METHOD.to_owned(),
                params: json!({ "registrations": [one] }),
            }
            .into(),
        );
    }
}

fn told<P: DeserializeOwned>(method: &str, params: Value) -> Result<P, String> {
    serde_json::from_value(params).map_err(|error| format!("`{method}`: {error}"))
}
