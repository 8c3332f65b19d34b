//! `takt-ctl`: asks a running Takt, tells it what to do, and shows what it does.
//!
//! It is a program of its own so that what it needs (a terminal library and sixty crates below it)
//! is no part of `takt`, which runs as root and keeps partitions apart. All that it can do goes
//! through the control socket, as for everybody else.

mod connection;
mod error;
mod place;
mod text;
mod top;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use takt::control::protocol::{Answer, Mode, Request};

use connection::Connection;
use error::CtlError;

const AFTER_HELP: &str = "\
Exit status: 0 done; 1 Takt refuses; 2 wrong usage or partition file; 3 no Takt answers there.";

/// Asks a running Takt, and tells it what to do.
#[derive(Parser)]
#[command(name = "takt-ctl", version, after_help = AFTER_HELP)]
struct Cli {
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
    /// A screen that shows all of it, twice a second. `q` leaves it.
    Top,
}

#[derive(clap::Args)]
#[group(multiple = false)]
struct StartMode {
    /// Keep nothing (the default).
    #[arg(long)]
    cold: bool,
    /// Keep what the partition retains.
    #[arg(long)]
    warm: bool,
}

#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct GivenMode {
    /// Keep nothing.
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
    /// The request; `None` for the screen, which makes several.
    fn request(self) -> Option<Request> {
        Some(match self {
            Command::Status => Request::Status,
            Command::Stop { partition } => Request::Stop(partition),
            Command::Start { partition, mode: m } => Request::Start(partition, mode(m.warm)),
            Command::Restart { partition, mode: m } => Request::Restart(partition, mode(m.warm)),
            Command::Schedule { name } => Request::Schedule(name),
            Command::Events { follow } => Request::Events { follow },
            Command::Top => return None,
        })
    }
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            let status = if answer.use_stderr() { error::USAGE } else { 0 };
            let _ = answer.print();
            return ExitCode::from(status);
        }
    };
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(error.status())
        }
    }
}

fn run(Cli { json, place, command }: Cli) -> Result<(), CtlError> {
    let socket = place::socket(&place)?;
    let Some(request) = command.request() else { return top::run(&socket) };
    let mut takt = Connection::open(&socket)?;
    takt.send(&request)?;
    print(&takt.receive()?, json)?;
    if request == (Request::Events { follow: true }) {
        takt.wait_for_ever()?;
        loop {
            print(&takt.receive()?, json)?;
        }
    }
    Ok(())
}

fn print((line, answer): &(String, Answer), json: bool) -> Result<(), CtlError> {
    use std::io::Write;
    let shown = if json { line.clone() } else { text::of(answer) };
    let mut out = std::io::stdout().lock();
    // A reader that has had enough ends it, as with any filter.
    out.write_all(shown.as_bytes()).and_then(|()| out.flush()).map_err(CtlError::Output)?;
    match answer {
        Answer::Error(refusal) => Err(CtlError::Refused(refusal.clone())),
        _ => Ok(()),
    }
}
