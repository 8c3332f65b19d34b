//! A report in the XML of JUnit, which build servers read.
//!
//! There is no standard of it; elements and attributes are those that Jenkins and GitLab document.

use std::fmt::Write;
use std::time::Duration;

use super::report::{Case, Outcome, Report};

/// The report as one document.
pub fn xml(report: &Report) -> String {
    let took: Duration = report.cases.iter().map(|case| case.took).sum();
    let counts = format!(
        "tests=\"{}\" failures=\"{}\" errors=\"{}\" time=\"{:.3}\"",
        report.cases.len(),
        report.failed(),
        report.broken(),
        took.as_secs_f64()
    );
    let name = escaped(&report.program);
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites {counts}>\n\
         <testsuite name=\"{name}\" {counts}>\n"
    );
    for case in &report.cases {
        element(&mut out, case, &name);
    }
    out.push_str("</testsuite>\n</testsuites>\n");
    out
}

fn element(out: &mut String, case: &Case, program: &str) {
    // Writing to a String cannot fail.
    let _ = write!(
        out,
        "<testcase name=\"{}\" classname=\"{program}\" time=\"{:.3}\"",
        escaped(&case.name),
        case.took.as_secs_f64()
    );
    if let Some((file, line)) = &case.place {
        let _ = write!(out, " file=\"{}\" line=\"{line}\"", escaped(file));
    }
    let (tag, what) = match &case.outcome {
        Outcome::Passed => return out.push_str("/>\n"),
        Outcome::Failed(what) => ("failure", what),
        Outcome::Broken(what) => ("error", what),
    };
    let first = escaped(what.lines().next().unwrap_or(""));
    let _ = writeln!(out, "><{tag} message=\"{first}\">{}</{tag}></testcase>", escaped(what));
}

/// Text for an attribute or an element. XML 1.0 has no form for most control characters.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_test_is_called_cannot_leave_its_attribute() {
        let mut report = Report::new("a&b");
        let what = "found \"1\" < 2\nand \u{1}".to_owned();
        let outcome = Outcome::Failed(what);
        let place = Some(("t.st".to_owned(), 3));
        report.cases.push(Case { name: "\"/><x>".into(), place, outcome, took: Duration::ZERO });
        let xml = xml(&report);
        assert!(xml.contains("failures=\"1\" errors=\"0\""), "{xml}");
        assert!(
            xml.contains("<testcase name=\"&quot;/&gt;&lt;x&gt;\" classname=\"a&amp;b\""),
            "{xml}"
        );
        assert!(xml.contains("message=\"found &quot;1&quot; &lt; 2\">"), "{xml}");
        assert!(xml.contains("and \u{fffd}</failure>"), "{xml}");
    }
}
