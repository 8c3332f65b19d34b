//! What is wrong with a project, file by file.

use std::collections::BTreeMap;

use lsp_types::{
    Diagnostic, DiagnosticRelatedInformation, DiagnosticSeverity, DiagnosticTag, NumberOrString,
    PublishDiagnosticsParams, Range, Uri,
};
use takt_st::diagnostic::{self, Code, Severity};
use takt_st::manifest::Mistakes;

use crate::analysis::Analysis;
use crate::position::Lines;
use crate::uri::Name;

/// The messages about each text of the project, also about those that have none. `tells` says of which texts this
/// project tells: a library's may be told of by a project of its own.
pub fn all(analysis: &Analysis, tells: impl Fn(&Name) -> bool) -> Vec<PublishDiagnosticsParams> {
    let mut by_file: BTreeMap<usize, Vec<Diagnostic>> = BTreeMap::new();
    for one in &analysis.diagnostics {
        if let Some(shown) = diagnostic(analysis, one) {
            by_file.entry(one.span.file.index()).or_default().push(shown);
        }
    }
    let files = analysis.files.iter().enumerate().filter(|(_, file)| tells(&file.name));
    let files = files.map(|(at, file)| PublishDiagnosticsParams {
        uri: file.uri.clone(),
        diagnostics: by_file.remove(&at).unwrap_or_default(),
        version: file.version,
    });
    let left_out = analysis.left_out.iter().map(|(uri, reason)| unreadable(uri, reason));
    let project_file = analysis.mistakes.iter().map(|(uri, mistakes)| of_file(uri, mistakes));
    files.chain(left_out).chain(project_file).collect()
}

/// What is wrong with a project file, as it is on the disk.
fn of_file(uri: &Uri, mistakes: &Mistakes) -> PublishDiagnosticsParams {
    let shown = mistakes.diagnostics.iter().map(|one| {
        let text = mistakes.sources.get(one.span.file).text();
        let range = Lines::new(text).range(text, one.span.start as usize..one.span.end as usize);
        plain(one, range, message(one))
    });
    PublishDiagnosticsParams { uri: uri.clone(), diagnostics: shown.collect(), version: None }
}

fn diagnostic(analysis: &Analysis, one: &diagnostic::Diagnostic) -> Option<Diagnostic> {
    let file = analysis.file_of(one.span)?;
    let mut message = message(one);
    let mut related = Vec::new();
    for other in &one.related {
        match analysis.location(other.span) {
            Some(location) => {
                related.push(DiagnosticRelatedInformation { location, message: other.note.clone() })
            }
            // The library has no file that an editor could show.
            None => message.push_str(&format!("\n{}", other.note)),
        }
    }
    let related_information = (!related.is_empty()).then_some(related);
    let shown = plain(one, analysis.range(file, one.span), message);
    Some(Diagnostic { related_information, ..shown })
}

/// What was found, what is allowed, and the hint.
fn message(one: &diagnostic::Diagnostic) -> String {
    let mut message = one.found.clone();
    for (word, text) in [("allowed", &one.allowed), ("hint", &one.hint)] {
        if let Some(text) = text {
            message.push_str(&format!("\n{word}: {text}"));
        }
    }
    message
}

/// A message without related places.
fn plain(one: &diagnostic::Diagnostic, range: Range, message: String) -> Diagnostic {
    Diagnostic {
        range,
        severity: Some(match one.code.severity() {
            Severity::Error => DiagnosticSeverity::ERROR,
            Severity::Warning => DiagnosticSeverity::WARNING,
        }),
        code: Some(NumberOrString::String(one.code.name().to_owned())),
        source: Some("takt".to_owned()),
        message,
        tags: (one.code == Code::Unused).then(|| vec![DiagnosticTag::UNNECESSARY]),
        ..Diagnostic::default()
    }
}

fn unreadable(uri: &Uri, reason: &str) -> PublishDiagnosticsParams {
    let one = Diagnostic {
        range: Range::default(),
        severity: Some(DiagnosticSeverity::ERROR),
        source: Some("takt".to_owned()),
        message: reason.to_owned(),
        ..Diagnostic::default()
    };
    PublishDiagnosticsParams { uri: uri.clone(), diagnostics: vec![one], version: None }
}
