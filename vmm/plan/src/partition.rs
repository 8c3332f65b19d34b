//! The rules for one partition, and for partitions among each other.

use std::path::Path;

use takt_scheduler::guard::AUTO_LEAST;
use takt_scheduler::table::{PartitionId, Role};
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::connections::Can;
use super::consoles;
use super::diagnostic::{Diagnostic, Span, quote};
use super::disks::{self, CheckedDisk};
use super::hardware;
use super::health;
use super::images::{self, Image};
use super::kind_keys::{self, Owner};
use super::names::{HOST, check_name};
use super::nets::{self, CheckedNet};
use super::passthrough::Passthrough;
use super::points;
use super::processors;
use super::program_tasks;
use super::programs::{self, CheckedProgram};
use super::raw::{self, Keys};
use super::tasks::{self, CheckedTasks};
use super::units::{Duration, Guard};
use super::values;
use super::vsock;
use super::{Allowance, Kind, Partition, Replacement};

/// Most partitions of one file.
pub const PARTITIONS_MAX: usize = 32;
/// Guard where the file gives none: well above the wake-up latency of a PREEMPT_RT host under
/// load, which was 7 us in the latency lab.
const GUARD_DEFAULT: Nanos = Nanos::from_micros(20);
const CMDLINE_DEFAULT: &str = "console=ttyS0";

/// A partition that obeys its own rules, with the places that later rules point at.
#[derive(Debug)]
pub struct Checked {
    pub partition: Partition,
    pub role: Role,
    pub images: Vec<Image>,
    pub header: Span,
    pub name: Span,
    pub background: Option<Span>,
    pub console: Option<Span>,
    /// The file that keeps what it writes to its console.
    pub console_log: Option<Image>,
    pub tasks: CheckedTasks,
    pub disks: Vec<CheckedDisk>,
    pub nets: Vec<CheckedNet>,
    pub vsock: Option<Span>,
    pub programs: Vec<CheckedProgram>,
    pub memory: Span,
}

/// What the rules of a partition need to know of the world around it.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// Folder of the partition file.
    pub folder: &'a Path,
    /// How many CPUs the host has, if the file is for this host.
    pub host_cpus: Option<usize>,
    /// The major frame.
    pub frame: &'a Spanned<Duration>,
    /// The image of a program that counts instead of the file that is there.
    pub replacement: Option<Replacement<'a>>,
}

/// Checks all partitions, in the order of the file.
pub fn check_all(
    raw: &[Spanned<Keys<raw::Partition>>],
    system: &Span,
    around: Surroundings<'_>,
) -> Result<Vec<Checked>, Diagnostic> {
    let allowed = format!("1 to {PARTITIONS_MAX} tables [[partition]]");
    if raw.is_empty() {
        return Err(Diagnostic::new(system.clone(), "the system has no partition", allowed));
    }
    if let Some(excess) = raw.get(PARTITIONS_MAX) {
        let found = format!("this is partition {} of {}", PARTITIONS_MAX + 1, raw.len());
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut checked: Vec<Checked> = Vec::with_capacity(raw.len());
    for table in raw {
        let next = check(PartitionId(checked.len()), table, around)?;
        let same = |other: &&Checked| other.partition.name == next.partition.name;
        if let Some(other) = checked.iter().find(same) {
            let found = format!("a second partition is named {}", quote(&next.partition.name));
            return Err(Diagnostic::new(next.name, found, "a name of its own for each partition")
                .and(other.name.clone(), "the other one"));
        }
        checked.push(next);
    }
    Ok(checked)
}

/// The partition of this name, for the value at `span` that asks for it.
pub fn find<'a>(
    partitions: &'a [Checked],
    name: &str,
    span: Span,
) -> Result<&'a Checked, Diagnostic> {
    partitions.iter().find(|p| p.partition.name == name).ok_or_else(|| {
        let names: Vec<String> = partitions.iter().map(|p| quote(&p.partition.name)).collect();
        let found = format!("there is no partition {}", quote(name));
        Diagnostic::new(span, found, names.join(", "))
    })
}

