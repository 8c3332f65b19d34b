//! What releases event tasks, and by which vector the guest finds the interrupt of a device.
//!
//! A program names an interrupt. Which device that is, and its vector, stand in the partition file. The guest finds
//! an entry in its I/O table for each, with numbers only ([`EVENT`]).

use takt_abi::io::{EVENT, MAPPINGS_MAX, Mapping, WHOLE, kind};
use takt_program::{EventSource, Image, Task, TaskKind};
use takt_scheduler::time::Nanos;

use super::connections::{Can, Connection};
use super::diagnostic::{Diagnostic, quote};
use super::partition::Checked;
use super::passthrough::{Interrupt, Passthrough};
use super::programs::CheckedProgram;

/// By this vector the kernel of a PLC takes the starts of its windows.
const TICK_VECTOR: u8 = 32;

/// Checks what the event tasks of each partition wait for. Gives the entries of those that wait for an interrupt, in the
/// order of their programs.
pub fn check(
    partitions: &[Checked],
    passthrough: &[Passthrough],
    connections: &[(Vec<Connection>, Can)],
) -> Result<Vec<Vec<Mapping>>, Diagnostic> {
    let with_devices = partitions.iter().zip(passthrough).zip(connections);
    with_devices
        .map(|((partition, passthrough), (connections, _))| {
            let events = check_partition(&partition.programs, &passthrough.interrupts)?;
            match partition.programs.last() {
                Some(program) if connections.len() + events.len() > MAPPINGS_MAX => {
                    let found = format!(
                        "{} tables [[partition.io]], and {} tasks that wait for an interrupt",
                        connections.len(),
                        events.len()
                    );
                    let allowed = format!("at most {MAPPINGS_MAX} of both in a partition");
                    Err(Diagnostic::new(program.span.clone(), found, allowed))
                }
                _ => Ok(events),
            }
        })
        .collect()
}

fn check_partition(
    programs: &[CheckedProgram],
    interrupts: &[Interrupt],
) -> Result<Vec<Mapping>, Diagnostic> {
    let mut events: Vec<Mapping> = Vec::new();
    for (place, checked) in (0..).zip(programs) {
        let Some(image) = checked.program.image() else { continue };
        for task in image.tasks() {
            let TaskKind::Event { source, .. } = task.kind else { continue };
            let name = match source {
                EventSource::Channel(_) | EventSource::Rise(_) => continue,
                EventSource::Doorbell(_) => return Err(no_doorbell(&task, checked)),
                EventSource::Interrupt(name) => name,
            };
            let vector = find(name, &task, checked, interrupts)?;
            if events.iter().any(|event| event.place == vector.into()) {
                let found = format!("a second task waits for the interrupt {}", quote(name));
                return Err(refuse(&task, checked, &found, "one task for each interrupt"));
            }
            let (direction, kind) = (EVENT, kind::INTERRUPT);
            // An image has at most 16 tasks.
            let (program, task) = (place, task.id.0 as u8);
            let none = Mapping { bit: WHOLE, place_bit: WHOLE, ..Mapping::NONE };
            events.push(Mapping { program, direction, kind, task, place: vector.into(), ..none });
        }
    }
    Ok(events)
}

/// The vector of an interrupt that a task names.
fn find(
    name: &str,
    task: &Task<'_>,
    checked: &CheckedProgram,
    interrupts: &[Interrupt],
) -> Result<u8, Diagnostic> {
    let Some(interrupt) = interrupts.iter().find(|it| it.name.as_deref() == Some(name)) else {
        let found = format!("waits for the interrupt {}, which is not there", quote(name));
        let allowed = format!("a [[partition.interrupt]] with `name = {}`", quote(name));
        return Err(refuse(task, checked, &found, &allowed));
    };
    if interrupt.vector == TICK_VECTOR {
        let found = format!(
            "waits for the interrupt {} with the vector {TICK_VECTOR}, by which the kernel takes the starts of windows",
            quote(name)
        );
        return Err(refuse(task, checked, &found, "another `vector`, 33 to 254"));
    }
    Ok(interrupt.vector)
}

fn no_doorbell(task: &Task<'_>, checked: &CheckedProgram) -> Diagnostic {
    let allowed = "a message at a port, which the event `channel` sees with and without a doorbell; a BOOL that becomes \
                   true; an interrupt";
    refuse(task, checked, "waits for a doorbell, which only a Linux has", allowed)
}

fn refuse(task: &Task<'_>, checked: &CheckedProgram, found: &str, allowed: &str) -> Diagnostic {
    let program = quote(&checked.program.name);
    let found = format!("the task {} of the program {program}: {found}", quote(task.name));
    Diagnostic::new(checked.span.clone(), found, allowed)
}

/// The least times between two releases of the tasks that interrupts release.
pub fn of_interrupts(programs: &[CheckedProgram]) -> Vec<Nanos> {
    let images = programs.iter().filter_map(|checked| checked.program.image());
    let least = |image: Image<'_>| -> Vec<Nanos> {
        let tasks = image.tasks().filter_map(|task| match task.kind {
            TaskKind::Event { source: EventSource::Interrupt(_), minimum } => {
                Some(Nanos(minimum.0))
            }
            _ => None,
        });
        tasks.collect()
    };
    images.flat_map(least).collect()
}
