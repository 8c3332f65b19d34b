//! The last stages: looking after a run until it is over, letting everything go, and telling how it was.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use takt_scheduler::time::{Nanos, Tsc};

use super::nanos;
use super::output::{Output, Outputs, Patience};
use super::start::{Facts, Running};
use crate::account::Account;
use crate::footprint;
use crate::host_ports::{self, HostPorts};
use crate::prepare::LinuxParts;
use crate::report::{self, Report};
use crate::run_error::RunError;
use crate::samples::{self, Samples};
use crate::screen;
use crate::supervisor::Supervisor;
use crate::terminal;
use crate::vcpu::Control;
use crate::vcpu::thread;
use crate::vhost;

/// How long the end of a run waits until what programs retain is written; who has sent a signal may wait less.
const SAVING: Duration = Duration::from_secs(5);
const SAVING_SHORT: Duration = Duration::from_secs(1);
/// How long the end of a run waits for guests that are being loaded.
const LOADING: Duration = Duration::from_secs(3);
/// How long the end of a run waits for each disk that is busy with its file.
const DISK_PATIENCE: Duration = Duration::from_millis(10);

/// A run whose guests have left.
pub(super) struct Ended {
    report: Report,
    outputs: Outputs,
    /// What has become of the trace and the samples.
    written: Result<(), RunError>,
}

impl Running<'_> {
    /// Looks after the run until it is over.
    pub(super) fn watch(self) -> Result<Ended, RunError> {
        let Running { mut facts, supervisor, threads, waiting, disks, controls, .. } = self;
        let Running { bells, closing, mut outputs, guard, .. } = self;
        let base = facts.epoch.base;
        let start = footprint::now();
        // A supervisor that fails takes its own with it, while guests still run.
        let watchdog = supervisor.watchdog.clone();
        // The time that was asked for is that of the schedule.
        let supervised =
            supervisor.supervise(facts.options.duration.map(|time| Nanos(nanos(time))));
        let process = report::Process { start, end: footprint::now(), starting: facts.starting };
        let duration = base.offset(Tsc::now());
        closing.store(true, Ordering::Relaxed);
        Control::stop_all(&controls);
        for bell in bells {
            // Fails only if it has been rung 2^64 times, and then its thread is awake.
            let _ = bell.write(1);
        }
        // A thread whose guest has ended waits for the word to start it anew, which the
        // supervisor can give no more.
        let (mut supervised, loading) = match supervised.map(Supervisor::without_restarts) {
            Ok((supervisor, loading)) => (Ok(supervisor), loading),
            Err(error) => (Err(error), Vec::new()),
        };
        for thread in threads {
            thread.join();
        }
        if let Ok(supervisor) = &mut supervised {
            supervisor.watchdog = None;
        }
        // No guest with windows is left: from here on the watchdog is not fed, and does not run.
        drop(watchdog);
        facts.close_devices(waiting);
        let report = supervised.map_err(RunError::from).map(|mut supervisor| {
            if supervisor.ended_by_signal {
                outputs.patience = Patience::SHORT;
            }
            let (host_ports, dropped, written) =
                finish(&mut supervisor, &mut outputs, disks, duration);
            outputs.settle();
            let output = report::Output {
                takt_dropped_bytes: supervisor.screen.own_dropped(),
                unread_bytes: outputs.console.unwritten(),
                trace_dropped_events: dropped,
            };
            (facts.report(&supervisor, duration, host_ports, process, output), written)
        });
        // What is being loaded may have a device in its reset, which could not be given back. Values that are retained do not wait
        // for that.
        let until = Instant::now() + LOADING;
        for loading in loading {
            let _ = loading.wait_within(until.saturating_duration_since(Instant::now()));
        }
        drop(guard);
        terminal::restore();
        for name in facts.held_up() {
            let text = format!(
                "\n[takt] {name}: a program of the host holds up its network or socket device, and takt does not come to its end before \
                 that program does; `ss --vsock --processes` shows those with sockets\n"
            );
            // Finds room, if what came before it is read.
            let _ = outputs.console.push(screen::OWN, text.as_bytes());
        }
        match report {
            Ok((report, written)) => Ok(Ended { report, outputs, written }),
            Err(error) => {
                outputs.settle();
                Err(error)
            }
        }
    }
}

