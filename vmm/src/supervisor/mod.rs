//! The supervisor thread: keyboard, screen, clock of the run, and the account of each partition.
//!
//! It is an ordinary thread and may be as late as it likes: vCPU threads never wait for it. They
//! leave what they have to tell in rings, and it looks at those many times a second. Only five
//! things wake it in between: a key, a signal, the end of a partition, a client of a channel, and a
//! device's interrupt.
//!
//! It waits only for its events, since it ends a run, starts guests again and feeds the host's
//! watchdog. What may wait is done by threads of their own: writing to standard output and to files
//! ([`outlet`](crate::outlet)), reading files, loading guests ([`restart`](crate::restart)). What it does in
//! one turn is bounded, whatever guests and clients do.

mod endings;
pub mod error;
mod events;
mod leaving;
mod own_timers;
mod signals;
mod sources;
mod typing;

use std::io;
use std::iter;
use std::os::fd::RawFd;
use std::time::Duration;

use event_manager::{EventManager, SubscriberOps};
use takt_scheduler::guard::Why;
use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Nanos, Timebase, Tsc};

use crate::account::Account;
use crate::console_log::ConsoleLog;
use crate::control::Operators;
use crate::control::protocol::EventKind;
use crate::cpuset::DomainWatch;
use crate::health::Detail;
use crate::host_clock::HostClock;
use crate::host_ports::HostPorts;
use crate::host_ports::ends::Now;
use crate::host_watchdog::SharedWatchdog;
use crate::init_watch::Console;
use crate::interrupts::Interrupts;
use crate::outlet::Trace;
use crate::schedule_requests::ScheduleRequests;
use crate::screen::Screen;
use crate::vhost::LinkWatch;
use error::{SupervisorError, cannot};
use own_timers::OwnTimers;
pub use signals::take_signals;
pub use sources::Sources;
use typing::Typing;

/// The state of the supervisor thread.
pub struct Supervisor {
    /// All partitions, by [`PartitionId`].
    pub accounts: Vec<Account>,
    /// The screen.
    pub screen: Screen,
    /// Where every window is written to, if that is wanted.
    pub trace: Option<Trace>,
    /// The ends of channels that are Takt's own.
    pub host_ports: Option<HostPorts>,
    /// The host's watchdog, if it is served.
    pub watchdog: Option<SharedWatchdog>,
    /// What has an error when the guardian is gone, if there is one. It stays open for longer than this lives.
    pub guardian: Option<RawFd>,
    /// The control socket, if there is one.
    pub operators: Option<Operators>,
    /// What may interrupt PLC guests.
    pub interrupts: Option<Interrupts>,
    /// The clock on which all of it lies.
    pub clock: Option<HostClock>,
    /// The scheduling domains of CPUs with windows.
    pub domains: DomainWatch,
    /// The windows of the CPU that this thread runs on, if there are any.
    pub quiet: Option<QuietTimes>,
    desk: ScheduleRequests,
    /// True if a signal has ended the run: who sent it waits.
    pub ended_by_signal: bool,
    console: Option<Console>,
    typing: Typing,
    /// Whether there may be more keys, and whether they are waited for.
    has_keys: bool,
    listens: bool,
    sources: Sources,
    /// When the run is to end by itself, since the epoch.
    until: Option<Nanos>,
    timers: Option<OwnTimers>,
    running: bool,
    /// Guests have been asked to switch themselves off.
    leaving: bool,
    /// The guests have left.
    over: bool,
}

impl Supervisor {
    /// A supervisor of these partitions.
    #[must_use]
    pub fn new(
        accounts: Vec<Account>,
        desk: ScheduleRequests,
        trace: Option<Trace>,
        screen: Screen,
        console: Option<Console>,
        sources: Sources,
    ) -> Self {
        Self {
            accounts,
            screen,
            trace,
            host_ports: None,
            watchdog: None,
            guardian: None,
            operators: None,
            interrupts: None,
            clock: None,
            domains: DomainWatch::default(),
            quiet: None,
            timers: None,
            desk,
            ended_by_signal: false,
            console,
            typing: Typing::new(sources.typed),
            has_keys: false,
            listens: false,
            sources,
            until: None,
            running: true,
            leaving: false,
            over: false,
        }
    }

