//! Channels with points at both ends: an input has the type of the output that another partition writes there.
//!
//! With a Linux or the host at one end, or a program that calls, the file does not say what the message is made of.

use super::super::channels::Channel;
use super::super::diagnostic::{Diagnostic, quote};
use super::super::partition::Checked;
use super::place::ports;
use super::point::Point;
use super::types::{self, Part};
use super::{Entry, writers};
use takt_abi::io::{INPUT, kind};

/// A point at a field of a channel, with its parts as they lie in the message.
struct Field<'a> {
    entry: &'a Entry<'a>,
    parts: Vec<Part>,
}

/// Compares the outputs with the inputs of each channel. The tables are by partition.
pub fn check(
    entries: &[Vec<Entry<'_>>],
    partitions: &[Checked],
    channels: &[Channel],
) -> Result<(), Diagnostic> {
    for channel in channels {
        let mut outputs: Vec<Field<'_>> = Vec::new();
        for_each(entries, partitions, channels, channel, false, |field, _| {
            outputs.push(field);
            Ok(())
        })?;
        if outputs.is_empty() {
            continue;
        }
        for_each(entries, partitions, channels, channel, true, |input, partition| {
            outputs.iter().try_for_each(|output| compare(channel, output, &input, partition))
        })?;
    }
    Ok(())
}

/// Each input, or each output, at a field of the channel, with the partition that it is in.
fn for_each<'a>(
    entries: &'a [Vec<Entry<'a>>],
    partitions: &[Checked],
    channels: &[Channel],
    channel: &Channel,
    inputs: bool,
    mut each: impl FnMut(Field<'a>, &Checked) -> Result<(), Diagnostic>,
) -> Result<(), Diagnostic> {
    for (entries, partition) in entries.iter().zip(partitions) {
        let mut own = ports(partition.partition.id, channels);
        let Some(number) = own.position(|(own, _)| own.name == channel.name) else { continue };
        for entry in entries {
            let m = &entry.connection.mapping;
            let here = (m.kind, m.place) == (kind::FIELD, number as u64);
            if !here || (m.direction == INPUT) != inputs {
                continue;
            }
            let program = &partition.programs[usize::from(m.program)].program;
            let Some(image) = program.image() else { continue };
            let parts = types::parts(&entry.point, &image, writers::at_place(m));
            each(Field { entry, parts }, partition)?;
        }
    }
    Ok(())
}

fn compare(
    channel: &Channel,
    output: &Field<'_>,
    input: &Field<'_>,
    partition: &Checked,
) -> Result<(), Diagnostic> {
    let Some(part) = types::conflict(&output.parts, &input.parts) else { return Ok(()) };
    let words = |point: &Point| format!("{} of type {}", quote(&point.name), point.type_name);
    let found = format!(
        "{} in {} reads {} of the channel {}, where the output {} is written",
        words(&input.entry.point),
        quote(&partition.partition.name),
        place(part.bits),
        quote(&channel.name),
        words(&output.entry.point)
    );
    let allowed = format!("an output of {} there", part.allowed());
    Err(Diagnostic::new(input.entry.placed.clone(), found, allowed)
        .and(output.entry.placed.clone(), "what is written"))
}

fn place(bits: writers::Bits) -> String {
    let (byte, bit) = (bits.0 / 8, bits.0 % 8);
    if bits.1 - bits.0 == 1 { format!("bit {bit} of byte {byte}") } else { format!("byte {byte}") }
}
