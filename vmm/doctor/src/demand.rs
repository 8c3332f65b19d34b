//! What is asked of the host: by a partition file, or by a PLC as they mostly are.

use std::path::{Path, PathBuf};

use takt_host::resctrl::Asked;
use takt_plan::{Allowance, HugePages, Kind, MemorySource, Partition, PartitionFile};
use takt_scheduler::reservation::{CpuReservations, Reservation};
use takt_scheduler::schedules::Schedules;
use takt_scheduler::sleep::Steering;
use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};
use takt_scheduler::time::Nanos;

use crate::host::Host;

/// The release guard where no file gives one, as in the partition file.
const GUARD: Nanos = Nanos::from_micros(20);
const FRAME: Nanos = Nanos::from_millis(1);
const WINDOW: Nanos = Nanos::from_micros(300);

/// A CPU on which partitions have windows.
#[derive(Clone, Debug)]
pub struct WindowedCpu {
    /// Which.
    pub cpu: Cpu,
    /// The shortest release guard of a PLC there; `None` if only a Linux has windows.
    pub guard: Option<Nanos>,
    /// The longest window of one partition there.
    pub window: Nanos,
    /// The shortest time between two windows of that partition.
    pub period: Nanos,
    /// Whether a Linux runs there whenever no window does.
    pub shared: bool,
    /// What the kernel is asked for there.
    pub reservations: Vec<Reservation>,
}

impl WindowedCpu {
    /// The guard that wake-ups are held against.
    #[must_use]
    pub fn guard_or_usual(&self) -> Nanos {
        self.guard.unwrap_or(GUARD)
    }
}

/// What is asked of the host.
#[derive(Clone, Debug)]
pub struct Demand {
    /// The file that asks for it.
    pub file: Option<PathBuf>,
    /// CPUs with windows; at least one without a file.
    pub windowed: Vec<WindowedCpu>,
    /// CPUs of partitions that have no windows.
    pub others: Vec<Cpu>,
    /// Memory of all guests, in bytes.
    pub memory: u64,
    /// Of which pages the memory of each partition is to be, and its bytes.
    pub pages: Vec<(HugePages, u64)>,
    /// Shares of cache and memory bandwidth that partitions ask for; of which cache is the host's to say.
    pub shares: Vec<Asked>,
    /// PCI functions that a PLC gets with `trusted_dma`.
    pub trusted_dma: Vec<String>,
    /// Whether there is a Linux.
    pub linux: bool,
    /// The interrupts that may come in each window of a PLC, by its name.
    pub interrupts: Vec<(String, Allowance)>,
}

impl Demand {
    /// Of a partition file.
    #[must_use]
    pub fn of(file: &PartitionFile) -> Self {
        let schedules = file.schedules();
        let cpus = schedules.cpus();
        let windowed: Vec<_> = cpus.iter().filter_map(|&cpu| windowed(schedules, cpu)).collect();
        let others =
            cpus.into_iter().filter(|cpu| windowed.iter().all(|w| w.cpu != *cpu)).collect();
        let plcs = |id: &PartitionId| matches!(file.partitions()[id.0].kind(), Kind::Plc { .. });
        let windowed = windowed
            .into_iter()
            .map(|it| WindowedCpu { guard: guard(schedules, it.cpu, plcs), ..it })
            .collect();
        Self {
            file: Some(file.path().into()),
            windowed,
            others,
            memory: file.partitions().iter().map(|p| p.memory_bytes()).sum(),
            pages: file
                .partitions()
                .iter()
                .map(|p| (p.hardware().huge_pages, p.memory_bytes()))
                .collect(),
            shares: file.partitions().iter().filter_map(share).collect(),
            trusted_dma: trusted(file),
            linux: file.partitions().iter().any(|p| matches!(p.kind(), Kind::Linux { .. })),
            interrupts: file
                .partitions()
                .iter()
                .filter(|p| plcs(&p.id()))
                .map(|p| (p.name().to_owned(), p.interrupts()))
                .collect(),
        }
    }

