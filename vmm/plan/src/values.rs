//! The rules for single values of a partition: each within its bounds, whatever the others are.

use takt_abi::memory::{IMAGE_BASE, PAGE, RAM_MAX};
use takt_scheduler::table::{Cpu, GUARD_MAX};
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::units::{Bytes, Duration};
use super::{Kind, ScheduleChange};

/// CPU numbers end here: `cpu_set_t` of the C library, which carries the affinity, has 1024 bits.
const CPUS: usize = 1024;
/// A PLC's memory: its image needs at least a page above the structures that start its vCPU.
const PLC_MEMORY: [Bytes; 2] = [Bytes(IMAGE_BASE + PAGE), Bytes(RAM_MAX)];
/// A Linux's memory: below, a distribution's kernel does not unpack; above, it is a typing mistake.
const LINUX_MEMORY: [Bytes; 2] = [Bytes(64 << 20), Bytes(64 << 30)];
const SECOND: Nanos = Nanos::from_millis(1_000);
/// What a watchdog may wait for. Linux counts in seconds, and needs some to start; above, it is none.
const WATCHDOG: [Nanos; 2] = [SECOND, Nanos::from_millis(86_400_000)];
/// Longest name of a group of users, as of useradd(8).
const GROUP_NAME_MAX: usize = 32;
/// Longest time that a Linux can be given to switch itself off; above, it is a typing mistake.
const POWER_OFF_MAX: Nanos = Nanos::from_millis(3_600_000);
/// Longest command line that an x86 kernel keeps: `COMMAND_LINE_SIZE` in `asm/setup.h`, less the
/// NUL.
pub const CMDLINE_MAX: usize = 2047;

pub fn guard(length: Nanos, span: &Span, frame: &Spanned<Duration>) -> Result<Nanos, Diagnostic> {
    let longest = GUARD_MAX.min(frame.get_ref().0.less(Nanos(1)));
    if length > longest {
        let found = format!("the release guard of {length} is too long");
        let allowed = format!("\"auto\", or \"0us\" to {GUARD_MAX}, and less than the major frame");
        return Err(Diagnostic::new(span.clone(), found, allowed));
    }
    Ok(length)
}

pub fn cpu(cpu: &Spanned<i64>, host: Option<usize>) -> Result<Cpu, Diagnostic> {
    let number = *cpu.get_ref();
    match usize::try_from(number).ok().filter(|n| *n < CPUS) {
        Some(n) if host.is_none_or(|count| n < count) => Ok(Cpu(n)),
        Some(n) => {
            let last = host.unwrap_or(CPUS).saturating_sub(1);
            let found = format!("CPU {n} does not exist on this machine");
            let allowed = format!("0 to {last}, the CPUs of this machine");
            Err(Diagnostic::new(cpu.span(), found, allowed))
        }
        None => {
            let found = format!("{number} is not the number of a CPU");
            let allowed = format!("0 to {}", CPUS - 1);
            Err(Diagnostic::new(cpu.span(), found, allowed))
        }
    }
}

pub fn schedule_change(change: Option<&Spanned<String>>) -> Result<ScheduleChange, Diagnostic> {
    let Some(change) = change else { return Ok(ScheduleChange::Ignore) };
    match change.get_ref().as_str() {
        "ignore" => Ok(ScheduleChange::Ignore),
        "warm" => Ok(ScheduleChange::Warm),
        "cold" => Ok(ScheduleChange::Cold),
        other => {
            let found = format!("there is no action {} for a switch of schedules", quote(other));
            Err(Diagnostic::new(change.span(), found, "\"ignore\", \"warm\" or \"cold\""))
        }
    }
}

/// Checks how long a watchdog waits, that of a partition or the host's.
pub fn watchdog(watchdog: &Spanned<Duration>) -> Result<Nanos, Diagnostic> {
    let time = watchdog.get_ref().0;
    if time < WATCHDOG[0] || time > WATCHDOG[1] {
        let found = format!("a watchdog that waits {time} for a heartbeat");
        let allowed = format!("{} to {}", WATCHDOG[0], WATCHDOG[1]);
        return Err(Diagnostic::new(watchdog.span(), found, allowed));
    }
    Ok(time)
}

/// Checks how long the host's watchdog waits, to which Linux tells whole seconds (`WDIOC_SETTIMEOUT`).
pub fn host_watchdog(wait: &Spanned<Duration>) -> Result<Nanos, Diagnostic> {
    let time = watchdog(wait)?;
    if time.0 % SECOND.0 != 0 {
        let found = format!("{time}, and the host's watchdog counts in seconds");
        let allowed = format!("a whole number of seconds, {} to {}", WATCHDOG[0], WATCHDOG[1]);
        return Err(Diagnostic::new(wait.span(), found, allowed));
    }
    Ok(time)
}

/// The group of users who may look at the control socket, if there is one: its name, or its number.
pub fn viewers(group: &Spanned<String>, socket: bool) -> Result<String, Diagnostic> {
    let name = group.get_ref();
    let rest = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if name.is_empty() || name.len() > GROUP_NAME_MAX || !name.chars().all(rest) {
        let found = format!("{} is no name of a group of users", quote(name));
        let allowed = format!("1 to {GROUP_NAME_MAX} letters, digits, \"_\", \"-\" and \".\"");
        return Err(Diagnostic::new(group.span(), found, allowed));
    }
    if !socket {
        let found = "who may look at the control socket, and there is none";
        let allowed = "`viewers` beside the key `control`";
        return Err(Diagnostic::new(group.span(), found, allowed));
    }
    Ok(name.clone())
}

/// How long a Linux has to switch itself off.
pub fn power_off(power_off: Option<&Spanned<Duration>>) -> Result<Nanos, Diagnostic> {
    let Some(power_off) = power_off else { return Ok(Nanos::ZERO) };
    let time = power_off.get_ref().0;
    if time > POWER_OFF_MAX {
        let found = format!("{time} is too long to wait for a power-off");
        let allowed = format!("\"0s\", to be stopped at once, to {POWER_OFF_MAX}");
        return Err(Diagnostic::new(power_off.span(), found, allowed));
    }
    Ok(time)
}

pub fn memory(memory: &Spanned<Bytes>, kind: &Kind) -> Result<Bytes, Diagnostic> {
    let size = *memory.get_ref();
    let ([min, max], name) = match kind {
        Kind::Plc { .. } => (PLC_MEMORY, "plc"),
        Kind::Linux { .. } => (LINUX_MEMORY, "linux"),
    };
    let error = |found| {
        let page = Bytes(PAGE);
        let allowed = format!("a multiple of {page} from {min} to {max} for a \"{name}\"");
        Err(Diagnostic::new(memory.span(), found, allowed))
    };
    if size < min {
        error(format!("the memory of {size} is too small"))
    } else if size > max {
        error(format!("the memory of {size} is too large"))
    } else if !size.0.is_multiple_of(PAGE) {
        error(format!("the memory of {size} is not a whole number of pages"))
    } else {
        Ok(size)
    }
}

pub fn cmdline(cmdline: &Spanned<String>) -> Result<String, Diagnostic> {
    let text = cmdline.get_ref();
    let error = |found: String| {
        let allowed = format!("at most {CMDLINE_MAX} bytes, without control characters");
        Err(Diagnostic::new(cmdline.span(), found, allowed))
    };
    if text.len() > CMDLINE_MAX {
        return error(format!("the command line has {} bytes", text.len()));
    }
    match text.chars().find(|c| c.is_control()) {
        Some(c) => error(format!("the command line has the control character {c:?}")),
        None => Ok(text.clone()),
    }
}
