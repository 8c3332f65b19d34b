//! What became of the tests of a project.

use std::time::Duration;

use crate::{Failure, status};

/// A test that ran.
pub struct Case {
    pub name: String,
    /// The file and line where it is written, if it is a TEST.
    pub place: Option<(String, u32)>,
    pub outcome: Outcome,
    /// How long it took on this machine.
    pub took: Duration,
}

/// How a test ended.
pub enum Outcome {
    Passed,
    /// Not as expected.
    Failed(String),
    /// The program faulted, or the test cannot be run.
    Broken(String),
}

/// All tests, in the order in which they ran.
pub struct Report {
    /// The program's name.
    pub program: String,
    pub cases: Vec<Case>,
}

impl Report {
    pub fn new(program: &str) -> Self {
        Self { program: program.to_owned(), cases: Vec::new() }
    }

    /// Shows how a test ended, and keeps it.
    pub fn add(&mut self, case: Case) {
        let place =
            case.place.as_ref().map_or(String::new(), |(file, line)| format!("{file}:{line}: "));
        let (sign, what) = match &case.outcome {
            Outcome::Passed => ("ok    ", None),
            Outcome::Failed(what) => ("FAILED", Some(what)),
            Outcome::Broken(what) => ("BROKEN", Some(what)),
        };
        println!("{sign} {place}{}", case.name);
        for line in what.into_iter().flat_map(|what| what.lines()) {
            println!("    {line}");
        }
        self.cases.push(case);
    }

    pub fn failed(&self) -> usize {
        self.cases.iter().filter(|case| matches!(case.outcome, Outcome::Failed(_))).count()
    }

    pub fn broken(&self) -> usize {
        self.cases.iter().filter(|case| matches!(case.outcome, Outcome::Broken(_))).count()
    }

    /// Ends the command: well if all tests passed and there was one.
    pub fn end(&self, filter: Option<&str>) -> Result<(), Failure> {
        let count = self.cases.len();
        if count == 0 {
            let message = match filter {
                Some(filter) => format!("found no test with `{filter}` in its name"),
                None => "found no test: neither a TEST block nor, in the folders of tests of a project, a \
                         table (.csv)"
                    .to_owned(),
            };
            return Err(Failure::input(message));
        }
        let (failed, broken) = (self.failed(), self.broken());
        if failed + broken == 0 {
            println!("{}: {count} tests, all as expected", self.program);
            return Ok(());
        }
        let message = format!("{count} tests, {failed} failed, {broken} broken");
        Err(Failure { status: status::NOT_AS_EXPECTED, message })
    }
}
