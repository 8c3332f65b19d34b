//! The vCPU thread's side: count, and leave a note.
//!
//! It runs on the PLC's path, so each error costs the same small amount: an addition, a look at the table, a push into
//! a ring of its own, and, unless many notes wait already, one system call for the address of the instruction. (The
//! ring of the windows would do, but a guest that floods it with errors would cost its own figures.) What does not fit
//! is missing from the notes and shows as a gap in their numbers; the counts are always whole.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use kvm_ioctls::{VcpuExit, VcpuFd};
use rtrb::{Consumer, Producer, RingBuffer};
use takt_scheduler::time::Tsc;

use super::bus_locks::{self, BusLocks};
use super::detail::{Access, Detail};
use super::{Action, Table};
use super::{FAULTS, Fault};
use crate::vcpu::guest::{End, Guest, Step};

/// Notes that the supervisor thread may be behind: it looks fifty times a second.
const NOTES: usize = 1024;

/// Notes that may wait before no more system calls are made for further ones: as many as a report
/// lists.
const WITH_ADDRESS: usize = 32;

/// How often each error happened.
#[derive(Debug, Default)]
pub struct Counts([AtomicU64; FAULTS.len()]);

impl Counts {
    /// Of one error.
    #[must_use]
    pub fn of(&self, fault: Fault) -> u64 {
        self.0[fault as usize].load(Ordering::Relaxed)
    }

    pub(super) fn add(&self, fault: Fault, times: u64) {
        self.0[fault as usize].fetch_add(times, Ordering::Relaxed);
    }
}

/// A note of an error that the guest survived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occurrence {
    /// Place among the notes of its partition, from 0, those counted that did not fit.
    pub sequence: u64,
    /// When it was seen.
    pub at: Tsc,
    /// What is known of it.
    pub detail: Detail,
}

/// What an exit led to, before the table was asked.
pub struct Answer {
    step: Step,
    /// The exit's access, and how many of its parts nothing answered.
    illegal: Option<(Access, u64)>,
}

impl Answer {
    /// Lets the guest's side answer an exit.
    pub fn to(exit: VcpuExit<'_>, guest: &mut impl Guest) -> Answer {
        Self::by(Access::of(&exit), guest, |guest| guest.handle(exit))
    }

    /// The answer that `handle` gives to an exit with this access.
    pub fn by<G: Guest>(
        access: Option<Access>,
        guest: &mut G,
        handle: impl FnOnce(&mut G) -> Step,
    ) -> Answer {
        let before = guest.illegal_accesses();
        let step = handle(guest);
        let count = guest.illegal_accesses().saturating_sub(before);
        Answer { step, illegal: access.filter(|_| count > 0).map(|access| (access, count)) }
    }
}

/// Counts and notes the errors of one partition.
pub struct Reporter {
    table: Table,
    counts: Arc<Counts>,
    notes: Producer<Occurrence>,
    sequence: u64,
    bus_locks: BusLocks,
}

impl Reporter {
    /// A reporter that goes by this table, and the ends of what it leaves for the supervisor thread.
    #[must_use]
    pub fn new(table: Table) -> (Reporter, Arc<Counts>, Consumer<Occurrence>) {
        let (notes, consumer) = RingBuffer::new(NOTES);
        let counts: Arc<Counts> = Arc::default();
        let (own, bus_locks) = (counts.clone(), BusLocks::default());
        (Reporter { table, counts: own, notes, sequence: 0, bus_locks }, counts, consumer)
    }

    /// With a limit for bus locks.
    #[must_use]
    pub fn with_bus_locks(self, bus_locks: BusLocks) -> Self {
        Self { bus_locks, ..self }
    }

    /// Reports what is wrong with an answer, and a bus lock that came with its exit. Returns what to do
    /// with the guest; `vcpu` is asked for the place of the error.
    pub fn conclude(&mut self, answer: Answer, vcpu: &mut VcpuFd) -> Step {
        let step = self.answered(answer, vcpu);
        if !bus_locks::happened(vcpu) || !self.bus_locks.count(Instant::now()) {
            return step;
        }
        let rip = self.place(Fault::BusLock, vcpu);
        self.bus_locked(step, rip)
    }

    fn answered(&mut self, answer: Answer, vcpu: &VcpuFd) -> Step {
        let raised = match (answer.step, answer.illegal) {
            (Step::Raised(detail), _) => self.raise(detail, 1),
            (step @ Step::Ended(_), _) | (step, None) => return step,
            (_, Some((access, count))) => {
                let rip = self.place(Fault::IllegalRequest, vcpu);
                self.raise(Detail::Access(Access { rip, ..access }), count)
            }
        };
        match (raised, answer.step) {
            (Some(end), _) => Step::Ended(end),
            (None, Step::Raised(_)) => Step::Resume,
            (None, step) => step,
        }
    }

    /// A bus lock too many, beside what else follows from the exit.
    fn bus_locked(&mut self, step: Step, rip: Option<u64>) -> Step {
        match (step, self.raise(Detail::BusLock(rip), 1)) {
            (Step::Ended(_), _) | (_, None) => step,
            (_, Some(end)) => Step::Ended(end),
        }
    }

    /// Where the guest is, if the error is told and few wait to be.
    fn place(&self, fault: Fault, vcpu: &VcpuFd) -> Option<u64> {
        let told = self.table.action(fault) != Action::Ignore;
        let waiting = NOTES - self.notes.slots();
        let asked = (told && waiting < WITH_ADDRESS).then(|| vcpu.get_regs().ok());
        asked.flatten().map(|registers| registers.rip)
    }

