//! The command line.

mod subcommand;

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::{Parser, Subcommand};
use takt::appliance::Role;
use takt::config::{self, Partition, PartitionFile};
use takt::hooks::Hooks;
use takt::passthrough::resources;
use takt::run::{Options, duration};
use takt::sandbox::{Mode, descriptors};
use takt::terminal::tell;
use takt::{appliance, check, probe, run};

/// Exit statuses; `--help` tells them.
mod status {
    pub const GOOD: u8 = 0;
    pub const BAD_FILE_OR_USAGE: u8 = 2;
    pub const HOST_CANNOT: u8 = 3;
    pub const PARTITION_FAILED: u8 = 4;
    /// What a shell tells of a process that the signal SIGPIPE ended.
    pub const READER_GONE: u8 = 128 + 13;
}

const AFTER_HELP: &str = "\
Exit status: 0 good; 2 bad partition file or usage; 3 the host cannot; 4 a partition failed;
5 Takt has made a system call that it may not make.
The console is Linux's: Ctrl-] q ends the run, Ctrl-] s asks for the next schedule,
Ctrl-] Ctrl-] types Ctrl-].";

const BESIDE_HELP: &str = "\
Programs of their own, in the folder of takt:
  ctl     Ask a running takt how it stands, and tell it what to do
  doctor  Say whether this host can keep the promises of a partition file
  top     Show the load of partitions and CPUs of a running takt, like top(1)
  console Show the console of a partition, and type at it
  shell   Log into a Linux partition without a network
  copy    Copy files to and from a Linux partition without a network
  plc     Make, inspect, sign and test control programs
  jitter  Measure how punctual the partitions of a file are, under a load";

/// A PLC and an unmodified Linux side by side on one machine, neither trusting the other.
#[derive(Parser)]
#[command(name = "takt", version, after_help = format!("{BESIDE_HELP}\n\n{AFTER_HELP}"))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the partitions of a file.
    #[command(after_help = AFTER_HELP)]
    Run(Box<Run>),
    /// Check a partition file and draw its major frame.
    Check {
        /// The partition file.
        file: PathBuf,
        /// Print what scripts have to provide: memory in bytes, number of CPUs, files.
        #[arg(long)]
        needs: bool,
    },
    /// Tell whether this host's KVM runs guest kernels at hardware speed.
    Probe {
        /// Print one JSON object on one line instead, with all that machines can tell of KVM.
        #[arg(long)]
        json: bool,
    },
    #[command(external_subcommand)]
    Beside(Vec<OsString>),
}

#[derive(clap::Args)]
struct Run {
    /// The partition file.
    file: PathBuf,
    /// End by itself after this time, such as 10s or 500ms.
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    duration: Option<Duration>,
    /// Write the report to this file as JSON.
    #[arg(long, value_name = "OUT.json")]
    report: Option<PathBuf>,
    /// Write every window to this file, for ui.perfetto.dev or chrome://tracing.
    #[arg(long, value_name = "OUT.json")]
    trace: Option<PathBuf>,
    /// Write a summary of all releases to this file, from which `takt jitter render` draws its page.
    #[arg(long, value_name = "OUT.json")]
    samples: Option<PathBuf>,
    /// Add words to the kernel command line of the file's Linux.
    #[arg(long, value_name = "WORDS")]
    append: Vec<String>,
    /// Make the control socket here, instead of where the file says.
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
    /// Name of the environment in which Takt runs, for the report.
    #[arg(long, default_value = "direct")]
    lane: String,
    /// Name of the emulator that this machine is, for the report.
    #[arg(long, value_name = "TEXT")]
    emulator: Option<String>,
    /// For development: what follows from a system call that a thread may not make.
    #[arg(long, hide = true, value_name = "enforce|log", default_value = "enforce")]
    seccomp: Mode,
    #[command(flatten)]
    hooks: Hooks,
}

impl Run {
    fn run(self, role: Role) -> u8 {
        let began = Instant::now();
        // SAFETY: no other thread has been started. What prints a backtrace opens files, which no thread may.
        unsafe { std::env::remove_var("RUST_BACKTRACE") };
        if let Err(error) = descriptors::close_inherited() {
            tell(format_args!(
                "takt: cannot close what is open: {error}; Linux 5.16 or newer is needed"
            ));
            return status::HOST_CANNOT;
        }
        let Run { file, append, .. } = &self;
        with_file(file, Some(host_cpus()), |mut file| {
            for words in append {
                if let Err(error) = file.append(words) {
                    tell(format_args!("takt: {error}"));
                    return status::BAD_FILE_OR_USAGE;
                }
            }
            run_partitions(&file, &self.options(began, role))
        })
    }

