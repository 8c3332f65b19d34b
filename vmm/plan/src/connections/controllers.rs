//! CAN controllers that the kernel drives for the programs: where their registers are, and how fast their buses.

use takt_abi::can::{CONTROLLERS_MAX, Controller, REGISTERS};
use takt_abi::io::kind;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::names::check_name;
use super::super::passthrough::safe_values::{check_port, check_register};
use super::super::raw::{self, Keys};
use super::{Around, Entry};

/// Each of `takt_abi::can::BIT_RATES`, as the file has it.
const RATES: [(&str, u32); 8] = [
    ("10kbit/s", 10),
    ("20kbit/s", 20),
    ("50kbit/s", 50),
    ("100kbit/s", 100),
    ("125kbit/s", 125),
    ("250kbit/s", 250),
    ("500kbit/s", 500),
    ("1Mbit/s", 1000),
];
/// Frames in a job if the file does not say how many, and most of them.
const FRAMES: u8 = 4;
const FRAMES_MAX: u8 = 16;

/// A controller of the partition.
#[derive(Clone, Debug)]
pub struct Bus {
    /// Its name in the file.
    pub name: String,
    /// What the guest is told.
    pub controller: Controller,
    /// The value that says where it is.
    placed: Span,
}

impl Bus {
    /// Its bit rate as the file has it.
    #[must_use]
    pub fn rate(&self) -> &'static str {
        let rate = self.controller.kbit_per_s;
        RATES.iter().find(|(_, kbit)| *kbit == rate).map_or("", |(text, _)| text)
    }

    /// Its registers: the first, and the one behind the last.
    fn registers(&self) -> [u64; 2] {
        let Controller { place, stride, .. } = self.controller;
        [place, place + last(stride) + 1]
    }

    fn meets(&self, kind: u8, [first, end]: [u64; 2]) -> bool {
        let [own, own_end] = self.registers();
        self.controller.kind == kind && own < end && first < own_end
    }
}

/// From the first register of a controller to its last.
const fn last(stride: u8) -> u64 {
    (REGISTERS - 1) * stride as u64
}

