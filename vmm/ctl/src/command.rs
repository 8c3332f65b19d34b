//! The command line of `takt-ctl`.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Parser, Subcommand};
use takt_plan as config;
use takt_protocol::{Answer, Mode, Request};
use takt_scheduler::time::Nanos;

use crate::{text, trace};
use takt_client::{ClientError, Connection};

/// What the exit status means.
pub const AFTER_HELP: &str = "\
Exit status: 0 done; 1 Takt refuses; 2 wrong usage or partition file; 3 no Takt answers there.";

/// Asks a running Takt, and tells it what to do.
#[derive(Parser)]
#[command(name = "takt-ctl", version, after_help = AFTER_HELP)]
pub struct Cli {
    /// Print Takt's answers as they come, one JSON object on each line.
    #[arg(long)]
    json: bool,
    /// The partition file that Takt runs, or its control socket.
    #[arg(value_name = "FILE|SOCKET")]
    place: PathBuf,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// How the run stands.
    Status,
    /// Stop a partition.
    Stop {
        /// Its name.
        partition: String,
    },
    /// Start a partition that has stopped or ended.
    Start {
        /// Its name.
        partition: String,
        #[command(flatten)]
        mode: StartMode,
    },
    /// Stop a partition and start it again.
    Restart {
        /// Its name.
        partition: String,
        #[command(flatten)]
        mode: GivenMode,
    },
    /// Ask for a schedule, which will hold from the end of a frame on.
    Schedule {
        /// Its name.
        name: String,
    },
    /// What has happened lately.
    Events {
        /// Go on with what happens from now on.
        #[arg(long)]
        follow: bool,
    },
    /// Bring another version of a program into its PLC, which goes on with the running one.
    Load {
        /// The partition's name.
        partition: String,
        /// The program's name.
        program: String,
        /// The image of the new version.
        image: PathBuf,
    },
    /// Change a program to the version that was loaded, between two of its cycles.
    Commit {
        /// The partition's name.
        partition: String,
        /// The program's name.
        program: String,
    },
    /// Change a program back, or give up the version that was loaded.
    RollBack {
        /// The partition's name.
        partition: String,
        /// The program's name.
        program: String,
    },
    /// Which versions the programs of a partition have, and how far a change is.
    Versions {
        /// The partition's name.
        partition: String,
    },
    /// Write every window from now on to standard output, for ui.perfetto.dev or chrome://tracing.
    Trace {
        /// How long, such as 500ms; at most 60s.
        #[arg(long = "for", value_name = "DURATION", default_value = "1s", value_parser = duration)]
        length: Nanos,
    },
}

fn duration(text: &str) -> Result<Nanos, String> {
    config::parse_duration(text).map_err(|error| error.to_string())
}

#[derive(clap::Args)]
#[group(multiple = false)]
struct StartMode {
    /// Keep only PERSISTENT values of programs (the default).
    #[arg(long)]
    cold: bool,
    /// Keep what the partition retains.
    #[arg(long)]
    warm: bool,
}

#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct GivenMode {
    /// Keep only PERSISTENT values of programs.
    #[arg(long)]
    cold: bool,
    /// Keep what the partition retains.
    #[arg(long)]
    warm: bool,
}

fn mode(warm: bool) -> Mode {
    if warm { Mode::Warm } else { Mode::Cold }
}

impl Command {
    /// What is asked for it, one request after the other.
    fn requests(self) -> Result<Vec<Request>, ClientError> {
        match self {
            Command::Load { partition, program, image } => {
                let bytes = takt_client::versions::read(&image)?;
                Ok(takt_client::versions::load(&partition, &program, &bytes))
            }
            other => Ok(other.request().into_iter().collect()),
        }
    }

    fn request(self) -> Option<Request> {
        Some(match self {
            Command::Load { .. } => return None,
            Command::Commit { partition, program } => Request::Commit(partition, program),
            Command::RollBack { partition, program } => Request::RollBack(partition, program),
            Command::Versions { partition } => Request::Versions(partition),
            Command::Status => Request::Status,
            Command::Stop { partition } => Request::Stop(partition),
            Command::Start { partition, mode: m } => Request::Start(partition, mode(m.warm)),
            Command::Restart { partition, mode: m } => Request::Restart(partition, mode(m.warm)),
            Command::Schedule { name } => Request::Schedule(name),
            Command::Events { follow } => Request::Events { follow },
            Command::Trace { length } => Request::Trace(length),
        })
    }
}

/// Does what the command line says.
///
/// # Errors
/// See [`ClientError`].
pub fn run(Cli { json, place, command }: Cli) -> Result<(), ClientError> {
    let requests = command.requests()?;
    let mut takt = Connection::open(&takt_client::socket(&place)?)?;
    let Some((last, first)) = requests.split_last() else { return Ok(()) };
    for request in first {
        takt.send(request)?;
        takt.receive()?.1.granted()?;
    }
    ask(&mut takt, last.clone(), json)
}

fn ask(takt: &mut Connection, request: Request, json: bool) -> Result<(), ClientError> {
    match request {
        Request::Trace(length) => {
            let extent = trace::record(takt, length, json, io::stdout().lock())?;
            // Without a reader, the file is whole all the same.
            let _ = writeln!(io::stderr(), "takt-ctl: {}", text::extent(extent));
        }
        Request::Events { follow: true } => {
            takt.send(&Request::Events { follow: true })?;
            print(takt.receive()?, json)?;
            takt.wait_for_ever()?;
            loop {
                print(takt.receive()?, json)?;
            }
        }
        request => {
            takt.send(&request)?;
            print(takt.receive()?, json)?;
        }
    }
    Ok(())
}

fn print((line, answer): (String, Answer), json: bool) -> Result<(), ClientError> {
    let shown = if json { line } else { text::of(&answer) };
    let mut out = io::stdout().lock();
    // A reader that has had enough ends it, as with any filter.
    out.write_all(shown.as_bytes()).and_then(|()| out.flush()).map_err(ClientError::Output)?;
    answer.granted()?;
    Ok(())
}
