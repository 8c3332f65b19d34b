//! What the event thread does when it is woken.

use std::fs::File;
use std::io::Read;
use std::os::fd::{AsRawFd, RawFd};

use event_manager::{EventOps, EventSet, Events, MutEventSubscriber};

use super::Supervisor;
use crate::account::Account;
use crate::board;
use crate::host_ports::HostPorts;
use crate::interrupts::Interrupts;
use crate::terminal::Key;

/// `Stdin` is buffered by the standard library: only reading through it sees all bytes, and it
/// reads no more than one descriptor event announces.
const STDIN: RawFd = libc::STDIN_FILENO;

impl MutEventSubscriber for Supervisor {
    fn init(&mut self, ops: &mut EventOps) {
        let fds = [
            self.sources.signals.as_raw_fd(),
            self.sources.tick.as_raw_fd(),
            self.sources.deadline.as_raw_fd(),
            self.sources.endings.bell.as_raw_fd(),
        ];
        let host_ports = self.host_ports.as_ref().map(AsRawFd::as_raw_fd);
        let interrupts = self.interrupts.as_ref().map(AsRawFd::as_raw_fd);
        for fd in fds.into_iter().chain(host_ports).chain(interrupts) {
            if ops.add(Events::new_raw(fd, EventSet::IN)).is_err() {
                // Without its events the loop would never end.
                self.running = false;
            }
        }
        // Not every standard input can be waited for: /dev/null and files cannot. Then nobody
        // types.
        let _ = ops.add(Events::new_raw(STDIN, EventSet::IN));
    }

    fn process(&mut self, events: Events, ops: &mut EventOps) {
        let fd = events.fd();
        if fd == STDIN {
            if !self.on_key() {
                let _ = ops.remove(Events::empty_raw(STDIN));
            }
        } else if fd == self.sources.tick.as_raw_fd() {
            let _ = self.sources.tick.wait();
            // Without its tick nothing would be looked after any more.
            self.running &= self.arm_timers().is_ok();
            self.drain();
            if let Some(watchdog) = &mut self.watchdog {
                watchdog.serve(self.desk.now());
            }
            self.accounts.iter().for_each(|a| a.look_for_silence(board::clock()));
            self.look_at_kernels();
            self.watch_schedule();
            self.deliver_typed();
            self.serve_host_ports(HostPorts::on_tick);
            self.serve_interrupts(Interrupts::on_tick);
            self.serve_operators();
        } else if self.host_ports.as_ref().is_some_and(|ports| fd == ports.as_raw_fd()) {
            self.serve_host_ports(HostPorts::on_ready);
        } else if self.interrupts.as_ref().is_some_and(|i| fd == i.as_raw_fd()) {
            self.serve_interrupts(Interrupts::on_ready);
        } else if fd == self.sources.endings.bell.as_raw_fd() {
            let _ = self.sources.endings.bell.read();
            self.note_endings();
            // What an operator has stopped he may start again.
            let goes_on = |a: &Account| a.finished.is_none() || a.orders.stopped();
            self.running &= self.accounts.iter().any(goes_on);
        } else {
            Self::acknowledge(&mut self.sources.signals);
            self.running = false;
        }
    }
}

impl Supervisor {
    fn on_key(&mut self) -> bool {
        // While the guest does not take what was typed, the terminal keeps the rest.
        let mut buffer = [0; 256];
        let read = match self.stdin.lock().read(&mut buffer) {
            Ok(0) | Err(_) => return false,
            Ok(read) => read,
        };
        for key in self.keyboard.take(&buffer[..read]) {
            match key {
                Key::Byte(byte) => self.typed.push(byte),
                Key::Quit => {
                    self.running = false;
                    break;
                }
                Key::NextSchedule => {
                    self.screen.line("takt", &self.desk.ask_for_next());
                }
            }
        }
        self.deliver_typed();
        true
    }

    fn deliver_typed(&mut self) {
        let taken = match &self.console {
            Some(console) => console.type_bytes(&self.typed),
            // Nobody listens.
            None => self.typed.len(),
        };
        self.typed.drain(..taken);
    }

    /// Reads a counter of 8 bytes, or a signal's description, just to be told once.
    fn acknowledge(file: &mut File) {
        let _ = file.read(&mut [0; 128]);
    }
}
