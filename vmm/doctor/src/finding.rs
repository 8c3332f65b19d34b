//! What a check says.
//!
//! A number alone is of no help in front of a control cabinet. So a finding that is not good also
//! tells what it costs the PLC, and what to type.

use serde::Serialize;

/// How bad a finding is; later is worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Good,
    /// This process may not look, or has not looked for long enough: it may be good or bad.
    Unseen,
    /// Releases can be late, or scans longer than they need be.
    Warning,
    /// A promise of the partition file cannot be kept.
    Cannot,
}

impl Severity {
    /// One word, as it is also written in JSON.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Severity::Good => "good",
            Severity::Unseen => "unseen",
            Severity::Warning => "warning",
            Severity::Cannot => "cannot",
        }
    }
}

/// The answer of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Name of the check, which stays the same from version to version.
    pub check: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What was found.
    pub found: String,
    /// What it costs the PLC; `None` if nothing.
    pub cost: Option<String>,
    /// The command that mends it, or what else does; `None` if nothing needs to be mended.
    pub remedy: Option<String>,
}

impl Finding {
    /// All is well.
    pub fn good(check: &'static str, found: impl Into<String>) -> Self {
        Self { check, severity: Severity::Good, found: found.into(), cost: None, remedy: None }
    }

    /// This process may not look.
    pub fn unseen(
        check: &'static str,
        found: impl Into<String>,
        cost: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::bad(check, Severity::Unseen, found.into(), cost.into(), remedy.into())
    }

    /// It works, but worse than it could.
    pub fn warning(
        check: &'static str,
        found: impl Into<String>,
        cost: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::bad(check, Severity::Warning, found.into(), cost.into(), remedy.into())
    }

    /// A promise cannot be kept.
    pub fn cannot(
        check: &'static str,
        found: impl Into<String>,
        cost: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::bad(check, Severity::Cannot, found.into(), cost.into(), remedy.into())
    }

    fn bad(
        check: &'static str,
        severity: Severity,
        found: String,
        cost: String,
        remedy: String,
    ) -> Self {
        Self { check, severity, found, cost: Some(cost), remedy: Some(remedy) }
    }
}
