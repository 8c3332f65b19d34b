//! On which CPUs a partition runs: one, or for a Linux one for each of its processors.

use takt_scheduler::table::Cpu;

use super::diagnostic::{Diagnostic, Span, quote};
use super::raw;
use super::values;

/// Most processors of a Linux. All have numbers that its interrupt controllers can send to.
pub const PROCESSORS_MAX: usize = 64;

/// The CPUs of a partition: the first, and those of a Linux's further processors.
pub fn check(
    raw: &raw::Partition,
    header: Span,
    host: Option<usize>,
) -> Result<(Cpu, Vec<Cpu>), Diagnostic> {
    let list = match (&raw.cpu, &raw.cpus) {
        (Some(cpu), None) => return Ok((values::cpu(cpu, host)?, Vec::new())),
        (None, Some(list)) => list,
        (None, None) => {
            let found = format!("partition {} has no key `cpu`", quote(raw.name.get_ref()));
            let allowed = "`cpu = 0`, or `cpus = [0, 1]` for a Linux with several processors";
            return Err(Diagnostic::new(header, found, allowed));
        }
        (Some(cpu), Some(list)) => {
            let found = format!("{} has both `cpu` and `cpus`", quote(raw.name.get_ref()));
            let allowed = "either: `cpu` for one processor, `cpus` for one on each CPU of a list";
            return Err(Diagnostic::new(list.span(), found, allowed).and(cpu.span(), "the other"));
        }
    };
    if raw.kind.get_ref() == "plc" {
        let found = format!("{} is a PLC and has a list of CPUs", quote(raw.name.get_ref()));
        let allowed = "`cpu = 0`: a PLC has one processor, since its windows are times on one CPU";
        return Err(Diagnostic::new(list.span(), found, allowed));
    }
    let allowed = format!("1 to {PROCESSORS_MAX} CPUs, a processor of the Linux on each");
    let numbers = list.get_ref();
    if let Some(excess) = numbers.get(PROCESSORS_MAX) {
        let found = format!("this is CPU {} of {} in the list", PROCESSORS_MAX + 1, numbers.len());
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut cpus: Vec<Cpu> = Vec::with_capacity(numbers.len());
    for number in numbers {
        let next = values::cpu(number, host)?;
        if let Some(same) = cpus.iter().position(|cpu| *cpu == next) {
            let found = format!("CPU {} is in the list twice", next.0);
            let allowed =
                "each CPU once: two processors of one Linux on a CPU would wait for each other";
            return Err(Diagnostic::new(number.span(), found, allowed)
                .and(numbers[same].span(), "the first time"));
        }
        cpus.push(next);
    }
    if cpus.len() > 1 && !raw.background.as_ref().is_some_and(|it| *it.get_ref()) {
        let found = format!("{} has windows and several processors", quote(raw.name.get_ref()));
        let allowed = "`background = true`, or one CPU: a window is a time on one CPU, and a processor \
                       that is outside of its window holds locks that others wait for";
        return Err(Diagnostic::new(list.span(), found, allowed));
    }
    match cpus.split_first() {
        None => Err(Diagnostic::new(list.span(), "the list of CPUs is empty", allowed)),
        Some((first, further)) => Ok((*first, further.to_vec())),
    }
}
