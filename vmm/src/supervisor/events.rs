//! What the supervisor thread does when it is woken.

use std::fs::File;
use std::io::Read;
use std::os::fd::{AsRawFd, RawFd};
use std::time::Instant;

use event_manager::{EventOps, EventSet, Events, MutEventSubscriber};

use super::Supervisor;
use crate::account::Account;
use crate::control::protocol::State;
use crate::host_ports::HostPorts;
use crate::interrupts::Interrupts;
use crate::linux_machine;
use crate::terminal::Key;

const STDIN: RawFd = libc::STDIN_FILENO;

impl MutEventSubscriber for Supervisor {
    fn init(&mut self, ops: &mut EventOps) {
        let fds = [
            self.sources.signals.as_raw_fd(),
            self.sources.tick.as_raw_fd(),
            self.sources.deadline.as_raw_fd(),
            self.sources.endings.as_raw_fd(),
        ];
        let host_ports = self.host_ports.as_ref().map(AsRawFd::as_raw_fd);
        let interrupts = self.interrupts.as_ref().map(AsRawFd::as_raw_fd);
        for fd in fds.into_iter().chain(host_ports).chain(interrupts) {
            if ops.add(Events::new_raw(fd, EventSet::IN)).is_err() {
                // Without its events the loop would never end.
                self.running = false;
            }
        }
        // Of an error one is told without asking.
        if let Some(guardian) = self.guardian {
            self.running &= ops.add(Events::new_raw(guardian, EventSet::empty())).is_ok();
        }
        // Not every standard input can be waited for: /dev/null and files cannot. Then nothing
        // is typed.
        self.listens = self.sources.keys && ops.add(Events::new_raw(STDIN, EventSet::IN)).is_ok();
        self.has_keys = self.listens;
    }

    fn process(&mut self, events: Events, ops: &mut EventOps) {
        let fd = events.fd();
        if fd == STDIN {
            self.on_key();
            self.listen(ops);
        } else if fd == self.sources.tick.as_raw_fd() {
            let _ = self.sources.tick.wait();
            // First, and before anything that a guest could make long.
            if let Some(watchdog) = &self.watchdog {
                watchdog.borrow_mut().serve(self.desk.now());
            }
            // Without its tick nothing would be looked after any more.
            self.running &= self.arm_timers().is_ok();
            self.screen.tick(Instant::now());
            self.drain();
            self.tell_losses();
            let (switch, now) = (self.desk.switch(), self.desk.now());
            for account in &mut self.accounts {
                account.look_for_silence(linux_machine::clock(), switch, now);
            }
            self.look_at_guests();
            self.watch_clock();
            self.watch_domains();
            self.watch_schedule();
            self.deliver_typed();
            if let Some(dropped) = self.typing.tick() {
                let text =
                    format!("keyboard: {dropped} bytes dropped: the guest did not take them");
                self.screen.line("takt", &text);
            }
            self.listen(ops);
            self.serve_host_ports(HostPorts::on_tick);
            self.serve_interrupts(Interrupts::on_tick);
            self.serve_operators();
            self.end_in_time();
        } else if fd == self.sources.deadline.as_raw_fd() {
            let _ = self.sources.deadline.wait();
            self.end_in_time();
            if self.running {
                // It came too early, by a clock that is steered. The tick ends the run if this fails.
                let _ = self.arm_end();
            }
        } else if self.guardian == Some(fd) {
            let _ = ops.remove(events);
            self.miss_guardian();
        } else if self.host_ports.as_ref().is_some_and(|ports| fd == ports.as_raw_fd()) {
            self.serve_host_ports(HostPorts::on_ready);
        } else if self.interrupts.as_ref().is_some_and(|i| fd == i.as_raw_fd()) {
            self.serve_interrupts(Interrupts::on_ready);
        } else if fd == self.sources.endings.as_raw_fd() {
            let _ = self.sources.endings.read();
            self.note_endings();
            // What an operator has stopped he may start again.
            let goes_on = |a: &Account| a.life.state() != State::Ended;
            self.running &= self.accounts.iter().any(goes_on);
            self.running &= !self.leaving || self.awaits_power_off();
        } else {
            // The time of the run is over, or somebody has sent a signal.
            self.ended_by_signal |= fd == self.sources.signals.as_raw_fd();
            Self::acknowledge(&mut self.sources.signals);
            self.leave();
        }
    }
}

impl Supervisor {
    fn on_key(&mut self) {
        let Some(keys) = self.typing.take() else {
            self.has_keys = false;
            return;
        };
        for key in keys {
            match key {
                Key::Byte(byte) => self.typing.keep(byte),
                Key::Quit => {
                    self.leave();
                    break;
                }
                Key::NextSchedule => {
                    self.screen.line("takt", &self.desk.ask_for_next());
                }
            }
        }
        self.deliver_typed();
    }

    /// Waits for keys, or does not, while none may be read: they would wake this thread without end.
    fn listen(&mut self, ops: &mut EventOps) {
        let listens = self.has_keys && self.typing.may_read();
        if listens != self.listens {
            let keys = Events::new_raw(STDIN, EventSet::IN);
            let changed = if listens { ops.add(keys) } else { ops.remove(keys) };
            if changed.is_ok() {
                self.listens = listens;
            }
        }
    }

    fn deliver_typed(&mut self) {
        let console = self.console.as_ref();
        // Without a console it is discarded.
        self.typing.deliver(|bytes| console.map_or(bytes.len(), |c| c.type_bytes(bytes)));
    }

    /// Reads a counter of 8 bytes, or a signal's description, just to be told once.
    fn acknowledge(file: &mut File) {
        let _ = file.read(&mut [0; 128]);
    }
}
