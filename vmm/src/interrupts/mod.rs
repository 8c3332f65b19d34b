//! Interrupts of passed-through devices, on their way into a PLC.
//!
//! ```text
//! device -> host's kernel: UIO -> supervisor thread -> eventfd -> KVM: irqfd -> local APIC
//!    ^      (masks the line)                                                        |
//!    |                                                                              v  in a window only
//! supervisor thread <- eventfd <- KVM: ioeventfd <----- out 0x7a18, vector ---- guest
//! (unmasks it, at a bounded rate)
//! ```
//!
//! A line that a device holds until its registers are served is masked by the host with each
//! interrupt, and only the guest knows when it may be opened again. So nothing comes before the
//! guest asks for it, and then one interrupt. What the guest asks for is done by the supervisor thread,
//! [`PER_TICK`] times in a tick at most: whatever device and guest do, the host takes no more
//! interrupts than that.
//!
//! VFIO closes the line and signals by itself: there the way in leads past the supervisor thread, and only
//! the way out through it.
//!
//! A vCPU that is outside its window is not in KVM, and nothing of all this wakes its thread: what
//! has arrived meanwhile waits in its interrupt controller.

pub mod apic;
mod error;
pub mod line;
pub mod route;

use std::io;
use std::os::fd::{AsRawFd, RawFd};
use std::sync::Arc;

use kvm_ioctls::VmFd;
use vmm_sys_util::epoll::{ControlOperation, Epoll, EpollEvent, EventSet};
use vmm_sys_util::eventfd::EventFd;

pub use error::InterruptError;
use line::Line;

/// How often a source is armed between two ticks of the supervisor thread, at most: a thousand times a
/// second.
pub const PER_TICK: u32 = 20;
/// Events that are taken at once.
const EVENTS: usize = 16;

/// The sources of interrupts of all partitions, for the supervisor thread.
pub struct Interrupts {
    sources: Vec<Source>,
    epoll: Epoll,
    /// Interrupts by eventfd end with these handles, so they are kept.
    machines: Vec<VmFd>,
    /// What the user should know and has not been told yet.
    news: Vec<String>,
}

/// What may interrupt a guest, and whether it may just now.
struct Source {
    /// For the user.
    name: String,
    line: Arc<Line>,
    /// Injects.
    signal: EventFd,
    /// Rung by the guest.
    asked: EventFd,
    state: State,
    /// The user knows that it is held back.
    told: bool,
}

/// What becomes of a request of the guest's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// It is done; so many more are until the next tick.
    Open(u32),
    /// It stays where it is until the next tick, and wakes no thread.
    Spent,
    /// The device has failed.
    GivenUp,
}

/// Which descriptor of a source an event is about.
const LINE: u64 = 0;
const ASKED: u64 = 1;

impl Interrupts {
    /// None.
    ///
    /// # Errors
    /// If the host gives no descriptor.
    pub fn new() -> Result<Self, InterruptError> {
        let epoll = Epoll::new().map_err(cannot("watch interrupts"))?;
        Ok(Self { sources: Vec::new(), epoll, machines: Vec::new(), news: Vec::new() })
    }

    /// Gives a partition the interrupts of its devices, by vector. Its machine must have a local
    /// APIC if there are any.
    ///
    /// # Errors
    /// If the host or KVM refuses.
    pub fn attach(
        &mut self,
        partition: &str,
        vm: VmFd,
        lines: &[(u8, Arc<Line>)],
    ) -> Result<(), InterruptError> {
        if lines.is_empty() {
            return Ok(());
        }
        let wires = route::attach(&vm, lines.iter().map(|(vector, _)| *vector))?;
        for ((vector, line), route::Wires { signal, asked }) in lines.iter().zip(wires) {
            let index = self.sources.len() as u64;
            line.connect(&signal).map_err(cannot("connect an interrupt"))?;
            let teller = line.teller().map(|teller| (teller.as_raw_fd(), LINE));
            for (fd, which) in teller.into_iter().chain([(asked.as_raw_fd(), ASKED)]) {
                let event = EpollEvent::new(EventSet::IN, index << 1 | which);
                let added = self.epoll.ctl(ControlOperation::Add, fd, event);
                added.map_err(cannot("watch an interrupt"))?;
            }
            self.sources.push(Source {
                name: format!("interrupt {vector} of {partition}"),
                line: line.clone(),
                signal,
                asked,
                state: State::Open(PER_TICK),
                told: false,
            });
        }
        self.machines.push(vm);
        Ok(())
    }

