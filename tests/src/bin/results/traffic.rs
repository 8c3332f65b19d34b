//! What a disk and a network take under each VMM, on the same host and with the same guest.

use std::fmt::Write;

use crate::Measured;

/// Names of the script's, and what they are.
const VMMS: [(&str, &str); 7] = [
    ("takt", "Takt"),
    ("qemu-pci", "QEMU"),
    ("qemu-pci-iothread", "QEMU, iothread, io_uring"),
    ("qemu-mmio", "QEMU, microvm"),
    ("alioth", "Alioth"),
    ("takt-batch", "Takt, no preemption"),
    ("takt-napi", "Takt, `napi_tx=0`"),
];

/// A step of the script's, and what one of its units is.
struct Step {
    name: &'static str,
    label: &'static str,
}

const STEPS: [Step; 9] = [
    Step { name: "net-in", label: "iperf3, host to guest, MiB" },
    Step { name: "net-out", label: "iperf3, guest to host, MiB" },
    Step { name: "randread-1", label: "fio, 4 KiB at random, read, depth 1, request" },
    Step { name: "randwrite-1", label: "the same, written" },
    Step { name: "randread-16", label: "fio, 4 KiB at random, read, depth 16, request" },
    Step { name: "randwrite-16", label: "the same, written" },
    Step { name: "read", label: "fio, 1 MiB in a row, read, MiB" },
    Step { name: "write", label: "the same, written" },
    Step { name: "idle", label: "a second without anything to do" },
];

/// Those of which the counts say something; what is written differs little from what is read.
const COUNTED: [&str; 5] = ["net-in", "net-out", "randread-1", "randread-16", "read"];

/// What is counted, in the order of the script's lines.
const COUNTS: usize = 9;
const INSTRUCTIONS: usize = 0;
const SHOWN: [(usize, &str); 5] = [
    (1, "exits"),
    (2, "of them to the VMM, for registers"),
    (4, "halts"),
    (5, "switches between threads"),
    (6, "interrupts of the guest"),
];

/// A line of the script's.
struct Line<'a> {
    vmm: &'a str,
    step: &'a str,
    amount: i64,
    counts: [i64; COUNTS],
}

impl<'a> Line<'a> {
    fn parse(line: &'a str) -> Option<Line<'a>> {
        let mut words = line.strip_prefix("io: ")?.split_whitespace();
        let (vmm, step) = (words.next()?, words.next()?);
        let amount = words.next()?.parse().ok()?;
        let mut counts = [0; COUNTS];
        for count in &mut counts {
            *count = words.next()?.parse().ok()?;
        }
        Some(Line { vmm, step, amount, counts })
    }
}

/// What the large amount took more than the small one, for each unit that it has more: a start and an end, which both
/// have, is in neither.
fn per_unit(lines: &[Line<'_>], vmm: &str, step: &str) -> Option<[f64; COUNTS]> {
    let mut of = lines.iter().filter(|line| line.vmm == vmm && line.step == step);
    let (small, large) = (of.next()?, of.next()?);
    let units = large.amount - small.amount;
    let mut taken = [0.0; COUNTS];
    for (n, taken) in taken.iter_mut().enumerate() {
        *taken = (large.counts[n] - small.counts[n]) as f64 / units as f64;
    }
    (units > 0).then_some(taken)
}

/// The VMMs that were measured.
fn vmms(lines: &[Line<'_>]) -> Vec<(&'static str, &'static str)> {
    VMMS.into_iter().filter(|(name, _)| lines.iter().any(|line| line.vmm == *name)).collect()
}

/// Instructions.
pub fn table(measured: &Measured) -> Option<String> {
    let text = measured.text("io.log")?;
    let lines: Vec<Line<'_>> = text.lines().filter_map(Line::parse).collect();
    let vmms = vmms(&lines);
    let mut table = "| instructions for each |".to_owned();
    for (_, label) in &vmms {
        let _ = write!(table, " {label} |");
    }
    table += "\n| --- |";
    table += &" --- |".repeat(vmms.len());
    for Step { name, label } in STEPS {
        let _ = write!(table, "\n| {label} |");
        for (vmm, _) in &vmms {
            let _ = write!(table, " {:.0} |", per_unit(&lines, vmm, name)?[INSTRUCTIONS]);
        }
    }
    table.push('\n');
    for (vmm, label) in &vmms {
        let verified = format!("io: {vmm} verify 0");
        if !text.lines().any(|line| line == verified) {
            eprintln!("results: what fio wrote under {label} was not what it read");
            return None;
        }
    }
    Some(table)
}

/// What the instructions went to.
pub fn counts(measured: &Measured) -> Option<String> {
    let text = measured.text("io.log")?;
    let lines: Vec<Line<'_>> = text.lines().filter_map(Line::parse).collect();
    let mut table = "| for each | |".to_owned();
    for (_, label) in SHOWN {
        let _ = write!(table, " {label} |");
    }
    table += "\n| --- | --- |";
    table += &" --- |".repeat(SHOWN.len());
    for Step { name, label } in STEPS.into_iter().filter(|step| COUNTED.contains(&step.name)) {
        for (vmm, vmm_label) in vmms(&lines) {
            let counts = per_unit(&lines, vmm, name)?;
            let _ = write!(table, "\n| {label} | {vmm_label} |");
            for (count, _) in SHOWN {
                let _ = write!(table, " {:.1} |", counts[count].max(0.0));
            }
        }
    }
    Some(table + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_takes_what_the_larger_amount_takes_more() {
        let text = "io: takt read 32 1000 10 2 0 0 5 4 32 65536\r\nnoise\n\
                    io: takt read 96 7400 74 2 0 64 5 4 96 196608\nio: takt verify 0\n";
        let lines: Vec<Line<'_>> = text.lines().filter_map(Line::parse).collect();
        assert_eq!(lines.len(), 2);
        let taken = per_unit(&lines, "takt", "read").unwrap();
        assert_eq!(taken[..5], [100.0, 1.0, 0.0, 0.0, 1.0]);
        assert!(per_unit(&lines, "takt", "write").is_none());
        assert_eq!(vmms(&lines), [("takt", "Takt")]);
    }
}
