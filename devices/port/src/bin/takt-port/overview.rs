//! `list` and `status`: the ports without their messages.

use std::io::{self, Write};

use serde::Serialize;
use takt_port::channel::Policy;
use takt_port::{Kind, Port, Ports};

use crate::failure::Failure;

/// A port in `list`.
#[derive(Debug, Serialize)]
struct Listed<'a> {
    port: &'a str,
    kind: &'static str,
    direction: &'static str,
    message_bytes: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    refresh_ns: Option<u64>,
    doorbell: bool,
}

impl<'a> Listed<'a> {
    fn of(port: &'a Port) -> Self {
        let (depth, policy, refresh_ns) = match port.kind {
            Kind::Sampling { refresh } => {
                (None, None, u64::try_from(refresh.as_nanos()).ok().filter(|ns| *ns > 0))
            }
            Kind::Queuing { depth, policy } => {
                let policy = match policy {
                    Policy::Refuse => "refuse",
                    Policy::Overwrite => "overwrite",
                };
                (Some(depth), Some(policy), None)
            }
        };
        Listed {
            port: &port.name,
            kind: port.kind.name(),
            direction: port.direction.name(),
            message_bytes: port.maximum,
            depth,
            policy,
            refresh_ns,
            doorbell: port.doorbell,
        }
    }
}

/// A port in `status`.
#[derive(Debug, Serialize)]
struct Seen<'a> {
    port: &'a str,
    in_use: bool,
    source_starts: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    destination_starts: Option<u64>,
    written: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    waiting: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    age_ns: Option<u64>,
}

/// Lists all ports.
pub fn list(ports: &Ports, json: bool) -> Result<(), Failure> {
    let mut rows = vec![
        ["PORT", "KIND", "DIRECTION", "BYTES", "DEPTH", "POLICY", "REFRESH", "DOORBELL"]
            .map(str::to_owned),
    ];
    for port in ports.list() {
        let listed = Listed::of(port);
        if json {
            print_json(&listed)?;
            continue;
        }
        rows.push([
            listed.port.to_owned(),
            listed.kind.to_owned(),
            listed.direction.to_owned(),
            listed.message_bytes.to_string(),
            or_dash(listed.depth),
            or_dash(listed.policy),
            or_dash(listed.refresh_ns.map(milliseconds)),
            if listed.doorbell { "yes" } else { "no" }.to_owned(),
        ]);
    }
    if json { Ok(()) } else { print(&table(&rows)) }
}

/// Shows what can be seen of one port or of all.
pub fn status(ports: &Ports, name: Option<&str>, json: bool) -> Result<(), Failure> {
    let chosen = match name {
        Some(name) => std::slice::from_ref(ports.port(name)?),
        None => ports.list(),
    };
    let mut rows = vec![
        ["PORT", "IN USE", "SOURCE STARTS", "DEST. STARTS", "WRITTEN", "WAITING", "AGE"]
            .map(str::to_owned),
    ];
    for port in chosen {
        let status = ports.status(port)?;
        let age_ns = status.newest.map(|newest| ports.clock().nanoseconds(newest.age));
        let seen = Seen {
            port: &port.name,
            in_use: status.in_use,
            source_starts: status.source_starts,
            destination_starts: status.destination_starts,
            written: status.written,
            waiting: status.waiting,
            age_ns,
        };
        if json {
            print_json(&seen)?;
            continue;
        }
        rows.push([
            seen.port.to_owned(),
            if seen.in_use { "yes" } else { "no" }.to_owned(),
            seen.source_starts.to_string(),
            or_dash(seen.destination_starts),
            seen.written.to_string(),
            or_dash(seen.waiting),
            or_dash(seen.age_ns.map(milliseconds)),
        ]);
    }
    if json { Ok(()) } else { print(&table(&rows)) }
}

fn or_dash(value: Option<impl ToString>) -> String {
    value.map_or("-".to_owned(), |value| value.to_string())
}

fn milliseconds(ns: u64) -> String {
    format!("{}.{:03}ms", ns / 1_000_000, ns / 1_000 % 1_000)
}

/// Columns as wide as their widest entry.
fn table<const N: usize>(rows: &[[String; N]]) -> String {
    let mut widths = [0; N];
    for row in rows {
        widths.iter_mut().zip(row).for_each(|(width, cell)| *width = cell.len().max(*width));
    }
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> =
            row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        text += cells.join("  ").trim_end();
        text.push('\n');
    }
    text
}

fn print_json(line: &impl Serialize) -> Result<(), Failure> {
    let line = serde_json::to_string(line);
    let line = line.map_err(|error| Failure::Stream("output", error.into()))?;
    print(&(line + "\n"))
}

fn print(text: &str) -> Result<(), Failure> {
    io::stdout().write_all(text.as_bytes()).map_err(|error| Failure::Stream("output", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_aligned_columns_and_no_trailing_space() {
        let rows = [["A", "B"], ["long", "-"]].map(|row| row.map(str::to_owned));
        assert_eq!(table(&rows), "A     B\nlong  -\n");
    }

    #[test]
    fn a_time_is_shown_in_milliseconds() {
        assert_eq!(milliseconds(1_234_567), "1.234ms");
        assert_eq!(milliseconds(2_000_000_999), "2000.000ms");
    }
}
