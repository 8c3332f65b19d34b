//! How many instructions a job of each task takes at most, from sources in Structured Text.

use std::path::PathBuf;

use serde_json::{Value, json};
use takt_st::hir::{Location, Program, Task};
use takt_st::native::{self, Worst};
use takt_st::stack;

use super::structured_text::{Messages, Origin, no_thread};
use crate::Failure;

/// Compiles the sources and prints the bound of each task.
pub fn show(inputs: &[PathBuf], messages: &Messages, as_json: bool) -> Result<(), Failure> {
    let origin = Origin::of(inputs, messages)?;
    let program = messages.program("inspect", &origin)?.program;
    let worst = stack::with_room(|| native::worst(&program)).map_err(no_thread)?;
    let worst = worst.map_err(Failure::input)?;
    let tasks = program.tasks.iter().zip(&worst);
    if as_json {
        let tasks: Vec<Value> = tasks.map(|(task, worst)| object(&program, task, worst)).collect();
        println!("{:#}", json!({ "tasks": tasks }));
        return Ok(());
    }
    println!("instructions of a job, at most:");
    for (task, worst) in tasks {
        println!("  {:<20} {}", task.name, text(&program, worst));
    }
    Ok(())
}

fn text(program: &Program, worst: &Worst) -> String {
    match worst {
        Worst::Bounded(cost) if cost.runtime_calls == 0 => cost.instructions.to_string(),
        Worst::Bounded(cost) => format!(
            "{}, without those of functions for strings, copies and reals (calls: {})",
            cost.instructions, cost.runtime_calls
        ),
        Worst::Unbounded(loops) => {
            let places: Vec<String> = loops.iter().map(|at| place(program, *at)).collect();
            format!("no bound: the rounds of the loop at {} are not known", places.join(", at "))
        }
    }
}

fn object(program: &Program, task: &Task, worst: &Worst) -> Value {
    let (cost, loops) = match worst {
        Worst::Bounded(cost) => (Some(cost), &[][..]),
        Worst::Unbounded(loops) => (None, &loops[..]),
    };
    json!({
        "name": task.name,
        "instructions": cost.map(|cost| cost.instructions),
        "runtime_calls": cost.map(|cost| cost.runtime_calls),
        "unbounded": loops.iter().map(|at| place(program, *at)).collect::<Vec<_>>(),
    })
}

/// `main.st:12`
fn place(program: &Program, at: Location) -> String {
    match program.files.get(usize::from(at.file)) {
        Some(file) if at.line > 0 => format!("{file}:{}", at.line),
        _ => "a place that the compiler does not know".to_owned(),
    }
}
