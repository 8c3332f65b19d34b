//! The requests about texts.

use lsp_server::ErrorCode;
use lsp_types::request as ask;
use lsp_types::request::Request as _;
use lsp_types::{TextDocumentPositionParams, Uri};
use serde_json::Value;

use super::{Answer, Refused, Server, read, written};
use crate::analysis::{Analysis, File};
use crate::answers::{complete, format, hover, outline, places, rename};
use crate::documents::LOST;
use crate::uri::Name;
use crate::workspace::Project;

impl Server {
    pub(super) fn answer(&mut self, method: &str, params: Value) -> Answer {
        match method {
            ask::HoverRequest::METHOD => {
                self.at(read(params)?, |all, file, offset| written(hover::at(all, file, offset)))
            }
            ask::GotoDefinition::METHOD => self.at(read(params)?, |all, file, offset| {
                written(places::declaration(all, file, offset))
            }),
            ask::References::METHOD => {
                let params: lsp_types::ReferenceParams = read(params)?;
                let declaration = params.context.include_declaration;
                self.at(params.text_document_position, |all, file, offset| {
                    written(places::uses(all, file, offset, declaration))
                })
            }
            ask::Completion::METHOD => {
                self.at(read(params)?, |all, file, offset| written(complete::at(all, file, offset)))
            }
            ask::PrepareRenameRequest::METHOD => {
                let params: TextDocumentPositionParams = read(params)?;
                let others = self.others(&params.text_document.uri)?;
                self.at(params, |all, file, offset| {
                    let one = rename::prepare(all, file, offset, &others);
                    written(one.map_err(Refused::failed)?)
                })
            }
            ask::Rename::METHOD => {
                let params: lsp_types::RenameParams = read(params)?;
                let others = self.others(&params.text_document_position.text_document.uri)?;
                let versions = self.client.versioned_changes;
                self.at(params.text_document_position, |all, file, offset| {
                    let new = &params.new_name;
                    let edit = rename::edit(all, file, offset, new, versions, &others);
                    written(edit.map_err(Refused::failed)?)
                })
            }
            ask::Formatting::METHOD => {
                let params: lsp_types::DocumentFormattingParams = read(params)?;
                self.of(&params.text_document.uri, |all, file| {
                    written(format::edits(all, file).map_err(Refused::failed)?)
                })
            }
            ask::DocumentSymbolRequest::METHOD => {
                let params: lsp_types::DocumentSymbolParams = read(params)?;
                self.of(&params.text_document.uri, |all, file| written(outline::of(all, file)))
            }
            _ => Err(Refused {
                code: ErrorCode::MethodNotFound,
                message: format!("there is no request `{method}` here"),
            }),
        }
    }

    /// Answers a question about a place.
    fn at(
        &mut self,
        params: TextDocumentPositionParams,
        answer: impl FnOnce(&Analysis, &File, u32) -> Answer,
    ) -> Answer {
        let position = params.position;
        self.of(&params.text_document.uri, |all, file| {
            answer(all, file, all.offset(file, position))
        })
    }

    /// All other projects than that of a text.
    fn others(&mut self, uri: &Uri) -> Result<rename::Others, Refused> {
        let own = self.workspace.project_of(&Name::new(uri));
        let mut others = rename::Others::default();
        for project in self.wanted().into_iter().filter(|project| *project != own) {
            let analysis = self.analysis(&project).map_err(Refused::failed)?;
            let names = analysis.files.iter().map(|file| file.name.clone());
            others.texts.extend(names.map(|name| (name, project.shown())));
            // What belongs to a folder without a project file, or to a single text, is all that is open of it.
            if matches!(project, Project::Described(_) | Project::Tree(_))
                && let Some(reason) = analysis.unseen()
            {
                others.unseen = Some((project.shown(), reason));
            }
        }
        Ok(others)
    }

    /// Answers a question about a text.
    fn of(&mut self, uri: &Uri, answer: impl FnOnce(&Analysis, &File) -> Answer) -> Answer {
        let name = Name::new(uri);
        let project = self.workspace.project_of(&name);
        let alone = matches!(project, Project::Folder(_) | Project::Text(_));
        if alone && self.documents.get(&name).is_none() {
            return Err(Refused::parameters(format!("{} is not open", uri.as_str())));
        }
        if self.documents.get(&name).is_some_and(|document| document.text.is_none()) {
            return Err(Refused::failed(format!("{}: {LOST}", uri.as_str())));
        }
        let analysis = self.analysis(&project).map_err(Refused::failed)?;
        match analysis.file(&name) {
            Some(file) => answer(analysis, file),
            None => {
                let found = format!("{} is no source of a project here", uri.as_str());
                Err(Refused::parameters(found))
            }
        }
    }
}
