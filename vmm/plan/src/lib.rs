//! The partition file: everything that Takt is told, in one place.
//!
//! Resources are distributed statically, so what cannot work must be known before anything is
//! started: a plant does not come to a halt at three in the morning over a typing mistake. Reading
//! the file is therefore all of the validation. It goes in stages, each of which trusts the one
//! before:
//!
//! 1. bytes to text to the raw form, whose keys and types are right (`syntax`, `raw`, `units`);
//! 2. the rules of each partition (`partition`, `hardware`, `tasks`), of the schedules (`schedules`, `periods`,
//!    `explain`), of both together (`deadlines`), of the channels between partitions (`channels`, `ports`,
//!    `host_ports`), of the health monitor's tables (`health`), of the host's devices (`passthrough`), and of the files
//!    that are named (`files`, `images`, `programs`, `contents`, `placement`, `disks`, `nets`, `vsock`);
//! 3. a [`PartitionFile`], which has private fields and no other way to be made. The rest of Takt
//!    takes only that and does not check it again. Only a command line can add words to a guest's
//!    (`append`).
//!
//! The first defect ends it: in a file of 40 lines a second message is more often a consequence of
//! the first than a second defect. The key reference is `docs/partition-file.md`.

mod admission;
mod append;
mod background;
mod channels;
pub mod check;
mod connections;
mod consoles;
mod contents;
mod deadlines;
mod diagnostic;
mod disks;
pub mod elf;
mod events;
mod explain;
mod files;
mod hardware;
pub mod health;
mod host_ports;
mod images;
mod interrupts;
pub mod kernel;
mod kind_keys;
pub mod linux_map;
mod live;
mod names;
mod nets;
mod partition;
mod passthrough;
mod periods;
mod placement;
mod points;
mod ports;
mod processors;
mod program_tasks;
mod programs;
mod raw;
mod retain;
mod schedules;
mod syntax;
mod tasks;
#[cfg(test)]
mod tests;
mod units;
mod values;
mod versions;
mod vsock;

use std::fmt;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use takt_scheduler::schedules::{ScheduleId, Schedules};
use takt_scheduler::table::{Cpu, PartitionId};
use takt_scheduler::time::Nanos;
use thiserror::Error;

use crate::health::Table;
use diagnostic::Diagnostic;
use partition::Surroundings;
use raw::Keys;
use schedules::Draft;

pub use admission::Admission;
pub use append::AppendError;
pub use channels::{CHANNELS_MAX, Channel, ChannelKind, End, Owner, WhenFull};
pub use connections::{Bus, Can, Connection};
pub use consoles::Console;
pub use deadlines::{Met, WAKE_UP_ALLOWANCE};
pub use disks::{DISKS_MAX, Disk, SECTOR};
pub use hardware::{BusLockLimit, Hardware, HugePageSize, HugePages};
pub use host_ports::HostPort;
pub use images::{SOCKET_PATH_MAX, Unreadable, open as open_file};
pub use interrupts::{Allowance, INTERRUPT};
pub use live::live_channels;
pub use nets::{HostEnd, NETS_MAX, Net};
pub use passthrough::{
    Bar, DeviceMemory, Interrupt, InterruptSource, MemorySource, Passthrough, PciFunction, PortIo,
    SafePlace, SafeValue,
};
pub use placement::table as program_table;
pub use ports::{CHANNEL_AREA_PAGES, region_bytes};
pub use processors::PROCESSORS_MAX;
pub use program_tasks::{ProgramTask, Release};
pub use programs::{AcceptedKeys, Program, Trust};
pub use retain::RetainFile;
pub use schedules::percent;
pub use tasks::NamedTask;
pub use units::{Bytes, UnitError, parse_duration};
pub use vsock::Cid;

/// Largest partition file, in bytes. Far above any real one; it keeps a wrong path, such as that
/// of a disk image, from being read into memory.
pub const FILE_MAX: u64 = 1 << 20;