    fn options(&self, began: Instant, role: Role) -> Options {
        Options {
            role,
            duration: self.duration,
            began: Some(began),
            report: self.report.clone(),
            trace: self.trace.clone(),
            samples: self.samples.clone(),
            control: self.control.clone(),
            lane: self.lane.clone(),
            emulator: self.emulator.clone(),
            seccomp: self.seccomp,
            hooks: self.hooks.clone(),
        }
    }
}

fn main() -> ExitCode {
    let role = Role::of_this_process();
    let arguments = appliance::arguments(role);
    if role == Role::PidOne {
        appliance::main(&arguments)
    }
    ExitCode::from(command_line(&arguments, role))
}

fn command_line(arguments: &[OsString], role: Role) -> u8 {
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(answer) => {
            // Help and version are answers, everything else is wrong usage.
            let status = if answer.use_stderr() { status::BAD_FILE_OR_USAGE } else { status::GOOD };
            let _ = answer.print();
            return status;
        }
    };
    match cli.command {
        Command::Beside(words) => {
            tell(format_args!("takt: {}", subcommand::run(&words)));
            status::BAD_FILE_OR_USAGE
        }
        Command::Run(run) => run.run(role),
        Command::Check { file, needs: true } => {
            with_file(&file, None, |file| print(check::needs(&file), status::GOOD))
        }
        Command::Check { file, needs: false } => {
            with_file(&file, Some(host_cpus()), |file| check(&file))
        }
        Command::Probe { json: true } => match serde_json::to_string(&probe::examine()) {
            Ok(text) => print(text + "\n", status::GOOD),
            Err(error) => {
                tell(format_args!("takt: cannot print what was found: {error}"));
                status::HOST_CANNOT
            }
        },
        Command::Probe { json: false } => match probe::probe() {
            Ok(speed) => {
                let status = if speed.is_hardware() { status::GOOD } else { status::HOST_CANNOT };
                print(format!("{speed}\n"), status)
            }
            Err(error) => print(format!("no usable KVM: {error}\n"), status::HOST_CANNOT),
        },
    }
}

/// Draws a file, and says whether it has numbers on which this host runs; the exit status. The file may be for another one.
fn check(file: &PartitionFile) -> u8 {
    let status = print(check::report(file), status::GOOD);
    match file.partitions().iter().map(Partition::passthrough).try_for_each(resources::check) {
        Ok(()) => status,
        Err(error) => {
            tell(format_args!("takt: this host cannot run {}: {error}", file.path().display()));
            status::HOST_CANNOT
        }
    }
}

/// Prints an answer; the exit status. A reader that goes, as in `takt check FILE | head`, is told nothing.
fn print(answer: impl Display, status: u8) -> u8 {
    let mut out = io::stdout().lock();
    match write!(out, "{answer}").and_then(|()| out.flush()) {
        Ok(()) => status,
        Err(error) if error.kind() == ErrorKind::BrokenPipe => status::READER_GONE,
        Err(error) => {
            tell(format_args!("takt: cannot print: {error}"));
            status::HOST_CANNOT
        }
    }
}

fn with_file(
    path: &std::path::Path,
    host_cpus: Option<usize>,
    then: impl FnOnce(PartitionFile) -> u8,
) -> u8 {
    match config::load(path, host_cpus) {
        Ok(file) => then(file),
        Err(error) => {
            tell(error);
            status::BAD_FILE_OR_USAGE
        }
    }
}

fn run_partitions(file: &PartitionFile, options: &Options) -> u8 {
    match run::run(file, options) {
        Ok(report) => {
            let failed = report.partitions.iter().any(|p| p.failed);
            if failed { status::PARTITION_FAILED } else { status::GOOD }
        }
        Err(error) => {
            tell(format_args!("takt: {error}"));
            if error.is_users() { status::BAD_FILE_OR_USAGE } else { status::HOST_CANNOT }
        }
    }
}

/// Number of CPUs that the host has configured, whether or not this process may use them.
fn host_cpus() -> usize {
    // SAFETY: asks for a number.
    let count = unsafe { libc::sysconf(libc::_SC_NPROCESSORS_CONF) };
    usize::try_from(count).unwrap_or(1).max(1)
}
