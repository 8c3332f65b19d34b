//! `takt plc`: makes, inspects, signs and tests control programs.
//!
//! One file of `commands` for each subcommand. What they do lies in `link` (from object files to an image),
//! `run` (an image on this machine) and `takt-program` (the image itself).

/// `eprintln!`, but what cannot be written is left out: the status tells the same, and a panic would take it away.
macro_rules! tell {
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($words)*);
    }};
}

mod commands;
mod link;
mod live;
mod run;
mod shadow;
mod table;
mod value;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// A compiler makes many small objects, on several threads. With this allocator, which uses large pages, a build takes a
/// third less time than with that of the C library.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Exit statuses; `--help` tells them.
mod status {
    pub const GOOD: u8 = 0;
    pub const NOT_AS_EXPECTED: u8 = 1;
    pub const BAD_INPUT: u8 = 2;
    pub const PROGRAM_FAILED: u8 = 3;
    pub const HOST_CANNOT: u8 = 4;
    pub const REFUSED: u8 = 5;
    pub const NO_TAKT: u8 = 6;
}

const AFTER_HELP: &str = "\
Exit status:
  0 good
  1 not as expected: a test failed (`test`), an image has no signature by the keys given (`verify`), a part of
    a project was refused (`import`), a source is not formatted (`fmt --check`), a change needs a restart
    (`diff`, `shadow`), an output is out of tolerance (`shadow`), an editor left without `shutdown` (`lsp`)
  2 a file or this command line is wrong
  3 the program faulted, stopped itself or did not end
  4 this machine cannot do it
  5 Takt refuses, or a change of a running program was not made or is not kept
  6 no Takt answers";

/// Makes, inspects, signs and tests control programs.
#[derive(Parser)]
#[command(name = "takt plc", version, after_help = AFTER_HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Begin a new program in a new folder.
    New(commands::new::New),
    /// Take the Structured Text of a PLCopen XML project.
    Import(commands::import::Import),
    /// Check sources in Structured Text without building them.
    Check(commands::check::Check),
    /// Format sources in Structured Text: white space and the case of keywords.
    Fmt(commands::fmt::Fmt),
    /// Serve an editor: the language server of Structured Text, on the standard input and output.
    Lsp(commands::lsp::Lsp),
    /// Make a program image of Structured Text, or of object files and static libraries.
    Build(commands::build::Build),
    /// Run the tests of a project on this machine, or an image cycle by cycle against a table.
    Test(commands::test::Test),
    /// Show what is in an image; of Structured Text, how many instructions its tasks take at most.
    Inspect(commands::inspect::Inspect),
    /// Compare two versions of a program: what a change of the running one would keep, and whether it can be made.
    Diff(commands::diff::Diff),
    /// Check that an image is whole and, if keys are given, signed by one of them.
    Verify(commands::verify::Verify),
    /// Sign an image.
    Sign(commands::sign::Sign),
    /// Make a pair of keys for signing.
    Keygen(commands::keygen::Keygen),
    /// List the values of a PLC's programs by name.
    Points(commands::live::Points),
    /// Show values of a PLC that runs; those of a line are from one cycle.
    Watch(commands::live::Watch),
    /// Record values of a PLC that runs in each cycle, from a trigger on, into a file.
    Record(commands::record::Record),
    /// Write a value of a PLC that runs, once.
    Write(commands::live::Put),
    /// Keep a value of a PLC that runs, until it is released or the PLC starts anew.
    Force(commands::live::Put),
    /// Force values no longer.
    Release(commands::live::Release),
    /// Bring another version of a program into a PLC that runs; the running one goes on.
    Load(commands::versions::Load),
    /// Show which versions the programs of a PLC that runs have, and how far a change is.
    Versions(commands::versions::Versions),
    /// Run a new version here beside the one that runs in a PLC, on the same inputs, and compare the outputs.
    Shadow(commands::shadow::Shadow),
    /// Change a program to the version that was loaded, between two of its cycles; the next start begins with it.
    Commit(commands::versions::Order),
    /// Change a program back, or give up the version that was loaded.
    #[command(alias = "roll-back")]
    Rollback(commands::versions::Order),
    /// Have the next start begin with the version that runs, where `commit` has not.
    Keep(commands::keep::Keep),
}

/// What a command ends with, if not well: the message has been made for the user.
struct Failure {
    status: u8,
    message: String,
}

impl Failure {
    /// A file or an argument is bad.
    fn input(message: impl ToString) -> Self {
        Self { status: status::BAD_INPUT, message: message.to_string() }
    }
}

/// What a shell tells of a process that SIGPIPE ended.
const READER_GONE: i32 = 128 + libc::SIGPIPE;

/// Ends the process without a word when its output has no reader any more, as in `takt plc inspect tank.plc | head`.
/// The signal SIGPIPE, which does so elsewhere, would end it for a lost connection to Takt, too.
fn end_with_the_reader() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let text = panic.payload_as_str().unwrap_or_default();
        if text.starts_with("failed printing to ") && text.contains("Broken pipe") {
            std::process::exit(READER_GONE);
        }
        if text.starts_with("failed printing to ") {
            tell!("takt plc: {text}");
            std::process::exit(status::HOST_CANNOT.into());
        }
        usual(panic);
    }));
}

fn main() -> ExitCode {
    end_with_the_reader();
    let result = match Cli::parse().command {
        Command::New(command) => command.run(),
        Command::Import(command) => command.run(),
        Command::Check(command) => command.run(),
        Command::Fmt(command) => command.run(),
        Command::Lsp(command) => command.run(),
        Command::Build(command) => command.run(),
        Command::Test(command) => command.run(),
        Command::Inspect(command) => command.run(),
        Command::Diff(command) => command.run(),
        Command::Verify(command) => command.run(),
        Command::Sign(command) => command.run(),
        Command::Keygen(command) => command.run(),
        Command::Points(command) => command.run(),
        Command::Watch(command) => command.run(),
        Command::Record(command) => command.run(),
        Command::Write(command) => command.write(),
        Command::Force(command) => command.force(),
        Command::Release(command) => command.run(),
        Command::Load(command) => command.run(),
        Command::Versions(command) => command.run(),
        Command::Shadow(command) => command.run(),
        Command::Commit(command) => command.commit(),
        Command::Rollback(command) => command.roll_back(),
        Command::Keep(command) => command.run(),
    };
    match result {
        Ok(()) => ExitCode::from(status::GOOD),
        Err(Failure { status, message }) => {
            tell!("takt plc: {message}");
            ExitCode::from(status)
        }
    }
}