/// A partition file that passed every check.
#[derive(Clone, Debug)]
pub struct PartitionFile {
    path: PathBuf,
    name: String,
    schedule_names: Vec<String>,
    schedules: Schedules,
    partitions: Vec<Partition>,
    channels: Vec<Channel>,
    control: Option<PathBuf>,
    viewers: Option<String>,
    watchdog: Option<Nanos>,
}

impl PartitionFile {
    /// Absolute path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name of the system.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Names of the schedules, by [`ScheduleId`].
    #[must_use]
    pub fn schedule_names(&self) -> &[String] {
        &self.schedule_names
    }

    /// The schedules. Their placements are those of [`partitions`](Self::partitions).
    #[must_use]
    pub fn schedules(&self) -> &Schedules {
        &self.schedules
    }

    /// Absolute path of the control socket, if there is to be one.
    #[must_use]
    pub fn control(&self) -> Option<&Path> {
        self.control.as_deref()
    }

    /// The group of users who may see at the control socket how the run stands, and order nothing; a name, or a number.
    #[must_use]
    pub fn viewers(&self) -> Option<&str> {
        self.viewers.as_deref()
    }

    /// After how long without a heartbeat from Takt the host's watchdog restarts the machine; `None`
    /// if it is not served.
    #[must_use]
    pub fn watchdog(&self) -> Option<Nanos> {
        self.watchdog
    }

    /// All partitions; [`PartitionId`] is the position in here.
    #[must_use]
    pub fn partitions(&self) -> &[Partition] {
        &self.partitions
    }

    /// All channels, in the order of the file.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }
}

/// One partition.
#[derive(Clone, Debug)]
pub struct Partition {
    id: PartitionId,
    name: String,
    cpu: Cpu,
    further: Vec<Cpu>,
    memory: Bytes,
    hardware: Hardware,
    kind: Kind,
    console: Option<Console>,
    console_log: Option<PathBuf>,
    on_schedule_change: ScheduleChange,
    health: Table,
    watchdog: Option<Nanos>,
    power_off: Nanos,
    tasks: Vec<NamedTask>,
    met: Vec<Met>,
    passthrough: Passthrough,
    disks: Vec<Disk>,
    nets: Vec<Net>,
    vsock: Option<Cid>,
    programs: Vec<Program>,
    program_tasks: Vec<ProgramTask>,
    connections: Vec<Connection>,
    can: Can,
    /// Interrupts that release tasks of its programs.
    events: Vec<takt_abi::io::Mapping>,
    auto_guard: bool,
    interrupts: Allowance,
}

impl Partition {
    /// Position in the file.
    #[must_use]
    pub fn id(&self) -> PartitionId {
        self.id
    }

    /// Name, unique in the file: a lower-case letter, then letters, digits and hyphens.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The host CPU that its first vCPU runs on, and its other threads.
    #[must_use]
    pub fn cpu(&self) -> Cpu {
        self.cpu
    }

    /// The host CPUs of its vCPUs, in their order, each once. Only a background Linux has several.
    pub fn cpus(&self) -> impl Iterator<Item = Cpu> {
        [self.cpu].into_iter().chain(self.further.iter().copied())
    }

    /// Size of its memory in bytes, a multiple of the page size within the limits of its kind.
    #[must_use]
    pub fn memory_bytes(&self) -> u64 {
        self.memory.0
    }

    /// What it takes of the hardware that all partitions share.
    #[must_use]
    pub fn hardware(&self) -> Hardware {
        self.hardware
    }

    /// What runs in it.
    #[must_use]
    pub fn kind(&self) -> &Kind {
        &self.kind
    }

    /// Where its console is; `None` for a PLC, whose lines are shown among Takt's own.
    #[must_use]
    pub fn console(&self) -> Option<Console> {
        self.console
    }