    /// Reports an error that the guest survives, `times` times at once. Returns its end if the
    /// table does not let it go on.
    pub fn raise(&mut self, detail: Detail, times: u64) -> Option<End> {
        let fault = detail.fault();
        self.counts.add(fault, times);
        match self.table.action(fault) {
            Action::Ignore => None,
            Action::Log => {
                let sequence = self.sequence;
                self.sequence += 1;
                // A full ring shows as a gap in the numbers.
                let _ = self.notes.push(Occurrence { sequence, at: Tsc::now(), detail });
                None
            }
            Action::Idle | Action::ColdStart | Action::WarmStart | Action::ShutDown => {
                Some(End::Raised(detail))
            }
        }
    }

    /// Counts the error that an end is, if that was not done when it was raised.
    pub fn end(&mut self, end: End) {
        match end {
            End::Raised(_) => {}
            end => {
                if let Some(fault) = end.fault() {
                    self.counts.add(fault, 1);
                }
            }
        }
    }

    /// How many notes there have been.
    #[must_use]
    pub fn noted(&self) -> u64 {
        self.sequence
    }
}

#[cfg(test)]
mod tests {
    use super::super::ACTIONS;
    use super::*;

    const LOST: Detail = Detail::Lost(1, 7);

    #[test]
    fn a_bus_lock_is_an_error_of_its_own_beside_what_else_an_exit_is() {
        for action in ACTIONS {
            let table = Table::LINUX.with(Fault::BusLock, action);
            let (mut reporter, counts, _notes) = Reporter::new(table);
            let end = Step::Ended(End::Raised(Detail::BusLock(Some(7))));
            let goes_on = |step| if action.goes_on() { step } else { end };
            for step in [Step::Resume, Step::Done] {
                assert_eq!(reporter.bus_locked(step, Some(7)), goes_on(step), "{action}");
            }
            // An end stays the end that it is.
            let ended = Step::Ended(End::TripleFault);
            assert_eq!(reporter.bus_locked(ended, None), ended, "{action}");
            assert_eq!(counts.of(Fault::BusLock), 3);
        }
    }

    #[test]
    fn what_the_table_does_not_let_go_on_ends_at_once() {
        for action in ACTIONS {
            let table = Table::PLC.with(Fault::DeadlineMissed, action);
            let (mut reporter, counts, mut notes) = Reporter::new(table);
            let end = reporter.raise(LOST, 3);
            assert_eq!(end, (!action.goes_on()).then_some(End::Raised(LOST)), "{action}");
            assert_eq!(notes.pop().is_ok(), action == Action::Log, "{action}");
            // The end is the same error, and does not count again.
            end.into_iter().for_each(|end| reporter.end(end));
            assert_eq!(counts.of(Fault::DeadlineMissed), 3);
        }
    }

    #[test]
    fn a_flood_leaves_a_gap_in_the_notes_and_none_in_the_counts() {
        let (mut reporter, counts, mut notes) = Reporter::new(Table::PLC);
        let flood = NOTES as u64 + 10;
        for _ in 0..flood {
            assert_eq!(reporter.raise(LOST, 1), None);
        }
        for expected in 0..NOTES as u64 {
            assert_eq!(notes.pop().unwrap().sequence, expected);
        }
        assert!(notes.pop().is_err());
        reporter.raise(LOST, 1);
        assert_eq!(notes.pop().unwrap().sequence, flood);
        assert_eq!((counts.of(Fault::DeadlineMissed), reporter.noted()), (flood + 1, flood + 1));
    }

    #[test]
    fn an_access_that_nothing_answers_is_found_among_answered_ones() {
        use crate::vcpu::linux::{Board, LinuxGuest};
        use takt_devices::ports::PortBus;
        use takt_devices::power::{KeyboardController, PowerLine};

        let power = PowerLine::default();
        let mut ports = PortBus::default();
        ports.attach(0x60..=0x64, Box::new(KeyboardController::new(power.clone()))).unwrap();
        let board = Board { ports, power, virtio: Vec::new() };
        let mut guest = LinuxGuest::on(Arc::new(std::sync::Mutex::new(board)));
        let mut data = [0; 8];
        let mut illegal = |exit| Answer::to(exit, &mut guest).illegal;
        assert_eq!(illegal(VcpuExit::IoOut(0x60, &[1])), None);
        let (access, count) = illegal(VcpuExit::IoOut(0x80, &[1, 2, 3])).unwrap();
        assert_eq!((access.to_string(), count), ("write of 3 bytes at port 0x80".into(), 3));
        let (access, count) = illegal(VcpuExit::MmioRead(0xd000_0000, &mut data)).unwrap();
        assert_eq!((access.to_string(), count), ("read of 8 bytes at 0xd0000000".into(), 1));
        assert_eq!(illegal(VcpuExit::Hlt), None);
    }

    #[test]
    fn an_end_is_counted_as_its_error() {
        let (mut reporter, counts, _notes) = Reporter::new(Table::LINUX);
        for end in [End::PoweredOff, End::Reset, End::Stopped] {
            reporter.end(end);
        }
        let all: u64 = FAULTS.into_iter().map(|fault| counts.of(fault)).sum();
        assert_eq!((counts.of(Fault::PartitionReset), all), (1, 2));
    }
}
