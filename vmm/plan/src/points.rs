//! Who writes what: outputs of programs, and the channels that programs use.
//!
//! Two writers of one output are a mistake in a plan as windows that overlap are: the last one's
//! value remains, and the plan does not say which that is. So each bit of an output image has one task that writes it,
//! and each port of the partition one program that uses it.

use takt_program::{Area, Direction, Image, Port, Variable};

use super::channels::{Channel, End, Owner};
use super::diagnostic::{Diagnostic, quote};
use super::partition::Checked;
use super::programs::CheckedProgram;

/// Checks the outputs of each program.
pub fn check_outputs(programs: &[CheckedProgram]) -> Result<(), Diagnostic> {
    programs.iter().try_for_each(|checked| {
        let Some(image) = checked.program.image() else { return Ok(()) };
        let Some((first, second)) = two_writers(&image) else { return Ok(()) };
        let task = |v: &Variable<'_>| v.writer.and_then(|id| image.task(id)).map_or("", |t| t.name);
        let found = format!(
            "two tasks of the program {} write one output: {} writes {}, and {} writes {}, at {}",
            quote(&checked.program.name),
            quote(task(&first)),
            quote(first.name),
            quote(task(&second)),
            quote(second.name),
            address(&second)
        );
        let allowed = "one writing task for each bit of the outputs";
        Err(Diagnostic::new(checked.span.clone(), found, allowed))
    })
}

/// Two outputs of different tasks that overlap.
fn two_writers<'a>(image: &Image<'a>) -> Option<(Variable<'a>, Variable<'a>)> {
    let outputs = image.variables().filter(|v| v.area == Area::Output && v.writer.is_some());
    let mut outputs: Vec<Variable<'a>> = outputs.collect();
    outputs.sort_by_key(|v| bits(v).0);
    // For each task what reaches farthest of its outputs so far.
    let mut farthest: Vec<Variable<'a>> = Vec::new();
    for output in outputs {
        let (start, end) = bits(&output);
        let other = |far: &&Variable<'a>| far.writer != output.writer && bits(far).1 > start;
        if let Some(other) = farthest.iter().find(other) {
            return Some((*other, output));
        }
        match farthest.iter_mut().find(|far| far.writer == output.writer) {
            Some(far) if bits(far).1 >= end => {}
            Some(far) => *far = output,
            None => farthest.push(output),
        }
    }
    None
}

/// The first bit of a variable in its area, and the one behind its last.
fn bits(variable: &Variable<'_>) -> (u64, u64) {
    let start = u64::from(variable.offset) * 8;
    match variable.bit {
        Some(bit) => (start + u64::from(bit), start + u64::from(bit) + 1),
        None => (start, start + u64::from(variable.bytes) * 8),
    }
}

/// Where a point lies in the process image, as IEC 61131-3 writes it, in bytes and bits.
#[must_use]
pub fn address(variable: &Variable<'_>) -> String {
    let area = match variable.area {
        Area::Input => 'I',
        Area::Output => 'Q',
        Area::Marker => 'M',
        Area::State | Area::Constant => return "-".to_owned(),
    };
    match variable.bit {
        Some(bit) => format!("%{area}X{}.{bit}", variable.offset),
        None => format!("%{area}B{}", variable.offset),
    }
}

/// Compares the ports of all programs with the channels.
pub fn check_ports(channels: &[Channel], partitions: &[Checked]) -> Result<(), Diagnostic> {
    for partition in partitions {
        let mut used: Vec<(&str, &CheckedProgram)> = Vec::new();
        for checked in &partition.programs {
            let Some(image) = checked.program.image() else { continue };
            for port in image.ports() {
                check_port(&port, checked, partition, channels)?;
                if let Some((_, other)) = used.iter().find(|(name, _)| *name == port.name) {
                    let found = format!(
                        "the programs {} and {} both use the port {} of the partition",
                        quote(&other.program.name),
                        quote(&checked.program.name),
                        quote(port.name)
                    );
                    let allowed = "one program for each port";
                    return Err(Diagnostic::new(checked.span.clone(), found, allowed)
                        .and(other.span.clone(), "the other one"));
                }
                used.push((port.name, checked));
            }
        }
    }
    Ok(())
}

fn check_port(
    port: &Port<'_>,
    checked: &CheckedProgram,
    partition: &Checked,
    channels: &[Channel],
) -> Result<(), Diagnostic> {
    let is_ours =
        |end: &End| end.owner == Owner::Partition(partition.partition.id) && end.port == port.name;
    let refuse = |found: &str, allowed: String| {
        let program = quote(&checked.program.name);
        let found = format!("the port {} of the program {program} {found}", quote(port.name));
        Err(Diagnostic::new(checked.span.clone(), found, allowed))
    };
    let (way, of) = match port.direction {
        Direction::In => ("a destination", "receives"),
        Direction::Out => ("the source", "sends"),
    };
    let of_channel =
        |channel: &&Channel| is_ours(&channel.source) || channel.destinations.iter().any(is_ours);
    let Some(channel) = channels.iter().find(of_channel) else {
        let end = format!("{}:{}", partition.partition.name, port.name);
        return refuse(
            "is no end of a channel",
            format!("a [[channel]] with {} as {way}", quote(&end)),
        );
    };
    if is_ours(&channel.source) != (port.direction == Direction::Out) {
        let allowed = format!("a [[channel]] of which it is {way}: the program {of}");
        return refuse("goes the other way", allowed);
    }
    if port.message_bytes != channel.message_bytes {
        let found = format!("has messages of up to {} bytes", port.message_bytes);
        let allowed = format!(
            "{}, the `message_bytes` of the channel {}",
            channel.message_bytes,
            quote(&channel.name)
        );
        return refuse(&found, allowed);
    }
    Ok(())
}