fn check(
    id: PartitionId,
    table: &Spanned<Keys<raw::Partition>>,
    around: Surroundings<'_>,
) -> Result<Checked, Diagnostic> {
    let Keys(raw) = table.get_ref();
    let name = check_name(&raw.name)?;
    if name == HOST {
        let allowed = "another name: as the end of a channel, \"host\" is Takt itself";
        return Err(Diagnostic::new(raw.name.span(), "a partition is named \"host\"", allowed));
    }
    let (cpu, further) = processors::check(raw, table.span(), around.host_cpus)?;
    let (kind, role, images) = match raw.kind.get_ref().as_str() {
        "plc" => check_plc(raw, name, around)?,
        "linux" => check_linux(raw, name, table.span(), around)?,
        other => {
            let found = format!("there is no kind {}", quote(other));
            return Err(Diagnostic::new(raw.kind.span(), found, "\"plc\" or \"linux\""));
        }
    };
    let memory = values::memory(&raw.memory, &kind)?;
    let hardware = hardware::check(raw, &kind, memory)?;
    let on_schedule_change = values::schedule_change(raw.on_schedule_change.as_ref())?;
    let health = health::default_table(&kind, raw.restarts.as_ref())?;
    let watchdog = raw.watchdog.as_ref().map(values::watchdog).transpose()?;
    let programs = programs::check(&raw.program.0, around)?;
    let (tasks, program_tasks) = match programs[..] {
        [] => (tasks::check(&raw.task.0, around.frame)?, Vec::new()),
        _ => {
            points::check_outputs(&programs)?;
            program_tasks::check(&programs)?
        }
    };
    let disks = disks::check(&raw.disk.0, around.folder)?;
    let nets = nets::check(&raw.net.0)?;
    let vsock = raw.vsock.as_ref().map(vsock::check).transpose()?;
    let power_off = values::power_off(raw.power_off.as_ref())?;
    let console = match kind {
        Kind::Plc { .. } => None,
        Kind::Linux { .. } => Some(consoles::check(raw.console.as_ref())?),
    };
    let log = raw.console_log.as_ref();
    let log = log.map(|path| images::resolve(around.folder, path)).transpose()?;
    let partition = Partition {
        id,
        name: name.to_owned(),
        cpu,
        further,
        memory,
        hardware,
        kind,
        console,
        console_log: log.as_ref().map(|log| log.path.clone()),
        on_schedule_change,
        health,
        watchdog,
        power_off,
        tasks: tasks.tasks.clone(),
        met: Vec::new(),
        passthrough: Passthrough::default(),
        disks: disks.iter().map(|disk| disk.disk.clone()).collect(),
        nets: nets.iter().map(|net| net.net.clone()).collect(),
        vsock,
        programs: Vec::new(),
        program_tasks,
        connections: Vec::new(),
        can: Can::default(),
        events: Vec::new(),
        interrupts: Allowance::default(),
        auto_guard: matches!(raw.release_guard.as_ref().map(Spanned::get_ref), Some(Guard::Auto)),
    };
    Ok(Checked {
        partition,
        tasks,
        disks,
        nets,
        vsock: raw.vsock.as_ref().map(Spanned::span),
        programs,
        memory: raw.memory.span(),
        role,
        images,
        header: table.span(),
        name: raw.name.span(),
        background: raw.background.as_ref().map(Spanned::span),
        console: raw.console.as_ref().map(Spanned::span),
        console_log: log,
    })
}

fn check_plc(
    raw: &raw::Partition,
    name: &str,
    around: Surroundings<'_>,
) -> Result<(Kind, Role, Vec<Image>), Diagnostic> {
    if let Some(background) = &raw.background {
        let found = Owner::Plc.misplaced("background", name);
        let allowed = "windows in the [[schedule]]: in the background a PLC would have no release";
        return Err(Diagnostic::new(background.span(), found, allowed));
    }
    kind_keys::check(raw, Owner::Plc)?;
    let guard = match &raw.release_guard {
        None => GUARD_DEFAULT,
        Some(guard) => match *guard.get_ref() {
            Guard::Fixed(length) => values::guard(length, &guard.span(), around.frame)?,
            // The schedules decide how much longer it may become.
            Guard::Auto => AUTO_LEAST,
        },
    };
    let image = raw.image.as_ref().map(|path| images::resolve(around.folder, path)).transpose()?;
    if let (Some(task), Some(program)) = (raw.task.0.first(), raw.program.0.first()) {
        let found = format!("{} has tasks of the file beside its programs", quote(name));
        let allowed = "either; the tasks of programs are those in their images";
        return Err(Diagnostic::new(task.span(), found, allowed).and(program.span(), "a program"));
    }
    let kind = Kind::Plc { image: image.as_ref().map(|image| image.path.clone()) };
    Ok((kind, Role::Windowed { guard }, image.into_iter().collect()))
}

fn check_linux(
    raw: &raw::Partition,
    name: &str,
    header: Span,
    around: Surroundings<'_>,
) -> Result<(Kind, Role, Vec<Image>), Diagnostic> {
    kind_keys::check(raw, Owner::Linux)?;
    let Some(kernel) = &raw.kernel else {
        let found = format!("partition {} of kind \"linux\" has no key `kernel`", quote(name));
        let allowed = "`kernel = \"vmlinuz\"`, the path of a kernel's bzImage";
        return Err(Diagnostic::new(header, found, allowed));
    };
    let kernel = images::resolve(around.folder, kernel)?;
    let initrd =
        raw.initrd.as_ref().map(|path| images::resolve(around.folder, path)).transpose()?;
    let kind = Kind::Linux {
        kernel: kernel.path.clone(),
        initrd: initrd.as_ref().map(|initrd| initrd.path.clone()),
        cmdline: match &raw.cmdline {
            Some(cmdline) => values::cmdline(cmdline)?,
            None => CMDLINE_DEFAULT.to_owned(),
        },
    };
    let role = match &raw.background {
        Some(background) if *background.get_ref() => Role::Background,
        // Linux waits for no release, so a guard would only be taken from it.
        _ => Role::Windowed { guard: Nanos::ZERO },
    };
    let net = raw.net.0.first().map(|net| (net.span(), "a network interface"));
    let vsock = raw.vsock.as_ref().map(|vsock| (vsock.span(), "the key `vsock`"));
    if let (Role::Windowed { .. }, Some((span, what))) = (&role, net.or(vsock)) {
        let found = format!("{} has windows and {what}", quote(name));
        // A driver that resets the device waits for the kernel's thread that moves the packets.
        let allowed = "`background = true`: what moves the packets runs when no window does, and \
                       a thread with windows must not wait for it";
        return Err(Diagnostic::new(span, found, allowed));
    }
    Ok((kind, role, [kernel].into_iter().chain(initrd).collect()))
}
