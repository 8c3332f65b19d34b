//! The second stage: machines, images, and threads that wait for the epoch.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use takt_scheduler::switch::ScheduleState;
use takt_scheduler::time::TscFrequency;

use super::held::{Begun, Held};
use super::output::Outputs;
use super::{Options, spawner, this_host};
use crate::appliance::expedited_rcu::ExpeditedRcu;
use crate::config::PartitionFile;
use crate::control::Operators;
use crate::event::{self, eventfd};
use crate::hooks::Steps;
use crate::host_ports::HostPorts;
use crate::huge_pages;
use crate::interrupts::Interrupts;
use crate::live::Live;
use crate::machine::{self, MachineError};
use crate::memory::Pages;
use crate::prepare::{Finish, LinuxLinks, Preparation, Prepared, WindowEnforcer};
use crate::report::Host;
use crate::run_error::RunError;
use crate::screen::Screen;
use crate::steering;
use crate::supervisor::Sources;
use crate::terminal;

/// A run of which nothing is missing but the word to go.
pub(super) struct Waiting<'a> {
    pub file: &'a PartitionFile,
    pub options: &'a Options,
    pub held: &'a Held<'a>,
    pub partitions: Vec<Prepared>,
    pub enforcers: Vec<WindowEnforcer>,
    pub frequency: TscFrequency,
    /// Of which pages the memory of each partition is, in their order.
    pub pages: Vec<Pages>,
    pub board: Arc<ScheduleState>,
    pub finish: Finish,
    pub host_ports: Option<HostPorts>,
    pub operators: Option<Operators>,
    pub outputs: Outputs,
    pub screen: Screen,
    pub sources: Sources,
    /// The machine, for the report.
    pub host: Host,
    pub expedited: ExpeditedRcu,
    pub steps: Steps,
}

impl<'a> Waiting<'a> {
    /// Makes all of it. The terminal, which people need to read an error, is changed last.
    ///
    /// # Errors
    /// See [`RunError`]. Threads that wait are let go.
    pub fn make(
        file: &'a PartitionFile,
        options: &'a Options,
        held: &'a Held<'a>,
        begun: Begun,
    ) -> Result<Self, RunError> {
        let Begun { signals, mut operators, saver, expedited, steps } = begun;
        let before = Instant::now();
        let pages = huge_pages::choose(file.partitions(), options.role)?;
        let choosing = before.elapsed();
        let bell = eventfd()?;
        let schedules = file.schedules();
        let board = Arc::new(ScheduleState::new(schedules.frame(), schedules.tables().len()));
        let spawn = spawner(options);
        let mut preparation = Preparation {
            file,
            kvm: machine::open_kvm()?,
            channels: &held.channels,
            devices: &held.devices,
            pages: &pages,
            retained: &held.retained,
            domains: &held.domains,
            groups: &held.groups,
            bell: event::clone(&bell)?,
            closing: Arc::default(),
            board: board.clone(),
            frequency: None,
            clearing: choosing,
            console: None,
            interrupts: Interrupts::new()?,
            steering: steering::look(),
            hooks: &options.hooks,
            linuxes: LinuxLinks::of(file, &board, &options.hooks)?,
            enforcers: BTreeMap::new(),
            mode: options.seccomp,
            role: options.role,
            spawner: &spawn,
        };
        let mut partitions = Vec::new();
        for partition in file.partitions() {
            partitions.push(preparation.partition(partition)?);
            steps.pass()?;
        }
        let kicks = options.hooks.kicks();
        let enforcers = if kicks { preparation.window_enforcers(&partitions)? } else { Vec::new() };
        steps.pass()?;
        let frequency = preparation.frequency.ok_or(MachineError::Missing("a machine to run"))?;
        if let Some(operators) = &mut operators {
            operators.attach(Live::open(file, &held.channels, &held.retained, saver)?);
        }
        let host_ports =
            HostPorts::open(&held.channels, frequency, options.role.results(), &spawn)?;
        steps.pass()?;
        let outputs = Outputs::open(options, file.partitions().len())?;
        let sources = Sources::new(signals, bell)?;
        steps.pass()?;
        let raw = terminal::make_raw()
            .map_err(|source| RunError::Host { what: "put the terminal into raw mode", source })?;
        let finish = preparation.finish();
        let screen = Screen::new(outputs.console.clone(), raw, file.partitions().len());
        let host = this_host::look(frequency.khz());
        Ok(Self {
            file,
            options,
            held,
            partitions,
            enforcers,
            frequency,
            pages,
            board,
            finish,
            host_ports,
            operators,
            outputs,
            screen,
            sources,
            host,
            expedited,
            steps,
        })
    }
}
