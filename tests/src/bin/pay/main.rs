//! What Linux pays for running as a guest: the calls that the paper on the coexistence of a softPLC
//! and Linux (Kaiser, Wagner, Zuepke) measured on its microkernel, and the time of any command.
//!
//! ```text
//! pay calls                   each call's least and average time
//! pay time ROUNDS COMMAND...  each round's time of a command
//! pay become COMMAND...       tells the instant, and becomes the command
//! ```
//!
//! To be run on a machine and in a guest on it, and compared. Times are in ticks of the time-stamp
//! counter, which host and guests of Takt share; in the lab a tick is an instruction, and those of
//! the hypervisor count too.
//!
//! A program's start is where a guest pays most, and for one instruction: CPUID, which always leaves
//! the guest, and which the C library executes dozens of times to learn what processor it is on. So
//! that it can be seen and not only said, this counts them in a start of itself, measures one, and
//! also starts a program without a C library.

mod process;

use std::arch::x86_64::{__cpuid, _rdtsc};
use std::ffi::CString;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};

use process::Program;

/// Rounds of each measurement, the best of which counts: the others have an interrupt in them.
const ROUNDS: u32 = 5;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        // What the measurement starts.
        ["nothing"] => return ExitCode::SUCCESS,
        ["calls"] => calls(),
        ["time", rounds, command @ ..] => match rounds.parse() {
            Ok(rounds) => time(rounds, command),
            Err(_) => return usage(),
        },
        ["become", command @ ..] => become_command(command),
        _ => return usage(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("pay: {error}");
            ExitCode::FAILURE
        }
    }
}

fn usage() -> ExitCode {
    eprintln!("usage: pay calls | pay time ROUNDS COMMAND... | pay become COMMAND...");
    ExitCode::from(64)
}

fn calls() -> io::Result<()> {
    let this = CString::new("/proc/self/exe").map_err(io::Error::other)?;
    let this = Program::new(this, &[c"pay", c"nothing"]);
    let bare = Program::without_library()?;
    let mut lines = Vec::new();
    let mut row = |name: &str, count: u32, call: &dyn Fn() -> io::Result<()>| {
        let (least, average) = measure(count, call)?;
        lines.push(format!("pay: {name} {least} {average}"));
        io::Result::Ok(())
    };
    row("getpid", 1000, &|| {
        process::getpid();
        Ok(())
    })?;
    row("fork+exit", 20, &|| process::forked(None))?;
    row("vfork+exit", 20, &|| process::vforked(None))?;
    row("fork+execve", 20, &|| process::forked(Some(&this)))?;
    row("vfork+execve", 20, &|| process::vforked(Some(&this)))?;
    row("vfork+execve-bare", 20, &|| process::vforked(Some(&bare)))?;
    row("cpuid", 100, &|| {
        std::hint::black_box(__cpuid(0));
        Ok(())
    })?;
    lines.push(format!("pay: cpuids-of-a-start {0} {0}", process::cpuids_of_a_start(&this)?));
    // All at the end: the console is slow.
    println!("{}", lines.join("\n"));
    Ok(())
}

/// Ticks of one call: of the best round, and of all on average.
fn measure(count: u32, call: &dyn Fn() -> io::Result<()>) -> io::Result<(u64, u64)> {
    let (mut least, mut sum) = (u64::MAX, 0);
    for _ in 0..ROUNDS {
        let begin = now();
        for _ in 0..count {
            call()?;
        }
        let each = (now() - begin) / u64::from(count);
        least = least.min(each);
        sum += each;
    }
    Ok((least, sum / u64::from(ROUNDS)))
}

fn time(rounds: u32, command: &[&str]) -> io::Result<()> {
    let [program, arguments @ ..] = command else {
        return Err(io::Error::other("no command to time"));
    };
    for round in 1..=rounds {
        let begin = now();
        let status = Command::new(program).args(arguments).status()?;
        let ticks = now() - begin;
        if !status.success() {
            return Err(io::Error::other(format!("{program} failed: {status}")));
        }
        println!("pay: time-{round} {ticks} {ticks}");
    }
    Ok(())
}

fn become_command(command: &[&str]) -> io::Result<()> {
    let [program, arguments @ ..] = command else {
        return Err(io::Error::other("no command to become"));
    };
    println!("pay: become {0} {0}", now());
    Err(Command::new(program).args(arguments).exec())
}

fn now() -> u64 {
    // SAFETY: every x86-64 processor has the instruction, and it is not disabled here.
    unsafe { _rdtsc() }
}