    /// The file to which all is appended that it writes to its console. The path is absolute.
    #[must_use]
    pub fn console_log(&self) -> Option<&Path> {
        self.console_log.as_deref()
    }

    /// What that file is called where it is carried out of an emulated machine. No recording of a channel has this name.
    #[must_use]
    pub fn console_record(&self) -> String {
        format!("console.{}.records", self.name)
    }

    /// What happens to it when a switch of schedules takes effect; [`ScheduleChange::Ignore`] for
    /// a Linux.
    #[must_use]
    pub fn on_schedule_change(&self) -> ScheduleChange {
        self.on_schedule_change
    }

    /// What follows from its errors.
    #[must_use]
    pub fn health(&self) -> Table {
        self.health
    }

    /// How long a Linux may be without a heartbeat; `None` if it has no watchdog.
    #[must_use]
    pub fn watchdog(&self) -> Option<Nanos> {
        self.watchdog
    }

    /// How long a Linux that is asked to switch itself off at the end of a run has for that; 0 if it is stopped
    /// at once, as each PLC is.
    #[must_use]
    pub fn power_off(&self) -> Nanos {
        self.power_off
    }

    /// Its tasks, in the order of the file, or those of its programs that are analysed. They meet their deadlines in
    /// every schedule in which the partition has a window.
    #[must_use]
    pub fn tasks(&self) -> &[NamedTask] {
        &self.tasks
    }

    /// What it gets of the host's devices; nothing for a Linux.
    #[must_use]
    pub fn passthrough(&self) -> &Passthrough {
        &self.passthrough
    }

    /// Its disks, in the order of the file; none for a PLC.
    #[must_use]
    pub fn disks(&self) -> &[Disk] {
        &self.disks
    }

    /// Its network interfaces, in the order of the file; none for a PLC.
    #[must_use]
    pub fn nets(&self) -> &[Net] {
        &self.nets
    }

    /// The number by which programs of the host reach it without a network; `None` for a PLC.
    #[must_use]
    pub fn vsock(&self) -> Option<Cid> {
        self.vsock
    }

    /// How many virtio devices its machine has: disks, network interfaces, and what sockets go through.
    #[must_use]
    pub fn virtio_devices(&self) -> usize {
        self.disks.len() + self.nets.len() + usize::from(self.vsock.is_some())
    }

    /// The programs that a PLC's guest is to run, in the order of the file.
    #[must_use]
    pub fn programs(&self) -> &[Program] {
        &self.programs
    }

    /// The tasks of all programs, the most urgent first. Those that are analysed meet their deadlines, as
    /// [`tasks`](Self::tasks) do.
    #[must_use]
    pub fn program_tasks(&self) -> &[ProgramTask] {
        &self.program_tasks
    }

    /// What the inputs and outputs of its programs are connected to, in the order of the guest's table.
    #[must_use]
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }

    /// The CAN controllers that its kernel drives, and the objects on their buses.
    #[must_use]
    pub fn can(&self) -> &Can {
        &self.can
    }

    /// The I/O table that its guest finds.
    #[must_use]
    pub fn io_table(&self) -> takt_abi::io::IoTable {
        connections::table(&self.connections, &self.can, &self.events)
    }

    /// True if its release guard follows the host. Then the guard of its placement is the upper bound.
    #[must_use]
    pub fn has_auto_guard(&self) -> bool {
        self.auto_guard
    }

    /// The interrupts that may come in each of its windows.
    #[must_use]
    pub fn interrupts(&self) -> Allowance {
        self.interrupts
    }

    /// What the analysis found for a schedule; `None` without tasks, or without a window in it.
    #[must_use]
    pub fn met_in(&self, schedule: ScheduleId) -> Option<&Met> {
        self.met.iter().find(|met| met.schedule == schedule)
    }
}