    /// Of a PLC with a window of 300 us in a frame of 1 ms and a guard of 20 us, on the CPU that
    /// suits it best: the last isolated one that is online, else the last one. It has that CPU for itself if there
    /// are several.
    #[must_use]
    pub fn usual(host: &Host) -> Self {
        let online = host.online();
        // The kernel lists isolated CPUs that are switched off, or that were never there.
        let isolated = host.isolated().into_iter().rfind(|cpu| online.contains(cpu));
        let cpu = isolated.or(online.last().copied()).unwrap_or(Cpu(0));
        let placement = Placement { cpu, role: Role::Windowed { guard: GUARD } };
        let window = Window {
            partition: PartitionId(0),
            offset: Nanos::ZERO,
            duration: WINDOW,
            period: FRAME,
        };
        let schedules = Schedules::new(FRAME, &[placement], &[&[window]]).ok();
        let windowed: Vec<_> = schedules
            .and_then(|schedules| windowed(&schedules, cpu))
            .into_iter()
            .map(|it| WindowedCpu { guard: Some(GUARD), shared: online.len() == 1, ..it })
            .collect();
        let others = online.into_iter().filter(|other| *other != cpu).take(1).collect();
        Self {
            file: None,
            windowed,
            others,
            memory: 0,
            pages: Vec::new(),
            shares: Vec::new(),
            trusted_dma: Vec::new(),
            linux: true,
            interrupts: Vec::new(),
        }
    }

    /// CPUs with windows.
    #[must_use]
    pub fn cpus(&self) -> Vec<Cpu> {
        self.windowed.iter().map(|w| w.cpu).collect()
    }

    /// CPUs with windows, and behind them those of other partitions.
    #[must_use]
    pub fn named(&self) -> Vec<Cpu> {
        self.cpus().into_iter().chain(self.others.iter().copied()).collect()
    }

    /// The command that asks the doctor the same again.
    #[must_use]
    pub fn command(&self) -> String {
        match &self.file {
            Some(path) => format!("takt doctor {}", one_word(path)),
            None => "takt doctor".into(),
        }
    }

    /// Whether a CPU has windows.
    #[must_use]
    pub fn has_windows_on(&self, cpu: Cpu) -> bool {
        self.windowed.iter().any(|w| w.cpu == cpu)
    }
}