    /// True if no partition has any.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// A device has interrupted, or a guest has asked for the next time.
    pub fn on_ready(&mut self) {
        let mut events = [EpollEvent::default(); EVENTS];
        let Ok(count) = self.epoll.wait(0, &mut events) else { return };
        for event in events.iter().take(count) {
            let data = event.data();
            let Ok(index) = usize::try_from(data >> 1) else { continue };
            let Some(source) = self.sources.get_mut(index) else { continue };
            let served = match data & 1 {
                ASKED => source.requested(&self.epoll, data),
                _ => source.arrived(),
            };
            if let Err(error) = served {
                self.news.push(source.give_up(&self.epoll, &error));
            }
        }
    }

    /// Another tick has begun.
    pub fn on_tick(&mut self) {
        for (index, source) in (0..).zip(&mut self.sources) {
            let was = source.state;
            if was == State::GivenUp {
                continue;
            }
            source.state = State::Open(PER_TICK);
            if was != State::Spent {
                continue;
            }
            match source.resume(&self.epoll, index << 1 | ASKED) {
                Ok(true) if !source.told => {
                    source.told = true;
                    let text = format!("{}: held back, it is asked for too often", source.name);
                    self.news.push(text);
                }
                Ok(_) => {}
                Err(error) => self.news.push(source.give_up(&self.epoll, &error)),
            }
        }
    }

    /// What has happened that the user should know.
    pub fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }
}

impl AsRawFd for Interrupts {
    fn as_raw_fd(&self) -> RawFd {
        self.epoll.as_raw_fd()
    }
}

impl Source {
    /// Does what the guest asks for. Several requests are one.
    fn requested(&mut self, epoll: &Epoll, data: u64) -> io::Result<()> {
        let State::Open(left) = self.state else { return Ok(()) };
        if self.asked.read().is_err() {
            return Ok(());
        }
        self.state = State::Open(left.saturating_sub(1));
        if left <= 1 {
            self.state = State::Spent;
            let ignored = EpollEvent::new(EventSet::empty(), data);
            epoll.ctl(ControlOperation::Modify, self.asked.as_raw_fd(), ignored)?;
        }
        self.line.arm()
    }

    /// Attends to requests again; true if there is one that had to wait.
    fn resume(&mut self, epoll: &Epoll, data: u64) -> io::Result<bool> {
        let event = EpollEvent::new(EventSet::IN, data);
        epoll.ctl(ControlOperation::Modify, self.asked.as_raw_fd(), event)?;
        let waited = self.asked.read().is_ok();
        if waited {
            self.state = State::Open(PER_TICK - 1);
            self.line.arm()?;
        }
        Ok(waited)
    }

    /// The device has interrupted.
    fn arrived(&self) -> io::Result<()> {
        if self.line.take()? {
            self.signal.write(1)?;
        }
        Ok(())
    }

    /// Nothing of it wakes anybody any more.
    fn give_up(&mut self, epoll: &Epoll, error: &io::Error) -> String {
        self.state = State::GivenUp;
        let teller = self.line.teller().map(AsRawFd::as_raw_fd);
        for fd in teller.into_iter().chain([self.asked.as_raw_fd()]) {
            let _ = epoll.ctl(ControlOperation::Delete, fd, EpollEvent::default());
        }
        format!("{}: given up: {error}", self.name)
    }
}

fn cannot(what: &'static str) -> impl FnOnce(io::Error) -> InterruptError {
    move |source| InterruptError::Host { what, source }
}

#[cfg(test)]
mod tests;
