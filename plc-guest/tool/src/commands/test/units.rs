//! The TEST blocks of a project, one after the other, each in a process of its own with the state of a start.

use std::time::{Duration, Instant};

use takt_program::Image;
use takt_st::hir::{Assertion, Comparison, Location, Program, Test};

use super::report::{Case, Outcome, Report};
use super::shown::shown;
use super::{Good, Messages, Options, host};
use crate::Failure;
use crate::run::{Failed, Machine, Schedule, TestRun, Verdict};

/// Simulated time that a test may let pass: no mistake in one keeps a build server busy for days.
const MOST: Duration = Duration::from_secs(7 * 24 * 3600);

/// Runs the tests whose names are wanted.
pub fn run(
    good: &Good,
    messages: &Messages,
    options: &Options,
    wanted: &dyn Fn(&str) -> bool,
    report: &mut Report,
) -> Result<(), Failure> {
    let program = &good.program;
    if program.tests.list.is_empty() {
        return Ok(());
    }
    let bytes = messages.build(good)?.image;
    let image = super::image(program.name.as_ref(), &bytes)?;
    for (number, test) in program.tests.list.iter().enumerate() {
        if wanted(&test.name) {
            let begin = Instant::now();
            let outcome = one(program, image, number, options)?;
            let Location { file, line, .. } = test.location;
            let place = program.files.get(usize::from(file)).map(|file| (file.clone(), line));
            let Test { name, .. } = test.clone();
            report.add(Case { name, place, outcome, took: begin.elapsed() });
        }
    }
    Ok(())
}

fn one(
    program: &Program,
    image: Image<'_>,
    number: usize,
    options: &Options,
) -> Result<Outcome, Failure> {
    let mut machine = Machine::for_test(image, options.limit()).map_err(host)?;
    let task = image.tasks().last();
    let wanted = program.tests.wanted.map(|id| program.global(id).storage.offset);
    let (Some(task), Some(wanted)) = (task, wanted) else {
        return Ok(Outcome::Broken("the tests have no task".into()));
    };
    let mut logged = Vec::new();
    let ended = machine.init(&mut logged).and_then(|()| {
        let wanted = takt_program::address::STATE + u64::from(wanted);
        machine.put(wanted, &(number as u64).to_le_bytes());
        let schedule = Schedule::new(&image).without(task.name);
        TestRun::new(&mut machine, schedule, task, MOST).run(&mut logged)
    });
    // However it ended: the lines are there to say why.
    options.say(&logged);
    match ended {
        Ok(Verdict::Passed) => Ok(Outcome::Passed),
        Ok(Verdict::Failed(number)) => Ok(match program.tests.assertions.get(number) {
            Some(assertion) => Outcome::Failed(told(program, assertion, &machine)),
            None => Outcome::Broken(format!("there is no assertion {number}")),
        }),
        Err(Failed::Host(error)) => Err(host(error)),
        Err(Failed::Program(fault)) => Ok(Outcome::Broken(fault.to_string())),
    }
}

/// A character of a message; one that a terminal would obey as its escape.
fn visible(c: char) -> impl Iterator<Item = char> {
    let escaped = c.is_control().then(|| c.escape_debug());
    escaped.into_iter().flatten().chain((!c.is_control()).then_some(c))
}

/// What was asserted and did not hold, with both values if it is a comparison.
fn told(program: &Program, assertion: &Assertion, machine: &Machine<'_>) -> String {
    let Location { file, line, .. } = assertion.location;
    let file = program.files.get(usize::from(file)).map_or("", |file| file);
    // An assertion of several lines is told by its first.
    let text = assertion.text.lines().next().unwrap_or("");
    let mut told = format!("{file}:{line}: {text}");
    if let Some(message) = &assertion.message {
        told.push_str(": ");
        told.extend(message.chars().flat_map(visible));
    }
    if let Some(compared) = &assertion.compared {
        let found = shown(program, machine, compared.found, compared.found_type);
        let expected = shown(program, machine, compared.expected, compared.expected_type);
        let relation = match compared.comparison {
            Comparison::Equal => "",
            Comparison::NotEqual => "something other than ",
            Comparison::Less => "less than ",
            Comparison::LessEqual => "at most ",
            Comparison::Greater => "more than ",
            Comparison::GreaterEqual => "at least ",
        };
        let give = compared.tolerance.map_or(String::new(), |tolerance| format!(" +-{tolerance}"));
        told.push_str(&format!("\n  found {found}, expected {relation}{expected}{give}"));
    }
    told
}
