//! The deadlines of a Linux's timer, kept out of the windows of others on its CPU.
//!
//! Linux programs its timer by writing an instant into a register (`IA32_TSC_DEADLINE`). While its
//! vCPU does not run, KVM keeps that as a timer of the host, on the same CPU and in hard interrupt
//! context: it goes off on top of a PLC's release as well. So these writes come to Takt, by KVM's filter
//! for model-specific registers (`Documentation/virt/kvm/api.rst`, KVM_X86_SET_MSR_FILTER), and the
//! thread of Linux's vCPU sets a deadline that would fall into a quiet time to the end of that
//! ([`QuietTimes::defer`]). In between Linux could not have been served anyway, but for what a PLC
//! leaves of its window: so a PLC that is done early has the deadline put back, by a kick of Linux's
//! thread. The same kick makes that thread look again when the schedule is about to change.
//!
//! Writes to the guest's TSC come here too and are dropped: it would otherwise have another clock than
//! the schedule, and its deadlines another meaning. So are those to all other registers that are kept from KVM
//! ([`registers`](crate::registers)).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use kvm_bindings::{Msrs, kvm_msr_entry};
use kvm_ioctls::{VcpuFd, WriteMsrExit};
use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::time::{Timebase, Tsc};

use super::Control;
use super::guest::{End, Guest, KvmFailure};
use crate::registers::TSC_DEADLINE;

/// What the threads of one CPU know of the timer of a Linux's processor there.
pub struct Deadlines {
    /// `None` where no deadline is to be moved: on a CPU without windows of others.
    quiet: Option<QuietTimes>,
    board: Arc<ScheduleState>,
    /// Of the thread of Linux's vCPU, once there is one that a kick can have look.
    thread: OnceLock<Arc<Control>>,
    /// The deadline that waits for the end of a quiet time, as a TSC value; 0 if none does.
    waiting: AtomicU64,
    /// Whether the place of the deadline is to be looked for again.
    again: AtomicBool,
    counts: Counts,
}

/// What became of the deadlines so far.
#[derive(Debug, Default)]
struct Counts {
    programmed: AtomicU64,
    moved: AtomicU64,
    put_back: AtomicU64,
}

/// What became of a Linux's deadlines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Told {
    /// How often Linux has programmed its timer.
    pub programmed: u64,
    /// Deadlines that lay in a quiet time, and were moved.
    pub moved: u64,
    /// Of those: put back, since the PLC was done early or the schedule changed.
    pub put_back: u64,
}

impl Deadlines {
    /// For a processor whose deadlines are to stay out of these times.
    #[must_use]
    pub fn new(quiet: Option<QuietTimes>, board: Arc<ScheduleState>) -> Self {
        Self {
            quiet,
            board,
            thread: OnceLock::new(),
            waiting: AtomicU64::new(0),
            again: AtomicBool::new(false),
            counts: Counts::default(),
        }
    }

    /// Says which thread runs Linux's vCPU, if that has no windows of its own. One that has looks at the beginning of its
    /// window, and a kick could only wake it before. Before any of them runs.
    pub fn served_by(&self, thread: Arc<Control>) {
        // There is one such thread, which is told once.
        let _ = self.thread.set(thread);
    }

    /// The owner of the window that ends at `end` has given the rest of it back.
    pub fn window_given_back(&self, end: Tsc) {
        let waiting = self.waiting.load(Ordering::SeqCst);
        if waiting != 0 && waiting < end.0 {
            self.look_again();
        }
    }

    /// Has the deadline's place looked for again: the schedule changes.
    pub fn look_again(&self) {
        // A kick would find nothing to move.
        if self.quiet.is_none() {
            return;
        }
        // Until it has looked, one kick is enough.
        if self.again.swap(true, Ordering::SeqCst) {
            return;
        }
        if let Some(thread) = self.thread.get() {
            thread.kick();
        }
    }

    /// What became of the deadlines so far.
    #[must_use]
    pub fn told(&self) -> Told {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let Counts { programmed, moved, put_back } = &self.counts;
        Told { programmed: of(programmed), moved: of(moved), put_back: of(put_back) }
    }
}

