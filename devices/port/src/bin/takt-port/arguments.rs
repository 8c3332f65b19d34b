//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use takt_port::Timeout;

use crate::layout::Layout;

/// Reads, writes and shows the ports of this partition.
///
/// A port is an end of a [[channel]] of Takt's partition file. Calls that follow each other lose
/// nothing: each goes on where the last one stopped.
#[derive(Debug, Parser)]
#[command(name = "takt-port", version, after_long_help = HELP)]
pub struct Arguments {
    /// Folder of the PCI function in sysfs, instead of the first one found
    #[arg(long, value_name = "FOLDER", global = true)]
    pub function: Option<PathBuf>,
    #[command(subcommand)]
    pub command: Command,
}

const HELP: &str = "\
Exit status: 0, or the return code of ARINC 653 with which the call failed:
  1 NO_ACTION       the port is in use; nothing was written yet, or nothing newer
  2 NOT_AVAILABLE   the queue is empty, or full; the other end's memory cannot be believed
  3 INVALID_PARAM   the message is empty
  4 INVALID_CONFIG  no such port or another kind of port; the message is too long
  5 INVALID_MODE    the port has the other direction
  6 TIMED_OUT       the time-out passed
 64 this command line or a message in it is wrong, 70 anything else

Examples:
  takt-port list
  takt-port send log 'pump on'
  while takt-port recv log --timeout forever; do echo; done
  takt-port watch state --layout 'level:lreal, valve:dint[4]' --json
  echo 'level=1.25 valve=1,2,3,4' | takt-port write set --layout 'level:lreal, valve:dint[4]'";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the ports of this partition
    List {
        /// One JSON object in each line
        #[arg(long)]
        json: bool,
    },
    /// Show what can be seen of a port, or of all, without taking it
    Status {
        /// Name of the port
        port: Option<String>,
        /// One JSON object in each line
        #[arg(long)]
        json: bool,
    },
    /// Read the newest message of a sampling port
    Read(Incoming),
    /// Write a message to a sampling port
    Write(Outgoing),
    /// Send a message to a queuing port
    Send(Outgoing),
    /// Receive a message from a queuing port
    Recv(Incoming),
    /// Show every message that comes, without end or until --count
    Watch(Incoming),
}

#[derive(Debug, Args)]
pub struct Incoming {
    /// Name of the port
    pub port: String,
    /// How long to wait for each message: 100us, 20ms, 1s, 5min, 0 or forever [default: 0, of
    /// watch: forever]
    #[arg(long, value_name = "TIME", value_parser = timeout)]
    pub timeout: Option<Timeout>,
    /// End after so many messages [default: 1, of watch: no end]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// Skip what is in the port now, instead of going on where its last owner stopped
    #[arg(long)]
    pub open: bool,
    #[command(flatten)]
    pub shape: Shape,
}

#[derive(Debug, Args)]
pub struct Outgoing {
    /// Name of the port
    pub port: String,
    /// The message; without it, standard input: all of it if raw, else a message in each line
    pub data: Option<String>,
    /// How long to wait for room for each message: 100us, 20ms, 1s, 5min, 0 or forever
    #[arg(long, value_name = "TIME", value_parser = timeout, default_value = "0")]
    pub timeout: Timeout,
    /// Write DATA so often; or end after so many messages of standard input
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// Discard what is not taken yet, instead of going on where the last owner stopped
    #[arg(long)]
    pub open: bool,
    #[command(flatten)]
    pub shape: Shape,
}

/// How messages look.
#[derive(Debug, Args)]
pub struct Shape {
    /// The bytes as they are (default)
    #[arg(long, conflicts_with_all = ["hex", "layout", "json"])]
    pub raw: bool,
    /// Hexadecimal digits, a message in each line
    #[arg(long, conflicts_with = "layout")]
    pub hex: bool,
    /// Named values, such as 'level:lreal, n:dint[4]': BOOL BYTE WORD DWORD LWORD SINT INT DINT
    /// LINT USINT UINT UDINT ULINT REAL LREAL and arrays of them, little-endian, without gaps.
    /// @FILE takes it from a file, where a line ends a value too
    #[arg(long, value_name = "LAYOUT", value_parser = Layout::from_argument)]
    pub layout: Option<Layout>,
    /// One JSON object in each line: port, code, age_ns, valid, and bytes (hexadecimal) or the
    /// layout's fields. Of one to be written, only bytes or fields count
    #[arg(long)]
    pub json: bool,
}

fn timeout(text: &str) -> Result<Timeout, String> {
    const ALLOWED: &str = "allowed is 0, forever, or a number with ns, us, ms, s or min";
    match text {
        "0" => return Ok(Timeout::Zero),
        "forever" => return Ok(Timeout::Forever),
        _ => {}
    }
    let digits = text.find(|c: char| !c.is_ascii_digit()).ok_or(ALLOWED)?;
    let (number, unit) = text.split_at(digits);
    let number: u64 = number.parse().map_err(|_| ALLOWED)?;
    let unit: u64 = match unit {
        "ns" => 1,
        "us" => 1_000,
        "ms" => 1_000_000,
        "s" => 1_000_000_000,
        "min" => 60_000_000_000,
        _ => return Err(ALLOWED.to_owned()),
    };
    match number.checked_mul(unit) {
        Some(0) => Ok(Timeout::Zero),
        Some(ns) => Ok(Timeout::Within(Duration::from_nanos(ns))),
        None => Err("that is longer than 500 years".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_timeout_is_a_number_with_a_unit_or_a_word() {
        assert_eq!(timeout("0"), Ok(Timeout::Zero));
        assert_eq!(timeout("0ms"), Ok(Timeout::Zero));
        assert_eq!(timeout("forever"), Ok(Timeout::Forever));
        assert_eq!(timeout("2min"), Ok(Timeout::Within(Duration::from_secs(120))));
        assert_eq!(timeout("250us"), Ok(Timeout::Within(Duration::from_micros(250))));
        for wrong in ["", "1", "s", "-1s", "1 s", "1h", "99999999999min", "99999999999999999999s"] {
            assert!(timeout(wrong).is_err(), "{wrong}");
        }
    }
}
