//! What the server tells by itself: the messages about each text of a project.

use std::collections::{BTreeMap, BTreeSet};

use lsp_types::PublishDiagnosticsParams;
use lsp_types::notification as notify;

use super::Server;
use crate::analysis::{Analysis, File};
use crate::answers::diagnostics;
use crate::uri::Name;
use crate::workspace::Project;

impl Server {
    /// A project as it is now.
    pub(super) fn analysis(&mut self, project: &Project) -> Result<&Analysis, String> {
        if !self.analyses.contains_key(project) {
            let analysis = Analysis::new(&self.workspace, &self.documents, project)
                .map_err(|error| format!("cannot start a thread: {error}"))?;
            self.analyses.insert(project.clone(), analysis);
        }
        self.analyses.get(project).ok_or_else(|| "the project is not there".to_owned())
    }

    /// Checks a project and tells the client what is new.
    pub(super) fn publish(&mut self, project: &Project) {
        let mut now = BTreeMap::new();
        let wanted = self.wanted();
        if wanted.contains(project) {
            // It is read first, for what follows looks at all of the server.
            let failed = self.analysis(project).err();
            let (all, problem) = match self.analyses.get(project) {
                Some(analysis) => {
                    let tells = |name: &Name| {
                        let own = self.workspace.project_of(name);
                        own == *project || !wanted.contains(&own)
                    };
                    (diagnostics::all(analysis, tells), analysis.problem.clone())
                }
                None => (Vec::new(), failed),
            };
            self.tell_problem(project, problem);
            now.extend(all.into_iter().map(|one| (one.uri.to_string(), one)));
        } else {
            self.analyses.remove(project);
            self.problems.remove(project);
        }
        let mut before = self.published.remove(project).unwrap_or_default();
        // Texts of which this project tells nothing any more.
        let mut silent = Vec::new();
        now.retain(|uri, one| {
            let (one, known) = (&*one, before.remove(uri));
            if one.diagnostics.is_empty() && known.as_ref().is_some_and(has_messages) {
                silent.push(uri.clone());
            }
            // What the client has already, and no messages about a text that this project has told nothing of.
            let nothing = known.is_none() && one.diagnostics.is_empty() && one.version.is_none();
            if !nothing && known.as_ref() != Some(one) {
                self.notify::<notify::PublishDiagnostics>(one);
                // The client has the last messages about a text only.
                self.published.values_mut().for_each(|others| drop(others.remove(uri)));
            }
            !nothing
        });
        for (uri, old) in before {
            if has_messages(&old) {
                let none = PublishDiagnosticsParams::new(old.uri.clone(), Vec::new(), None);
                self.notify::<notify::PublishDiagnostics>(&none);
            }
            silent.push(uri);
        }
        // Others may have messages about them, which these had taken the place of.
        let is_silent = |file: &File| silent.iter().any(|uri| uri == file.uri.as_str());
        let others = self
            .analyses
            .iter()
            .filter(|(other, all)| *other != project && all.files.iter().any(is_silent));
        self.waiting.extend(others.map(|(other, _)| other.clone()));
        if !now.is_empty() {
            self.published.insert(project.clone(), now);
        }
    }

    /// The projects of which the editor has opened anything.
    pub(super) fn wanted(&self) -> BTreeSet<Project> {
        let open = self.documents.names().map(|name| self.workspace.project_of(name));
        self.workspace.projects().chain(open).collect()
    }

    /// Tells the user once why messages of a project may be missing.
    fn tell_problem(&mut self, project: &Project, problem: Option<String>) {
        match problem {
            None => drop(self.problems.remove(project)),
            Some(problem) if self.problems.get(project) == Some(&problem) => {}
            Some(problem) => {
                self.show(&format!("messages may be missing: {problem}"));
                self.problems.insert(project.clone(), problem);
            }
        }
    }
}

fn has_messages(one: &PublishDiagnosticsParams) -> bool {
    !one.diagnostics.is_empty()
}