impl Facts<'_> {
    /// Takes the devices that the host's kernel works on away from all guests. A guest may wait in a reset of one, and leaves
    /// its thread only then.
    fn close_devices(&mut self, waiting: Vec<thread::Running<()>>) {
        let until = Instant::now() + vhost::PATIENCE;
        for thread in waiting {
            // One that still waits is left to it: it has been told to stop, and its guest does not run any more.
            let _ = thread.join_within(until.saturating_duration_since(Instant::now()));
        }
        self.linux.iter_mut().flatten().for_each(LinuxParts::close_devices);
    }

    /// The Linuxes whose devices are still open.
    fn held_up(&self) -> impl Iterator<Item = &str> {
        let all = self.file.partitions().iter().zip(&self.linux);
        all.filter(|(_, linux)| linux.as_ref().is_some_and(LinuxParts::is_held_up))
            .map(|(partition, _)| partition.name())
    }
}

/// Takes what the supervisor still has, and lets go of what is still held. Gives the ends of channels that are Takt's own, how
/// many events the trace's file has not got, and what has become of the trace and the samples.
fn finish(
    supervisor: &mut Supervisor,
    outputs: &mut Outputs,
    disks: Vec<thread::Running<()>>,
    duration: Nanos,
) -> (Vec<host_ports::Account>, u64, Result<(), RunError>) {
    supervisor.note_endings();
    supervisor.drain();
    let busy =
        disks.into_iter().filter_map(|disk| (!disk.join_within(DISK_PATIENCE)).then_some(()));
    if busy.count() > 0 {
        let text = "a disk still waits for its file, and is left to it";
        supervisor.screen.line("takt", text);
    }
    supervisor.look_at_devices();
    // First: what ends Takt may not wait for recordings, and values that are retained are the plant's memory.
    let most = if supervisor.ended_by_signal { SAVING_SHORT } else { SAVING };
    let saved = supervisor.operators.as_mut().map(|operators| operators.finish(duration, most));
    if let Some(Err(error)) = saved {
        let text = format!("not all retained values are written: {error}");
        supervisor.screen.line("takt", &text);
    }
    supervisor.serve_host_ports(HostPorts::finish);
    supervisor.tell_last_losses();
    let accounts = &supervisor.accounts;
    let (dropped, written) = outputs.finish(supervisor.trace.take(), || Samples {
        schema_version: samples::SCHEMA_VERSION,
        partitions: accounts.iter().filter_map(Account::course).collect(),
        loads: accounts.iter().filter_map(|a| a.load_course(duration)).collect(),
    });
    let host_ports = supervisor.host_ports.as_mut().map_or_else(Vec::new, HostPorts::accounts);
    (host_ports, dropped, written)
}

impl Ended {
    /// Writes the report, and shows it, whatever of the rest could not be written.
    ///
    /// # Errors
    /// The first error of a file.
    pub(super) fn tell(self) -> Result<Report, RunError> {
        let Ended { report, mut outputs, written } = self;
        let patience = outputs.patience;
        let write = |file: Output| file.write(serde_json::to_string_pretty(&report), patience);
        let reported = outputs.report.take().map_or(Ok(()), write);
        // If what came before it was not read, the table would not be read either.
        if report.output.unread_bytes == 0 {
            let table = format!("\n{}", report.table());
            // Finds room: all before it has been written.
            let _ = outputs.console.push(screen::OWN, table.as_bytes());
            outputs.settle();
        }
        written.and(reported).map(|()| report)
    }
}
