//! The report: for people as a table, for programs as JSON.

use std::fmt::Write;

use serde::Serialize;

use crate::demand::Demand;
use crate::finding::{Finding, Severity};
use crate::host::Host;

/// Version of the JSON; `docs/doctor.md` describes it.
const SCHEMA: u32 = 1;
/// Where the text of a finding begins.
const INDENT: usize = 30;

/// All that is told.
#[derive(Debug, Serialize)]
pub struct Report {
    schema: u32,
    /// The worst of all findings.
    verdict: Severity,
    /// Absolute path of the partition file, if there is one.
    file: Option<String>,
    kernel: String,
    processor: String,
    /// CPUs on which partitions have windows.
    windowed_cpus: Vec<usize>,
    findings: Vec<Finding>,
}

impl Report {
    /// Puts it together.
    #[must_use]
    pub fn new(host: &Host, demand: &Demand, findings: Vec<Finding>) -> Self {
        let worst = findings.iter().map(|finding| finding.severity).max();
        Self {
            schema: SCHEMA,
            verdict: worst.unwrap_or(Severity::Good),
            file: demand.file.as_ref().map(|path| path.display().to_string()),
            kernel: host.kernel(),
            processor: host.processor("model name").unwrap_or_else(|| "unknown".into()),
            windowed_cpus: demand.cpus().into_iter().map(|cpu| cpu.0).collect(),
            findings,
        }
    }

    /// The worst of all findings.
    #[must_use]
    pub fn verdict(&self) -> Severity {
        self.verdict
    }

    /// One object on one line.
    #[must_use]
    pub fn json(&self) -> String {
        // Strings and numbers only: there is nothing that could fail.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    /// A table of the width of a terminal, in colour; without one, a line for each thing said.
    #[must_use]
    pub fn table(&self, terminal: Option<usize>) -> String {
        let cpus: Vec<String> = self.windowed_cpus.iter().map(usize::to_string).collect();
        let asked = self.file.as_deref().unwrap_or("a PLC as most are (no partition file given)");
        let mut out = format!("{asked}, windows on CPU {}\n", cpus.join(", "));
        let _ = writeln!(out, "{}, {}\n", self.processor, self.kernel);
        for finding in &self.findings {
            let word = finding.severity.word();
            let colour = terminal.map_or(["", ""], |_| [colour(finding.severity), "\x1b[0m"]);
            let [on, off] = colour;
            let _ = write!(out, "{on}{word:<9}{off}{:<width$}", finding.check, width = INDENT - 9);
            paragraph(&mut out, &finding.found, terminal);
            for (name, text) in [("costs: ", &finding.cost), ("mend:  ", &finding.remedy)] {
                if let Some(text) = text {
                    let _ = write!(out, "{:INDENT$}", "");
                    // A command must stay in one piece to be copied.
                    let width = terminal.filter(|_| name == "costs: ");
                    paragraph(&mut out, &format!("{name}{text}"), width);
                }
            }
        }
        let _ = writeln!(out, "\n{}", self.words());
        out
    }

    fn words(&self) -> &'static str {
        match self.verdict {
            Severity::Good => "This host can keep its promises.",
            Severity::Unseen => "Nothing is wrong in what could be seen; not all of it could.",
            Severity::Warning => "This host can keep its promises, and could do better.",
            Severity::Cannot => "This host cannot keep its promises.",
        }
    }
}

fn colour(severity: Severity) -> &'static str {
    match severity {
        Severity::Good => "\x1b[32m",
        Severity::Unseen => "\x1b[36m",
        Severity::Warning => "\x1b[33m",
        Severity::Cannot => "\x1b[31m",
    }
}

/// Text whose first line begins at [`INDENT`], broken at blanks where the terminal is narrow.
fn paragraph(out: &mut String, text: &str, terminal: Option<usize>) {
    let width = terminal.map_or(usize::MAX, |columns| columns.saturating_sub(INDENT).max(20));
    let mut column = 0;
    for word in text.split(' ') {
        let length = word.chars().count();
        if column > 0 && column + 1 + length > width {
            let _ = write!(out, "\n{:INDENT$}", "");
            column = 0;
        } else if column > 0 {
            out.push(' ');
            column += 1;
        }
        out.push_str(word);
        column += length;
    }
    out.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(findings: Vec<Finding>) -> Report {
        let host = Host::recorded(std::path::Path::new("/none"), String::new());
        Report::new(&host, &Demand::usual(&host), findings)
    }

    #[test]
    fn the_verdict_is_the_worst_of_all() {
        let good = || Finding::good("a", "fine");
        assert_eq!(report(vec![]).verdict(), Severity::Good);
        let unseen = Finding::unseen("b", "?", "?", "?");
        assert_eq!(report(vec![good(), unseen.clone()]).verdict(), Severity::Unseen);
        let warning = Finding::warning("c", "so", "much", "that");
        assert_eq!(report(vec![warning.clone(), unseen, good()]).verdict(), Severity::Warning);
        let cannot = Finding::cannot("d", "so", "much", "that");
        assert_eq!(report(vec![cannot, warning]).verdict(), Severity::Cannot);
    }

    #[test]
    fn without_a_terminal_each_thing_is_one_plain_line() {
        let text = report(vec![Finding::warning("smt", "x ".repeat(90), "y ".repeat(90), "z")])
            .table(None);
        assert!(!text.contains('\x1b'), "{text}");
        assert!(text.lines().any(|line| line.starts_with("warning  smt") && line.len() > 150));
        assert!(text.contains(&format!("\n{:INDENT$}mend:  z\n", "")), "{text}");
    }

    #[test]
    fn a_terminal_is_not_written_beyond_but_for_commands() {
        let long = "word ".repeat(60);
        let finding = Finding::cannot("tsc", long.clone(), long.clone(), long);
        let text = report(vec![finding]).table(Some(80));
        let over: Vec<&str> =
            text.lines().filter(|line| line.trim_start_matches("\x1b[31m").len() > 90).collect();
        assert_eq!(over.len(), 1, "{text}");
        assert!(over[0].contains("mend:"));
    }

    #[test]
    fn programs_get_one_line_of_a_known_version() {
        let json = report(vec![Finding::good("a", "two\nlines")]).json();
        assert_eq!(json.lines().count(), 1);
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(value["schema"], 1);
        assert_eq!(value["verdict"], "good");
        assert_eq!(value["findings"][0]["cost"], serde_json::Value::Null);
    }
}