/// What happens to a partition when a switch of schedules takes effect (ARINC 653 Part 2: the
/// schedule change action).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ScheduleChange {
    /// Nothing: it goes on.
    #[default]
    Ignore,
    /// It starts again, and what it retains is kept.
    Warm,
    /// It starts again as for the first time.
    Cold,
}

/// Prints as it is written in the file.
impl fmt::Display for ScheduleChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            ScheduleChange::Ignore => "ignore",
            ScheduleChange::Warm => "warm",
            ScheduleChange::Cold => "cold",
        })
    }
}

/// What runs in a partition. Paths are absolute, and were readable files when the file was loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A freestanding PLC guest.
    Plc {
        /// Its ELF image; without one, the demo guest that is built into Takt.
        image: Option<PathBuf>,
    },
    /// An unmodified Linux.
    Linux {
        /// The kernel, a bzImage.
        kernel: PathBuf,
        /// The initial RAM file system.
        initrd: Option<PathBuf>,
        /// The kernel's command line: at most 2047 bytes, no control characters.
        cmdline: String,
    },
}

/// Why there is no [`PartitionFile`]. Its text is the whole message for the user, of several lines.
#[derive(Debug, Error)]
pub enum FileError {
    /// The file itself cannot be read.
    #[error(
        "error: {}: cannot be read: {reason}\n  = allowed: a regular file in TOML",
        path.display()
    )]
    Unreadable {
        /// As the user gave it.
        path: PathBuf,
        /// What is in the way.
        reason: Unreadable,
    },
    /// The file is larger than [`FILE_MAX`].
    #[error(
        "error: {}: larger than any partition file\n  = allowed: at most {FILE_MAX} bytes",
        path.display()
    )]
    TooLarge {
        /// As the user gave it.
        path: PathBuf,
    },
    /// The file says something that is not allowed: place, line, and what is allowed instead.
    #[error("{0}")]
    Defect(String),
}

/// Reads and checks a partition file.
///
/// `host_cpus` is how many CPUs the machine has that the file is meant for; a CPU beyond them is
/// then a defect. `None` is for a file that is only looked at here and will run elsewhere.
///
/// # Errors
/// [`FileError`]: the file cannot be read, or the first defect in it.
pub fn load(path: &Path, host_cpus: Option<usize>) -> Result<PartitionFile, FileError> {
    load_and_check(path, host_cpus, None)
}

/// An image of a program that is not in its place yet.
#[derive(Clone, Copy, Debug)]
pub struct Replacement<'a> {
    /// Absolute path of the program's image, as [`Program`] has it.
    pub path: &'a Path,
    /// What is to be there.
    pub bytes: &'a [u8],
}

/// Reads and checks a partition file as [`load`] would if another image were in its place: what no start would take is
/// known before a file is replaced.
///
/// # Errors
/// [`FileError`], as [`load`].
pub fn load_with(
    path: &Path,
    host_cpus: Option<usize>,
    replacement: Replacement<'_>,
) -> Result<PartitionFile, FileError> {
    load_and_check(path, host_cpus, Some(replacement))
}

fn load_and_check(
    path: &Path,
    host_cpus: Option<usize>,
    replacement: Option<Replacement<'_>>,
) -> Result<PartitionFile, FileError> {
    let unreadable = |reason: Unreadable| FileError::Unreadable { path: path.into(), reason };
    let bytes = read(path).map_err(unreadable)?;
    if bytes.len() as u64 > FILE_MAX {
        return Err(FileError::TooLarge { path: path.into() });
    }
    let absolute = absolute(path).map_err(|error| unreadable(error.into()))?;
    let text = std::str::from_utf8(&bytes).map_err(|error| {
        let (shown, defect) = syntax::not_utf8(&bytes, error);
        FileError::Defect(defect.render(path, &shown))
    })?;
    check(text, absolute, host_cpus, replacement)
        .map_err(|defect| FileError::Defect(defect.render(path, text)))
}