/// Checks the controllers of a partition.
pub fn check(
    tables: &[Spanned<Keys<raw::Can>>],
    around: Around<'_>,
) -> Result<Vec<Bus>, Diagnostic> {
    if let Some(excess) = tables.get(CONTROLLERS_MAX) {
        let found = format!("this is table {} of {}", CONTROLLERS_MAX + 1, tables.len());
        let allowed = format!("at most {CONTROLLERS_MAX} tables [[partition.can]] in a partition");
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut buses: Vec<Bus> = Vec::with_capacity(tables.len());
    for table in tables {
        let next = check_one(table, around)?;
        let Keys(raw) = table.get_ref();
        if let Some(other) = buses.iter().position(|bus| bus.name == next.name) {
            let found = format!("a second [[partition.can]] is named {}", quote(&next.name));
            let allowed = "a name of its own for each in a partition";
            return Err(Diagnostic::new(raw.name.span(), found, allowed)
                .and(tables[other].get_ref().0.name.span(), "the other one"));
        }
        if let Some(other) = buses.iter().find(|b| b.meets(next.controller.kind, next.registers()))
        {
            let names = [&other.name, &next.name].map(|name| quote(name));
            let found = format!("{} and {} have registers in common", names[0], names[1]);
            return Err(Diagnostic::new(next.placed, found, "registers of its own for each")
                .and(other.placed.clone(), "the other one"));
        }
        buses.push(next);
    }
    Ok(buses)
}

fn check_one(table: &Spanned<Keys<raw::Can>>, around: Around<'_>) -> Result<Bus, Diagnostic> {
    let Keys(raw) = table.get_ref();
    let text = check_name(&raw.name)?;
    if around.partition.programs.is_empty() {
        let found = "the partition has no programs, for which its kernel would drive a controller";
        return Err(Diagnostic::new(table.span(), found, "a [[partition.program]]"));
    }
    let stride = match &raw.stride {
        None => 1,
        Some(stride) => u8::try_from(*stride.get_ref())
            .ok()
            .filter(|stride| matches!(stride, 1 | 2 | 4))
            .ok_or_else(|| {
                let found = format!("registers cannot be {} bytes apart", stride.get_ref());
                Diagnostic::new(stride.span(), found, "1, 2 or 4")
            })?,
    };
    let (kind, place, placed) = find_registers(raw, &table.span(), stride, around)?;
    let rate = raw.bit_rate.get_ref();
    let rate = RATES.iter().find(|(text, _)| text == rate).ok_or_else(|| {
        let found = format!("there is no bit rate {}", quote(rate));
        let allowed: Vec<String> = RATES.iter().map(|(text, _)| quote(text)).collect();
        Diagnostic::new(raw.bit_rate.span(), found, allowed.join(", "))
    })?;
    let frames = match &raw.frames_per_job {
        None => FRAMES,
        Some(frames) => u8::try_from(*frames.get_ref())
            .ok()
            .filter(|frames| (1..=FRAMES_MAX).contains(frames))
            .ok_or_else(|| {
                let found = format!("a job cannot take {} frames", frames.get_ref());
                Diagnostic::new(frames.span(), found, format!("1 to {FRAMES_MAX}"))
            })?,
    };
    let mut name = [0; 32];
    name.iter_mut().zip(text.bytes()).for_each(|(to, from)| *to = from);
    let controller =
        Controller { name, place, kind, stride, frames, reserved: 0, kbit_per_s: rate.1 };
    Ok(Bus { name: text.to_owned(), controller, placed })
}

/// Where register 0 is. All registers are in one range of ports, or in one memory.
fn find_registers(
    raw: &raw::Can,
    header: &Span,
    stride: u8,
    around: Around<'_>,
) -> Result<(u8, u64, Span), Diagnostic> {
    let beyond = |span: Span, what: String| {
        let found = format!("{what}: they are not all the partition's");
        let allowed = format!("a place with {} bytes from there on", last(stride) + 1);
        Err(Diagnostic::new(span, found, allowed))
    };
    match (&raw.port, &raw.mmio) {
        (Some(port), None) => {
            if let Some(offset) = &raw.offset {
                let found = "`offset` does not belong to `port`";
                return Err(Diagnostic::new(offset.span(), found, "`offset` beside `mmio`"));
            }
            let ports = &around.passthrough.ports;
            let first = check_port(port, 1, ports)?;
            let end = u64::from(first) + last(stride);
            if !ports.iter().any(|r| r.first <= first && end <= u64::from(r.last)) {
                let what =
                    format!("the registers of a controller are ports {first:#x} to {end:#x}");
                return beyond(port.span(), what);
            }
            Ok((kind::PORT, first.into(), port.span()))
        }
        (None, Some(name)) => {
            let memory = &around.passthrough.memory;
            let (index, offset) = check_register(name, raw.offset.as_ref(), header, 1, memory)?;
            let end = offset + last(stride);
            if end >= memory[index].bytes {
                let span = raw.offset.as_ref().map_or(header.clone(), Spanned::span);
                let what = format!("the registers of a controller are at {offset:#x} to {end:#x}");
                return beyond(span, what);
            }
            Ok((kind::REGISTER, memory[index].address + offset, name.span()))
        }
        (Some(port), Some(mmio)) => {
            let found = "both `port` and `mmio` say where the controller is";
            Err(Diagnostic::new(mmio.span(), found, "one of them")
                .and(port.span(), "the other one"))
        }
        (None, None) => {
            let found = "where the controller is is not said";
            let allowed = "`port = \"0x2000\"`, or `mmio = \"a-name\"` with `offset = \"0x0\"`";
            Err(Diagnostic::new(header.clone(), found, allowed))
        }
    }
}

/// A register of a controller is nothing that a program reads or writes itself: many of them change when they are.
pub fn check_registers(entries: &[Entry<'_>], buses: &[Bus]) -> Result<(), Diagnostic> {
    for entry in entries {
        let m = &entry.connection.mapping;
        let range = [m.place, m.place.saturating_add(m.width.into())];
        if let Some(bus) = buses.iter().find(|bus| bus.meets(m.kind, range)) {
            let found =
                format!("{} is of the CAN controller {}", entry.connection.place, quote(&bus.name));
            let allowed = "`can` with an identifier; registers of a controller are the kernel's";
            return Err(Diagnostic::new(entry.placed.clone(), found, allowed)
                .and(bus.placed.clone(), "the controller"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rates_are_those_of_the_interface() {
        assert_eq!(RATES.map(|(_, kbit)| kbit), takt_abi::can::BIT_RATES);
    }
}
