//! The further processors of a Linux, each with a thread of its own.
//!
//! The partition's life is that of its first processor's thread: the supervisor, the loader and the health monitor know no
//! other. What is here makes all of them start and end together:
//!
//! ```text
//!   first thread      runs ---> leaves ---> halts the others ---> has all their ends ---> tells its own
//!                       ^                            |                     ^
//!                halts  |                            v                     |
//!   other thread      runs -------------------> leaves ---> gives its end -+---> waits to be loaded anew
//! ```
//!
//! An end that another processor comes to by itself (it shuts down, or writes the register that switches off) halts the
//! first, and is the partition's. No thread waits for one that is in its guest without a kick on the way to that, and a
//! guest is loaded anew only when all processors have left it.
//!
//! All are threads of the ordinary class. Nothing of this is on the path of a window.

use std::sync::{Arc, Mutex};

use kvm_ioctls::VcpuFd;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Timebase};

use super::Preparation;
use super::spawn::{Seat, wait};
use crate::config::Partition;
use crate::handoff::{Giver, Taker, handoff};
use crate::health::Reporter;
use crate::linux_machine::Processor;
use crate::restart::{Revival, Revivals};
use crate::run_error::RunError;
use crate::sandbox;
use crate::vcpu::guest::{End, Guest};
use crate::vcpu::kick::Kickable;
use crate::vcpu::linux::LinuxGuest;
use crate::vcpu::thread::{self, Place, Ready};
use crate::vcpu::{Control, background};

/// What counts and notes the errors of a partition, for all of its threads. A PLC's has one, which keeps it locked for as
/// long as its guest runs.
pub(super) type Health = Arc<Mutex<Reporter>>;

/// How one of these processors left its guest, and the CPU time that its thread has used so far.
type Left = (End, Nanos);

/// All of them, as the first processor's thread knows them.
#[derive(Default)]
pub(super) struct Crew {
    threads: Vec<(Arc<Control>, Taker<Left>)>,
}

/// All of them, as others know them.
#[derive(Default)]
pub(super) struct Further {
    /// Their threads, ready to run.
    pub threads: Vec<Ready<()>>,
    /// For stopping them.
    pub controls: Vec<Arc<Control>>,
    /// What their guests are loaded anew by.
    pub revivals: Vec<Giver<Revival<LinuxGuest>>>,
}

impl Crew {
    /// Ends all others, now that the first has come to this end, and waits for that. Returns the end of the partition and
    /// the CPU time that they have used.
    pub fn gather(&mut self, first: &Control, end: End) -> Left {
        for (control, _) in &self.threads {
            control.halt();
        }
        let mut all = (end, Nanos::ZERO);
        for (_, left) in &mut self.threads {
            // One that is gone runs nothing.
            if let Ok(Some((end, time))) = left.wait(None) {
                all = (if all.0 == End::Stopped { end } else { all.0 }, all.1.plus(time));
            }
        }
        if !self.threads.is_empty() {
            // One of them may have halted it, and this is where that is taken back.
            first.halted();
        }
        all
    }
}

/// What the thread of a further processor keeps.
struct Member {
    own: Arc<Control>,
    first: Arc<Control>,
    health: Health,
    left: Giver<Left>,
    revivals: Revivals<LinuxGuest>,
}

impl Member {
    fn run(mut self, kickable: &mut Kickable, mut guest: LinuxGuest, base: &Timebase) {
        loop {
            let end = background::run(kickable, &mut guest, &self.own, &self.health, base);
            guest.left();
            // Before the first has this end, since it takes the order back then.
            if end != End::Stopped {
                self.first.halt();
            }
            // There is room: the first has taken the last one before the guest was loaded anew.
            let _ = self.left.give((end, thread::cpu_time()));
            let Some(revival) = wait(&self.own, &mut self.revivals) else { return };
            // Before the first processor can run and come to an end that is theirs too.
            self.own.halted();
            if !revival(kickable, &mut guest) {
                return;
            }
        }
    }
}

impl Preparation<'_> {
    /// Makes the threads of a Linux's further processors, which are on these CPUs.
    pub(super) fn crew(
        &mut self,
        partition: &Partition,
        seat: &Seat,
        processors: impl Iterator<Item = (Cpu, Processor)>,
    ) -> Result<(Crew, Further), RunError> {
        let (mut crew, mut further) = (Crew::default(), Further::default());
        for (number, (cpu, (vcpu, guest))) in (1..).zip(processors) {
            let (left, all_left) = handoff(1);
            let (revive, revivals) = handoff(1);
            let own: Arc<Control> = Arc::default();
            let (first, health) = (seat.control.clone(), seat.health.clone());
            let member = Member { own: own.clone(), first, health, left, revivals };
            let place = Place {
                cpu,
                domain: self.domains.entry(cpu),
                group: self.groups.entry(partition),
                reservation: None,
                ports: Vec::new(),
                doors: (sandbox::Kind::Linux, self.mode),
            };
            let run = move |kickable: &mut Kickable, base| member.run(kickable, guest, &base);
            let name = format!("{}.{number}", partition.name());
            let ready = |_: &mut VcpuFd| Ok(());
            further.threads.push(thread::vcpu(&name, place, own.clone(), vcpu, ready, run)?);
            further.controls.push(own.clone());
            further.revivals.push(revive);
            crew.threads.push((own, all_left));
        }
        Ok((crew, further))
    }
}