    /// Looks after the run until it is as old as `until` says (if given), the user ends it, or no
    /// partition runs any more.
    ///
    /// # Errors
    /// If the event loop fails.
    pub fn supervise(self, until: Option<Nanos>) -> Result<Self, SupervisorError> {
        let mut this = self;
        let (base, now) = (this.desk.base(), this.desk.now());
        this.until = until;
        let looked = this.clock.as_ref().and_then(HostClock::last);
        this.timers = Some(OwnTimers::new(this.quiet.take(), base, now, until, looked));
        this.arm_timers().map_err(cannot("arm a timer"))?;
        let mut events = EventManager::new().map_err(SupervisorError::Events)?;
        let id = events.add_subscriber(this);
        loop {
            events.run().map_err(SupervisorError::Events)?;
            if !events.subscriber_mut(id).map_err(SupervisorError::Events)?.running {
                return events.remove_subscriber(id).map_err(SupervisorError::Events);
            }
        }
    }

    /// Ends the run if it is old enough. The timer goes by a clock that may be steered: it is set again
    /// if it has come too early, and the tick makes up for one that comes too late.
    fn end_in_time(&mut self) {
        if self.until.is_some_and(|until| self.desk.now() >= until) {
            self.leave();
        }
    }

    /// Sets the timers for the next tick and for the end of the run.
    fn arm_timers(&mut self) -> io::Result<()> {
        let (switch, Sources { tick, deadline, .. }) = (self.desk.switch(), &self.sources);
        self.timers.as_mut().map_or(Ok(()), |timers| timers.arm(tick, deadline, switch))
    }

    /// Sets the timer for the end of the run.
    fn arm_end(&self) -> io::Result<()> {
        let (switch, Sources { deadline, .. }) = (self.desk.switch(), &self.sources);
        self.timers.as_ref().map_or(Ok(()), |timers| timers.arm_end(deadline, switch))
    }

    /// Takes everything out of the rings.
    pub fn drain(&mut self) {
        for (id, account) in self.accounts.iter_mut().enumerate() {
            let bytes = account.show(PartitionId(id), &mut self.screen, self.over);
            if let Some(operators) = self.operators.as_mut().filter(|_| !bytes.is_empty()) {
                operators.console(PartitionId(id), &account.name, &bytes);
            }
            if account.is_terminal && !bytes.is_empty() {
                if let Some(kernel) = &mut account.kernel {
                    kernel.printed();
                }
                if let Some(load) = &mut account.load {
                    load.add(&bytes, self.desk.now());
                }
            }
            // What a thread has told by now is in its ring.
            let (base, before) = (self.desk.base(), self.desk.now());
            let (trace, operators) = (&mut self.trace, &mut self.operators);
            let changes = account.take_records(base.frequency, |name, window, detours| {
                if let Some(trace) = trace {
                    trace.add(PartitionId(id), window, detours);
                }
                if let Some(operators) = operators {
                    operators.window(name, window, detours);
                }
            });
            if let Some(absent) = account.look_for_absence(self.desk.switch(), before) {
                let name = account.name.clone();
                account.raise(absent, before, |line| {
                    self.screen.line("takt", &format!("{name}: {line}"));
                    tell(&mut self.operators, before, EventKind::Health, Some(&name), line);
                });
            }
            let Account { name, health, .. } = account;
            let now = base.offset(Tsc::now());
            for change in changes {
                let text = change.to_string();
                // What a good host does is of interest to those who ask.
                if change.why == Why::TooShort {
                    self.screen.line("takt", &format!("{name}: {text}"));
                }
                tell(&mut self.operators, now, EventKind::Guard, Some(name), &text);
            }
            health.take(base, now, |line| {
                self.screen.line("takt", &format!("{name}: {line}"));
                tell(&mut self.operators, now, EventKind::Health, Some(name), line);
            });
        }
    }

    /// Says what of the guests' output was dropped, or is not kept.
    fn tell_losses(&mut self) {
        for account in &self.accounts {
            if let Some(error) = account.log.as_ref().and_then(ConsoleLog::error) {
                self.screen.line("takt", &format!("{}: {error}", account.name));
            }
        }
        for (id, account) in self.accounts.iter().enumerate() {
            self.screen.tell_losses(PartitionId(id), &account.name, account.console_dropped());
        }
        self.screen.tell_own_losses();
    }

    /// Says what of the guests' output was dropped and has not been told of: the run is over.
    pub fn tell_last_losses(&mut self) {
        // Who has sent a signal kills what does not end.
        let most = Duration::from_millis(if self.ended_by_signal { 30 } else { 1_000 });
        for account in &self.accounts {
            let missing = account.log.as_ref().and_then(|log| log.finish(most));
            if let Some(text) = missing {
                self.screen.line("takt", &format!("{}: {text}", account.name));
            }
        }
        let accounts = self.accounts.iter();
        let all = accounts.map(|account| (account.name.as_str(), account.console_dropped()));
        self.screen.tell_last_losses(all);
    }

