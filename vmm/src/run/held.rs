//! The first stage: what a run takes of the host, before anything is made for a guest.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use super::spawner;
use super::{Options, own_process};
use crate::appliance::expedited_rcu::ExpeditedRcu;
use crate::channels::Channels;
use crate::config::{Channel, HostPort, PartitionFile, Program};
use crate::control::{Door, Operators};
use crate::cpuset::Domains;
use crate::hooks::Steps;
use crate::passthrough::guardian::Guardian;
use crate::passthrough::{Devices, emergency_stop};
use crate::resctrl::Groups;
use crate::run_error::RunError;
use crate::sandbox::{self, Allowed};
use crate::saver::{Files, Saver};
use crate::supervisor::take_signals;
use crate::terminal;
use crate::vcpu::kick;

/// What is held until all threads have been let go. Each field gives back what it has at its drop, and they are dropped
/// in this order: what was taken last goes first. The CPUs come last, since a thread that hangs may keep them for a while, and
/// devices need not wait for it.
pub(super) struct Held<'a> {
    /// Shares of the cache and of the way to memory.
    pub groups: Groups,
    /// Files of what programs retain.
    pub retained: Files,
    /// The memory between partitions.
    pub channels: Channels<'a>,
    /// Dropped after all threads have written their safe values.
    pub guardian: Option<Guardian>,
    /// Devices of partitions.
    pub devices: Devices,
    /// CPUs with a scheduling domain of their own.
    pub domains: Domains,
}

/// What the next stage takes over.
pub(super) struct Begun {
    pub signals: File,
    pub operators: Option<Operators>,
    /// What writes retained values.
    pub saver: Option<Saver>,
    /// Until the first guest runs.
    pub expedited: ExpeditedRcu,
    pub steps: Steps,
}

impl<'a> Held<'a> {
    /// Takes all of it.
    ///
    /// # Errors
    /// See [`RunError`]. What was taken by then is given back.
    pub fn take(
        file: &'a PartitionFile,
        queues: &'a [Channel],
        options: &Options,
    ) -> Result<(Self, Begun), RunError> {
        let steps = options.hooks.steps();
        sandbox::prepare(|| {
            let written = emergency_stop::do_it();
            terminal::restore();
            written
        })?;
        let signals = take_signals()?;
        own_process::stay_alive();
        own_process::outlive_a_full_file();
        terminal::ignore_job_control();
        own_process::lock_memory()?;
        steps.pass()?;
        kick::install().map_err(|e| io::Error::from_raw_os_error(e.errno())).map_err(|source| {
            RunError::Host { what: "install the kick's signal handler", source }
        })?;
        let viewers = file.viewers().filter(|_| !options.role.owns_machine());
        let door = control(file, options).map(|path| Door::open(path, viewers)).transpose()?;
        steps.pass()?;
        let devices = Devices::take(file, options.role)?;
        steps.pass()?;
        // While there is no guest and no thread that it would be a copy of.
        let guardian = devices.guardian(options.seccomp)?;
        steps.pass()?;
        let channels = Channels::new(file.channels())?.with_live(queues)?;
        let mut retained = Files::open(file)?;
        let keeps = |program: &Program| program.place.retained_bytes > 0;
        let retains = file.partitions().iter().any(|p| p.programs().iter().any(keeps));
        let operators = (door.is_some() || retains)
            .then(|| Operators::new(door, file, &channels))
            .transpose()?;
        steps.pass()?;
        let expedited = ExpeditedRcu::begin(options.role);
        let domains = Domains::set_up(file.schedules())?;
        steps.pass()?;
        let groups = Groups::set_up(file.partitions())?;
        steps.pass()?;
        let saver = retained.start(&spawner(options))?;
        let held = Self { groups, retained, channels, guardian, devices, domains };
        Ok((held, Begun { signals, operators, saver, expedited, steps }))
    }

    /// What is still to be changed in the file system at the end of the run.
    pub fn given_back(&self, file: &PartitionFile, options: &Options) -> Vec<Allowed> {
        let figures = Allowed::Read("/proc/self".into());
        let ends = file.channels().iter().filter_map(|channel| match &channel.host {
            Some(HostPort::Socket(path)) if options.role.results().is_none() => {
                Some(path.as_path())
            }
            _ => None,
        });
        let sockets = control(file, options).into_iter().chain(ends);
        let sockets = sockets.map(|socket| Allowed::RemoveFiles(folder_of(socket)));
        let cgroups = self.domains.root().into_iter().chain(self.groups.root());
        let cgroups = cgroups.map(Allowed::WriteAndRemoveFolders);
        let devices = self.devices.folders().into_iter().map(Allowed::GiveBack);
        [figures].into_iter().chain(sockets).chain(cgroups).chain(devices).collect()
    }
}

/// Where the control socket is to be.
fn control<'a>(file: &'a PartitionFile, options: &'a Options) -> Option<&'a Path> {
    options.control.as_deref().or(file.control())
}

fn folder_of(file: &Path) -> PathBuf {
    file.parent().filter(|folder| *folder != "").map_or_else(|| ".".into(), Path::to_owned)
}