fn read(path: &Path) -> Result<Vec<u8>, Unreadable> {
    let mut bytes = Vec::new();
    images::open(path)?.take(FILE_MAX + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The folder without links, so that `..` in the paths of images means what the kernel would make
/// of it; the name of the file itself as it was given.
fn absolute(path: &Path) -> io::Result<PathBuf> {
    let path = std::path::absolute(path)?;
    match (path.parent(), path.file_name()) {
        (Some(folder), Some(name)) => Ok(folder.canonicalize()?.join(name)),
        _ => path.canonicalize(),
    }
}

fn check(
    text: &str,
    path: PathBuf,
    host_cpus: Option<usize>,
    replacement: Option<Replacement<'_>>,
) -> Result<PartitionFile, Diagnostic> {
    let file = syntax::parse(text)?;
    let Keys(system) = file.system.get_ref();
    let name = names::check_name(&system.name)?.to_owned();
    schedules::check_frame(&system.major_frame)?;
    let folder = path.parent().unwrap_or(Path::new("/"));
    let socket = system.control.as_ref();
    let control = socket.map(|path| images::resolve_socket(folder, path)).transpose()?;
    let viewers = system.viewers.as_ref();
    let viewers = viewers.map(|group| values::viewers(group, control.is_some())).transpose()?;
    let watchdog = system.watchdog.as_ref().map(values::host_watchdog).transpose()?;
    let around = Surroundings { folder, host_cpus, frame: &system.major_frame, replacement };
    let header = file.system.span();
    let mut partitions = partition::check_all(&file.partition.0, &header, around)?;
    let draft = Draft::new(&file.schedule.0, system, &header, &partitions)?;
    let (schedule_names, schedules) = (draft.names(), draft.check()?);
    let passthrough = passthrough::check(&file.partition.0, &partitions)?;
    let interrupts: Vec<_> = partitions
        .iter()
        .map(|p| deadlines::interrupts(&partitions, &schedules, &passthrough, p.partition.id))
        .collect();
    let met = partitions
        .iter()
        .zip(&interrupts)
        .map(|(p, interrupts)| deadlines::check(&draft, &schedules, p.partition.id, *interrupts))
        .collect::<Result<Vec<_>, _>>()?;
    for ((p, met), interrupts) in partitions.iter_mut().zip(met).zip(interrupts) {
        p.partition.met = met;
        p.partition.interrupts = interrupts;
    }
    let channels = channels::check(&file.channel.0, &partitions, folder)?;
    points::check_ports(&channels, &partitions)?;
    health::check(&file.health.0, &mut partitions)?;
    let connections = connections::check(&file.partition.0, &partitions, &channels, &passthrough)?;
    let events = events::check(&partitions, &passthrough, &connections)?;
    let checked = passthrough.into_iter().zip(connections).zip(events);
    partitions.iter_mut().zip(checked).for_each(|(p, ((passthrough, connections), events))| {
        p.partition.passthrough = passthrough;
        (p.partition.connections, p.partition.can) = connections;
        p.partition.events = events;
    });
    nets::check_all(partitions.iter().flat_map(|p| &p.nets))?;
    vsock::check_all(&partitions)?;
    consoles::check_all(&partitions, control.is_some())?;
    let named = control.as_deref().zip(socket);
    files::check(&path, named, &partitions, channels.iter().zip(&file.channel.0))?;
    // Last, because it is the only thing that may be right on another machine.
    partitions.iter().flat_map(|p| &p.images).try_for_each(images::check)?;
    partitions.iter().flat_map(|p| &p.disks).try_for_each(disks::check_file)?;
    host_ports::check_files(&file.channel.0, &channels)?;
    partitions.iter_mut().try_for_each(contents::check)?;
    let partitions = partitions.into_iter().map(|p| p.partition).collect();
    Ok(PartitionFile {
        path,
        name,
        schedule_names,
        schedules,
        partitions,
        channels,
        control,
        viewers,
        watchdog,
    })
}
