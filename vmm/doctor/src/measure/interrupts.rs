//! Which interrupts a CPU took during a measurement.

use std::collections::BTreeMap;

use takt_scheduler::table::Cpu;

use crate::host::Host;

/// All that is counted in `/proc/interrupts`: by number or name, what it is, and how often it came
/// on each CPU.
#[derive(Debug, Default)]
pub struct Counts {
    cpus: Vec<Cpu>,
    counts: BTreeMap<String, (String, Vec<u64>)>,
}

impl Counts {
    /// As they are now.
    #[must_use]
    pub fn read(host: &Host) -> Self {
        Self::parse(&host.text("proc/interrupts").unwrap_or_default())
    }

    fn parse(text: &str) -> Self {
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default().split_whitespace();
        let cpus: Vec<Cpu> =
            header.filter_map(|name| name.strip_prefix("CPU")?.parse().ok().map(Cpu)).collect();
        let mut counts = BTreeMap::new();
        for line in lines {
            let Some((key, rest)) = line.trim().split_once(':') else { continue };
            let words: Vec<&str> = rest.split_whitespace().collect();
            let numbers = words.iter().map_while(|word| word.parse().ok()).take(cpus.len());
            let numbers: Vec<u64> = numbers.collect();
            // A device has its controller and line before its name, the others only have a name.
            let skip = numbers.len() + if key.parse::<u32>().is_ok() { 2 } else { 0 };
            let name = words.get(skip..).unwrap_or_default().join(" ");
            counts.insert(key.to_owned(), (name, numbers));
        }
        Self { cpus, counts }
    }

    /// What has come on a CPU since an earlier reading, most often first: "750 Local timer
    /// interrupts, ...".
    #[must_use]
    pub fn since(&self, earlier: &Counts, cpu: Cpu) -> String {
        let Some(column) = self.cpus.iter().position(|other| *other == cpu) else {
            return String::new();
        };
        let mut came: Vec<(u64, &str)> = Vec::new();
        for (key, (name, numbers)) in &self.counts {
            let before = earlier.counts.get(key).and_then(|(_, numbers)| numbers.get(column));
            let now = numbers.get(column).copied().unwrap_or(0);
            let count = now.saturating_sub(before.copied().unwrap_or(0));
            if count > 0 {
                came.push((count, name));
            }
        }
        came.sort_by(|a, b| b.cmp(a));
        let told: Vec<String> =
            came.iter().map(|(count, name)| format!("{count} {name}")).collect();
        told.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: &str = "\
           CPU0       CPU2
 36:         10     185  PCI-MSIX-0000:00:02.0   1-edge      virtio1-req.0
LOC:       100       200   Local timer interrupts
ERR:          0
";

    #[test]
    fn what_came_is_told_for_one_cpu() {
        let after =
            BEFORE.replace(" 185 ", " 188 ").replace("200 ", "950 ").replace("100 ", "101 ");
        let (before, after) = (Counts::parse(BEFORE), Counts::parse(&after));
        let told = "750 Local timer interrupts, 3 virtio1-req.0";
        assert_eq!(after.since(&before, Cpu(2)), told);
        assert_eq!(after.since(&before, Cpu(0)), "1 Local timer interrupts");
        assert_eq!(after.since(&before, Cpu(1)), "");
    }

    #[test]
    fn odd_text_is_passed_over() {
        let odd = Counts::parse("CPU0\n 36: x y\nnonsense\n:\n 5: 18446744073709551616 1\n");
        assert_eq!(odd.since(&Counts::default(), Cpu(0)), "");
    }
}