impl Told {
    /// What became of the deadlines of all processors; `None` if Takt places none.
    #[must_use]
    pub fn of(all: &[Arc<Deadlines>]) -> Option<Told> {
        let sum = |sum: Told, told: Told| Told {
            programmed: sum.programmed + told.programmed,
            moved: sum.moved + told.moved,
            put_back: sum.put_back + told.put_back,
        };
        all.iter().map(|deadlines| deadlines.told()).reduce(sum)
    }
}

/// The timer, as the thread that runs the vCPU has it.
pub struct GuestTimer {
    deadlines: Arc<Deadlines>,
    /// What Linux has asked for last; 0 for none.
    wanted: Tsc,
    /// What was set instead.
    set: Tsc,
    /// One register, so that nothing is allocated for it each time.
    register: Msrs,
}

impl GuestTimer {
    /// The timer of a new vCPU; `None` if one register is too many.
    #[must_use]
    pub fn new(deadlines: Arc<Deadlines>) -> Option<Self> {
        let entry = kvm_msr_entry { index: TSC_DEADLINE, ..Default::default() };
        let register = Msrs::from_entries(&[entry]).ok()?;
        Some(Self { deadlines, wanted: Tsc(0), set: Tsc(0), register })
    }

    /// The vCPU runs no more: nothing waits.
    pub fn left(&self) {
        self.deadlines.waiting.store(0, Ordering::SeqCst);
    }

    fn program(
        &mut self,
        vcpu: &VcpuFd,
        deadline: Tsc,
        base: &Timebase,
    ) -> Result<(), kvm_ioctls::Error> {
        self.deadlines.counts.programmed.fetch_add(1, Ordering::Relaxed);
        self.wanted = deadline;
        let place = self.place(base);
        if place > self.wanted {
            self.deadlines.counts.moved.fetch_add(1, Ordering::Relaxed);
        }
        self.set(vcpu, place)
    }

    /// Looks again where the deadline belongs, if somebody wants that. Costs a load otherwise.
    fn look_again(&mut self, vcpu: &VcpuFd, base: &Timebase) -> Result<(), kvm_ioctls::Error> {
        let again = &self.deadlines.again;
        if !again.load(Ordering::SeqCst) {
            return Ok(());
        }
        again.store(false, Ordering::SeqCst);
        // What has expired already must not do so twice, and waits for no window any more.
        if self.wanted == Tsc(0) || self.set <= Tsc::now() {
            self.left();
            return Ok(());
        }
        let place = self.place(base);
        if place == self.set {
            return Ok(());
        }
        let counts = &self.deadlines.counts;
        if self.set == self.wanted {
            counts.moved.fetch_add(1, Ordering::Relaxed);
        }
        if place == self.wanted {
            counts.put_back.fetch_add(1, Ordering::Relaxed);
        }
        self.set(vcpu, place)
    }

    /// Where the wanted deadline is to lie now; never before it.
    fn place(&self, base: &Timebase) -> Tsc {
        let (wanted, deadlines) = (self.wanted, &self.deadlines);
        // Before the epoch there are no windows.
        let moved = deadlines.quiet.as_ref().filter(|_| wanted > base.epoch).and_then(|quiet| {
            let now = base.offset(Tsc::now());
            quiet.defer(base.offset(wanted), now, deadlines.board.switch())
        });
        let place = moved.map_or(wanted, |at| base.instant(at).max(wanted));
        deadlines.waiting.store(if place > wanted { wanted.0 } else { 0 }, Ordering::SeqCst);
        place
    }

    fn set(&mut self, vcpu: &VcpuFd, place: Tsc) -> Result<(), kvm_ioctls::Error> {
        self.set = place;
        for entry in self.register.as_mut_slice() {
            entry.data = place.0;
        }
        vcpu.set_msrs(&self.register).map(drop)
    }
}

/// A write to a model-specific register that the filter hands over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    index: u32,
    value: u64,
}

/// Takes a write over, which is thereby answered: it succeeds.
#[must_use]
pub fn take(exit: WriteMsrExit<'_>) -> Write {
    *exit.error = 0;
    Write { index: exit.index, value: exit.data }
}

/// Does what a write asks for.
///
/// # Errors
/// The guest's end, if it has no such timer, or KVM cannot set the deadline.
pub fn write(
    guest: &mut impl Guest,
    vcpu: &VcpuFd,
    write: Write,
    base: &Timebase,
) -> Result<(), End> {
    let timer = guest.timer().ok_or(End::Kvm(KvmFailure::UnexpectedExit))?;
    if write.index == TSC_DEADLINE {
        timer.program(vcpu, Tsc(write.value), base).map_err(failed)?;
    }
    Ok(())
}