    /// Lets the ends of channels that are Takt's own do `what`, and says what came of it.
    pub fn serve_host_ports(&mut self, what: fn(&mut HostPorts, &Timebase, Now<'_>)) {
        let Some(ports) = &mut self.host_ports else { return };
        what(ports, &self.desk.base(), &Tsc::now);
        for news in ports.take_news() {
            self.screen.line("takt", &news);
        }
    }

    /// Serves the interrupts of devices by `how`, and says what came of it.
    fn serve_interrupts(&mut self, how: fn(&mut Interrupts)) {
        let Some(interrupts) = &mut self.interrupts else { return };
        how(interrupts);
        for news in interrupts.take_news() {
            self.screen.line("takt", &news);
        }
    }

    /// Says which kernels do nothing any more, which partitions do not come to what must follow, and which devices have errors.
    fn look_at_guests(&mut self) {
        let (base, now) = (self.desk.base(), self.desk.now());
        for account in &mut self.accounts {
            let kernel = account.look_at_kernel(&base, now).map(|news| news.to_string());
            let delay = account.look_for_delay(now).map(str::to_owned);
            for news in kernel.into_iter().chain(delay) {
                let name = &account.name;
                self.screen.line("takt", &format!("{name}: {news}"));
                tell(&mut self.operators, now, EventKind::Health, Some(name), &news);
            }
        }
        self.look_at_devices();
    }

    /// Says which disks have errors, and which devices the host's kernel does not serve; once more when the run is over, since a Linux that switches itself off flushes them just
    /// before.
    pub fn look_at_devices(&mut self) {
        let now = self.desk.now();
        for account in &mut self.accounts {
            let Account { name, disks, links, .. } = account;
            // A disk has two kinds of news at most, a link one; each is told once.
            let disks = disks.iter_mut().flat_map(|disk| iter::from_fn(|| disk.look()));
            for news in disks.chain(links.iter_mut().filter_map(LinkWatch::look)) {
                self.screen.line("takt", &format!("{name}: {news}"));
                tell(&mut self.operators, now, EventKind::Health, Some(name), &news);
            }
        }
    }

    /// Looks whether the host's clock has turned bad, which is an error of every partition.
    fn watch_clock(&mut self) {
        let now = self.desk.now();
        let Some(fault) = self.clock.as_mut().and_then(|clock| clock.look(now)) else { return };
        self.screen.line("takt", &format!("the host's clock has turned bad: {fault}"));
        for account in &mut self.accounts {
            let name = account.name.clone();
            account.raise(Detail::Clock(fault), now, |line| {
                self.screen.line("takt", &format!("{name}: {line}"));
                tell(&mut self.operators, now, EventKind::Health, Some(&name), line);
            });
        }
    }

    /// Says which CPUs have lost their scheduling domains.
    fn watch_domains(&mut self) {
        let now = self.desk.now();
        for news in self.domains.look(now) {
            self.screen.line("takt", &news);
            tell(&mut self.operators, now, EventKind::Health, None, &news);
        }
    }

    /// Says that the guardian has ended. The run goes on: its outputs are not safe only if Takt dies as well.
    fn miss_guardian(&mut self) {
        let text = "the guardian has ended: no safe values are written any more if takt is killed";
        self.screen.line("takt", text);
        tell(&mut self.operators, self.desk.now(), EventKind::Health, None, text);
    }

    /// Says when a switch of the schedule has taken effect.
    fn watch_schedule(&mut self) {
        let Some(switched) = self.desk.poll() else { return };
        let text = switched.to_string();
        self.screen.line("takt", &text);
        tell(&mut self.operators, switched.offset, EventKind::Schedule, None, &text);
        if let Some(trace) = &mut self.trace {
            trace.switch(switched.at, switched.schedule);
        }
        if let Some(operators) = &mut self.operators {
            operators.switch(switched.at, switched.schedule);
        }
    }

    /// Answers the clients of the control socket.
    fn serve_operators(&mut self) {
        let Some(operators) = &mut self.operators else { return };
        let host_ports = self.host_ports.as_mut();
        for (name, outcome) in operators.serve(&mut self.accounts, host_ports, &self.desk) {
            self.screen.line("takt", &format!("{name}: {}", outcome.text));
            let now = self.desk.now();
            tell(&mut self.operators, now, outcome.kind, Some(&name), &outcome.text);
        }
    }
}

/// Tells the clients of the control socket of an event.
fn tell(
    operators: &mut Option<Operators>,
    at: Nanos,
    kind: EventKind,
    partition: Option<&str>,
    text: &str,
) {
    if let Some(operators) = operators {
        operators.tell(at, kind, partition, text);
    }
}
