//! What event tasks wait for.
//!
//! The kernel looks for events whenever it decides who runs: at the start of each window, at each call and
//! end of a job, and at the interrupt of a device. So an event is seen at the latest with the next window, which is what the analysis of the
//! tasks reckons with.
//!
//! The interrupt of a device is let in once, and again when the job that it has released is over: until then the device
//! asks for the same reason still. So at most one comes for each job, however often the device asks. Its handler notes it
//! and leads to the kernel. One that is let in by the kernel is ended when the release of the window is past
//! and its most urgent job is over, if that begins at the release: the end is an exit, which the guard has no time for.

use super::Scheduler;
use super::memory::Area;
use super::ports::{News, Ports};
use takt_kernel::scheduler::Phase;
use takt_kernel::task::{ProgramId, TaskId};
use takt_kernel::time::Instant;
use takt_plc_guest::interrupt;

/// Most event tasks of a partition.
pub const EVENTS: usize = takt_abi::program::EVENTS_MAX;

/// What a task waits for.
#[derive(Clone, Copy, Debug)]
pub enum Source {
    /// A message at a port of the program.
    Port {
        /// The port.
        number: u8,
        /// The stamp of the newest message that has released the task, or that it has read since.
        seen: u64,
    },
    /// The interrupt with this vector.
    Interrupt {
        /// The vector.
        vector: u8,
        /// The device may interrupt.
        armed: bool,
    },
    /// That this bit becomes one.
    Rise {
        /// The byte.
        byte: Area,
        /// What of it.
        mask: u8,
        /// What it was.
        last: bool,
    },
}

/// All event tasks.
#[derive(Debug)]
pub struct Events {
    all: [Option<(TaskId, u8, Source)>; EVENTS],
}

impl Events {
    /// There are none.
    pub const NONE: Self = Self { all: [None; EVENTS] };

    /// One more; false if there is no room.
    pub fn add(&mut self, task: TaskId, program: u8, source: Source) -> bool {
        let slot = self.all.iter_mut().find(|slot| slot.is_none());
        let free = slot.is_some();
        if let Some(slot) = slot {
            *slot = Some((task, program, source));
        }
        free
    }

    /// The state of a program is at another place.
    pub fn follow(&mut self, program: u8, from: Area, to: Area) {
        for (_, of, source) in self.all.iter_mut().flatten() {
            if let Source::Rise { byte, .. } = source
                && *of == program
                && let Some(offset) = byte.start().checked_sub(from.start())
                && from.part(offset, 1).is_some()
            {
                *byte = to.part(offset, 1).unwrap_or(*byte);
            }
        }
    }

    /// A task has read the message with this stamp at a port of its program. If it waits there for messages, this one is none
    /// that it has to be released for.
    pub fn has_read(&mut self, task: TaskId, port: u64, stamp: u64) {
        let mut all = self.all.iter_mut().map_while(Option::as_mut);
        if let Some((.., Source::Port { number, seen })) = all.find(|(of, ..)| *of == task)
            && u64::from(*number) == port
            && stamp != 0
        {
            *seen = stamp;
        }
    }

    /// True if no task waits for one.
    pub const fn is_empty(&self) -> bool {
        self.all[0].is_none()
    }

    /// Looks at all sources.
    ///
    /// Those of a program that is `leaving` its version wait: its jobs are skipped, and what happens now is for the version that
    /// comes back.
    pub fn poll(
        &mut self,
        scheduler: &mut Scheduler,
        ports: &mut Ports,
        now: Instant,
        leaving: impl Fn(u8) -> bool,
    ) {
        let all = self.all.iter_mut().map_while(Option::as_mut);
        for (task, program, source) in all.filter(|(_, program, _)| !leaving(*program)) {
            let happened = match source {
                // A job of the program's last life may have read what is there: it is news to this one.
                Source::Port { seen, .. } if !runs(scheduler, *program) => {
                    *seen = 0;
                    false
                }
                Source::Port { number, seen } => {
                    let news = ports.news(*program, u64::from(*number), seen);
                    if news == News::Waiting {
                        scheduler.signal_again(*task, now);
                    }
                    news == News::Came
                }
                Source::Interrupt { vector, armed } if *armed => {
                    let came = interrupt::taken(*vector);
                    *armed = !came;
                    came
                }
                Source::Interrupt { vector, armed } => {
                    if scheduler.task(*task).awaits_event() {
                        // One that came before was asked for by the guest that ran here before this one.
                        let _ = interrupt::taken(*vector);
                        interrupt::arm(*vector);
                        *armed = true;
                    }
                    false
                }
                Source::Rise { byte, mask, last } => {
                    let mut value = [0];
                    byte.read(&mut value);
                    // No task waits for it before the program runs.
                    let is = value[0] & *mask != 0 && runs(scheduler, *program);
                    let was = core::mem::replace(last, is);
                    is && !was
                }
            };
            if happened {
                scheduler.signal(*task, now);
            }
        }
    }
}

fn runs(scheduler: &Scheduler, program: u8) -> bool {
    scheduler.phase(ProgramId(program)) == Phase::Running
}