/// To be called after kicks have been forgotten and before the guest is entered: places its deadline
/// anew, if that was the reason for one.
///
/// # Errors
/// As for [`write()`].
pub fn look_again(guest: &mut impl Guest, vcpu: &VcpuFd, base: &Timebase) -> Result<(), End> {
    guest.timer().map_or(Ok(()), |timer| timer.look_again(vcpu, base)).map_err(failed)
}

fn failed(error: kvm_ioctls::Error) -> End {
    End::Kvm(KvmFailure::Errno(error.errno()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use takt_devices::ports::PortBus;
    use takt_devices::power::PowerLine;
    use takt_scheduler::schedules::Schedules;
    use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};
    use takt_scheduler::time::{Nanos, Ticks, TscFrequency};

    use crate::vcpu::linux::{Board, LinuxGuest};

    const FRAME: Nanos = Nanos::from_millis(60_000);

    /// A timer beside a PLC with a window of 10 s in a minute, whose first begins 20 s from now.
    fn timer() -> (GuestTimer, Timebase) {
        let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::from_micros(20) } };
        let window = Window {
            partition: PartitionId(0),
            offset: Nanos::from_millis(20_000),
            duration: Nanos::from_millis(10_000),
            period: FRAME,
        };
        let schedules = Schedules::new(FRAME, &[plc], &[&[window]]).unwrap();
        let quiet = schedules.quiet_on(Cpu(0), None).unwrap();
        let deadlines = Deadlines::new(Some(quiet), Arc::new(ScheduleState::new(FRAME, 1)));
        let frequency = TscFrequency::from_khz(2_399_987).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        (GuestTimer::new(Arc::new(deadlines)).unwrap(), base)
    }

    #[test]
    fn a_deadline_waits_while_it_lies_in_a_window() {
        let (mut timer, base) = timer();
        let at = |ms| base.instant(Nanos::from_millis(ms));
        timer.wanted = at(25_000);
        let place = timer.place(&base);
        assert_eq!(place, base.instant(Nanos(30_000_005_000)));
        assert_eq!(timer.deadlines.waiting.load(Ordering::SeqCst), timer.wanted.0);
        for free in [at(10_000), at(31_000), Tsc(0), base.epoch.before(Ticks(9)), Tsc(u64::MAX)] {
            timer.wanted = free;
            assert_eq!(timer.place(&base), free);
            assert_eq!(timer.deadlines.waiting.load(Ordering::SeqCst), 0);
        }
    }

    #[test]
    fn only_a_window_that_the_deadline_waits_for_asks_for_another_look() {
        let (mut timer, base) = timer();
        let at = |ms| base.instant(Nanos::from_millis(ms));
        let asked = |timer: &GuestTimer| timer.deadlines.again.load(Ordering::SeqCst);
        timer.deadlines.window_given_back(at(30_000));
        assert!(!asked(&timer), "none waits");
        timer.wanted = at(85_000);
        timer.place(&base);
        timer.deadlines.window_given_back(at(30_000));
        assert!(!asked(&timer), "it waits for a later one");
        timer.deadlines.window_given_back(at(90_000));
        assert!(asked(&timer));
    }

    #[test]
    fn where_no_deadline_is_moved_none_is_looked_at_again() {
        let board = Arc::new(ScheduleState::new(FRAME, 2));
        let free = Deadlines::new(None, board);
        free.look_again();
        assert!(!free.again.load(Ordering::SeqCst));
    }

    #[test]
    fn a_linux_that_has_left_is_not_kicked_for_a_deadline() {
        let (mut timer, base) = timer();
        let deadlines = timer.deadlines.clone();
        timer.wanted = base.instant(Nanos::from_millis(85_000));
        timer.place(&base);
        let (ports, power) = (PortBus::default(), PowerLine::default());
        let board = Board { ports, power, virtio: Vec::new() };
        let mut guest = LinuxGuest::on(Arc::new(Mutex::new(board))).with_timer(Some(timer));
        guest.left();
        deadlines.window_given_back(base.instant(Nanos::from_millis(90_000)));
        assert!(!deadlines.again.load(Ordering::SeqCst));
    }
}