/// A path as a shell takes it for one word.
fn one_word(path: &Path) -> String {
    let text = path.display().to_string();
    if text.chars().all(|c| c.is_alphanumeric() || "/._-+,:@%".contains(c)) {
        return text;
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The CPU without its guard.
fn windowed(schedules: &Schedules, cpu: Cpu) -> Option<WindowedCpu> {
    schedules.timetable_on(cpu)?;
    // What it is at most: takt asks for less where no process can steer the clock.
    let own = CpuReservations::of(schedules, cpu).by_a_clock_whose_steering_is(Steering::Possible);
    let timetables = own.partitions.iter().filter_map(|(id, _)| schedules.timetable_of(*id));
    let longest = timetables.max_by_key(|timetable| timetable.longest())?;
    Some(WindowedCpu {
        cpu,
        guard: None,
        window: longest.longest(),
        period: longest.shortest_period(),
        shared: schedules.tables().iter().any(|table| table.backgrounds_of(cpu).next().is_some()),
        reservations: own.partitions.iter().map(|(_, r)| *r).chain(own.kicker).collect(),
    })
}

fn guard(schedules: &Schedules, cpu: Cpu, plc: impl Fn(&PartitionId) -> bool) -> Option<Nanos> {
    let here = schedules.placements().iter().enumerate().filter(|(_, p)| p.cpu == cpu);
    let guards = here.filter(|(i, _)| plc(&PartitionId(*i))).filter_map(|(_, p)| match p.role {
        Role::Windowed { guard } => Some(guard),
        Role::Background => None,
    });
    guards.min()
}

/// What a partition asks for; `None` if it asks for nothing.
fn share(partition: &Partition) -> Option<Asked> {
    let hardware = partition.hardware();
    let (ways, percent) = (hardware.cache, hardware.memory_bandwidth);
    let (cpu, domain) = (partition.cpu(), None);
    (ways.is_some() || percent.is_some()).then(|| Asked {
        partition: partition.name().to_owned(),
        cpu,
        domain,
        ways,
        percent,
    })
}

/// PCI functions that may master the bus.
fn trusted(file: &PartitionFile) -> Vec<String> {
    let mut functions = Vec::new();
    for partition in file.partitions() {
        let devices = partition.passthrough();
        let ports = devices.ports.iter().filter_map(|ports| ports.bar.as_ref());
        let memory = devices.memory.iter().filter_map(|memory| match &memory.source {
            MemorySource::Pci(bar) => Some(bar),
            _ => None,
        });
        let trusted = ports.chain(memory).filter(|bar| bar.trusted_dma);
        functions.extend(trusted.map(|bar| bar.function.name().to_owned()));
    }
    functions.sort();
    functions.dedup();
    functions
}

#[cfg(test)]
mod tests {
    use takt_plan as config;

    use super::*;
    use crate::recorded::Recorded;

    const FILE: &str = r#"
version = 1
[system]
name = "test"
major_frame = "2ms"
[[partition]]
name = "fast"
kind = "plc"
cpu = 3
memory = "4MiB"
release_guard = "30us"
[[partition]]
name = "slow"
kind = "plc"
cpu = 3
memory = "8MiB"
release_guard = "10us"
[[partition]]
name = "other"
kind = "plc"
cpu = 1
memory = "4MiB"
[[schedule]]
name = "normal"
[[schedule.window]]
partition = "fast"
offset = "0us"
duration = "200us"
period = "1ms"
[[schedule.window]]
partition = "slow"
offset = "400us"
duration = "300us"
[[schedule.window]]
partition = "other"
offset = "0us"
duration = "100us"
"#;

    #[test]
    fn a_file_asks_for_its_cpus_and_sizes() {
        let path = std::env::temp_dir().join(format!("takt-doctor-{}.toml", std::process::id()));
        std::fs::write(&path, FILE).unwrap();
        let file = config::load(&path, None);
        std::fs::remove_file(&path).unwrap();
        let demand = Demand::of(&file.unwrap());
        assert_eq!(demand.cpus(), [Cpu(1), Cpu(3)]);
        assert_eq!((demand.memory, demand.linux, demand.others.len()), (16 << 20, false, 0));
        let three = &demand.windowed[1];
        assert_eq!(three.guard, Some(Nanos::from_micros(10)));
        assert_eq!((three.window, three.period), (Nanos::from_micros(300), Nanos::from_millis(2)));
        assert_eq!((three.shared, three.reservations.len()), (false, 3));
    }

    #[test]
    fn the_command_has_the_file_as_one_word() {
        let with = |file: &str| {
            let usual = Demand::usual(&Host::recorded(Path::new("/none"), String::new()));
            Demand { file: Some(file.into()), ..usual }.command()
        };
        assert_eq!(with("/etc/takt/plant-1.toml"), "takt doctor /etc/takt/plant-1.toml");
        assert_eq!(with("/my plant/a.toml"), "takt doctor '/my plant/a.toml'");
        assert_eq!(with("/it's;rm/a.toml"), r"takt doctor '/it'\''s;rm/a.toml'");
    }

    #[test]
    fn without_a_file_the_plc_has_the_last_isolated_cpu() {
        let host = Recorded::named("workstation");
        assert_eq!(Demand::usual(&host.unpack().host).cpus(), [Cpu(7)]);
        let host = host.with("sys/devices/system/cpu/isolated", "2-3");
        assert_eq!(Demand::usual(&host.unpack().host).cpus(), [Cpu(3)]);
        // One that is switched off, and some that were never there.
        let gone = host.clone().with("sys/devices/system/cpu/online", "0-2,4-7");
        let gone = gone.with("sys/devices/system/cpu/isolated", "2-3,8-255");
        assert_eq!(Demand::usual(&gone.unpack().host).cpus(), [Cpu(2)]);
        let one = Demand::usual(&Recorded::named("appliance-rt").unpack().host);
        assert_eq!((one.cpus(), one.others.len()), (vec![Cpu(0)], 0));
        let nothing = Demand::usual(&Host::recorded(Path::new("/none"), String::new()));
        assert_eq!(nothing.cpus(), [Cpu(0)]);
    }
}
