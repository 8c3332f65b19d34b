//! The thread of a partition, and what it does from the epoch to its end.

use std::sync::{Arc, Mutex};

use kvm_ioctls::VcpuFd;
use takt_devices::output;
use takt_scheduler::guard::{AutoGuard, ReleaseGuard};
use takt_scheduler::reservation::CpuReservations;
use takt_scheduler::table::Role;
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use vmm_sys_util::eventfd::EventFd;

use super::crew::{Crew, Health};
use super::{Preparation, Prepared};
use crate::account::Account;
use crate::attendance::Attendance;
use crate::boot::StartMode;
use crate::boot::touch::TouchError;
use crate::config::{Partition, ScheduleChange};
use crate::delay::Delay;
use crate::event;
use crate::handoff::{Giver, Gone, handoff, lock};
use crate::health::Watch;
use crate::health::bus_locks::BusLocks;
use crate::life::{Finished, Life, Starts};
use crate::memory::GuestMemory;
use crate::restart::{Revival, Revivals};
use crate::run_error::RunError;
use crate::terminal::Lines;
use crate::vcpu::guest::{End, Guest};
use crate::vcpu::kick::Kickable;
use crate::vcpu::records::{RecordReader, records};
use crate::vcpu::thread::{self, Place};
use crate::vcpu::windowed::{Plan, Windowed};
use crate::vcpu::{Control, background};
use takt_record::WindowAssembler;

/// Window records that the supervisor thread may be behind.
const RECORDS: usize = 4096;
/// Ends that a thread may tell of before the supervisor thread has taken the first: its guest's, and that it
/// could not be loaded anew or the run is over.
const ENDS: usize = 2;

/// How a vCPU thread tells of its end.
struct Ending {
    ends: Giver<Finished>,
    bell: EventFd,
}

impl Ending {
    fn tell(&mut self, finished: Finished) {
        // There is room, since a thread has its word to go on only after the supervisor thread has taken this, and ends
        // without one.
        let _ = self.ends.give(finished);
        let _ = self.bell.write(1);
    }
}

/// A virtual processor, and what its thread has to do for it before it is ready.
pub(super) struct Processor<R> {
    pub vcpu: VcpuFd,
    pub ready: R,
    pub seat: Seat,
    pub crew: Crew,
}

/// What a partition's thread and others have in common.
pub(super) struct Seat {
    pub control: Arc<Control>,
    pub health: Health,
    watch: Watch,
}

impl Seat {
    pub fn new(partition: &Partition) -> Self {
        let (watch, reporter) = Watch::new(partition.health());
        let reporter = reporter.with_bus_locks(BusLocks::new(partition.hardware().bus_locks));
        Self { control: Arc::default(), health: Arc::new(Mutex::new(reporter)), watch }
    }
}

/// What a guest's thread keeps for as long as the guest exists.
struct Body {
    /// The memory lives as long as the processor.
    _memory: GuestMemory,
    own: Arc<Control>,
    health: Health,
    crew: Crew,
    ending: Ending,
}

impl Preparation<'_> {
    /// Makes the thread of a partition: in its windows, or in the background.
    pub(super) fn spawn<G, R>(
        &mut self,
        partition: &Partition,
        Processor { vcpu, ready, seat, crew }: Processor<R>,
        memory: GuestMemory,
        guest: G,
        output: output::OutputEnd,
        mut revivals: Revivals<G>,
    ) -> Result<Prepared, RunError>
    where
        G: Guest + Send + 'static,
        R: FnOnce(&mut VcpuFd) -> Result<(), TouchError> + Send + 'static,
    {
        let (id, cpu, name) = (partition.id(), partition.cpu(), partition.name().to_owned());
        let (giver, ends) = handoff(ENDS);
        let Seat { control, health, watch } = seat;
        let body = Body {
            _memory: memory,
            own: control.clone(),
            health,
            crew,
            ending: Ending { ends: giver, bell: event::clone(&self.bell)? },
        };
        let schedules = self.file.schedules();
        let says_done = guest.says_done();
        let enforcer = self.enforcer(cpu);
        let reservations =
            CpuReservations::of(schedules, cpu).by_a_clock_whose_steering_is(self.steering);
        let mut reservations = reservations.partitions.into_iter();
        let reservation = reservations.find_map(|(p, r)| (p == id).then_some(r));
        let role = schedules.placements()[id.0].role;
        let plan = match (role, schedules.timetable_of(id), reservation) {
            (Role::Windowed { guard }, Some(timetable), Some(reservation)) => Some(Plan {
                timetable,
                board: self.board.clone(),
                guard: if partition.has_auto_guard() {
                    ReleaseGuard::Auto(AutoGuard::new(guard))
                } else {
                    ReleaseGuard::Fixed(guard)
                },
                quiet: schedules.quiet_on(cpu, None),
                reservation,
                steering: self.steering,
                enforcer,
                late_wake_up: self.hooks.late_wake_up(),
                deadlines: self.deadlines_of(|other, on| other != id && on == cpu),
                on_switch: match partition.on_schedule_change() {
                    ScheduleChange::Ignore => None,
                    ScheduleChange::Warm => Some(StartMode::Warm),
                    ScheduleChange::Cold => Some(StartMode::Cold),
                },
            }),
            _ => None,
        };
        let timetable = plan.as_ref().map(|plan| plan.timetable.clone());
        let ports = guest.io_ranges();
        let domain = self.domains.entry(cpu);
        let group = self.groups.entry(partition);
        let doors = (G::THREAD, self.mode);
        let place = Place { cpu, domain, group, reservation, ports, doors };
        let (thread, records): (_, Option<RecordReader>) = match plan {
            Some(plan) => {
                let (producer, consumer) = records(RECORDS);
                let run = move |kickable: &mut Kickable, base: Timebase| {
                    let windowed = Windowed::new(plan, base, producer);
                    body.run_windowed(windowed, kickable, guest, &mut revivals);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, ready, run)?, Some(consumer))
            }
            None => {
                let run = move |kickable: &mut Kickable, base: Timebase| {
                    body.run_background(kickable, guest, &mut revivals, &base);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, ready, run)?, None)
            }
        };
        let account = Account {
            name,
            control,
            further: Vec::new(),
            output,
            unshown: 0,
            is_terminal: false,
            is_shown: true,
            log: None,
            keyboard: None,
            records,
            attendance: timetable.clone().filter(|_| says_done).map(Attendance::new),
            assembler: WindowAssembler::default(),
            says_done,
            health: watch,
            releases: None,
            samples: None,
            load: None,
            occupied: Nanos::ZERO,
            watchdog: None,
            leaves_by: Nanos::ZERO,
            looked: 0,
            timetable,
            kernel: None,
            disks: Vec::new(),
            links: Vec::new(),
            deadlines: Vec::new(),
            banks: None,
            power_button: None,
            restart: None,
            life: Life::new(Starts::None),
            ends,
            delay: Delay::default(),
            lines: Lines::default(),
        };
        Ok(Prepared { account, thread, further: Vec::new(), disks: Vec::new(), linux: None })
    }
}

impl Body {
    /// Runs the guest, and again whenever it has been loaded anew.
    fn run_windowed<G: Guest>(
        mut self,
        mut windowed: Windowed,
        kickable: &mut Kickable,
        mut guest: G,
        revivals: &mut Revivals<G>,
    ) {
        let health = self.health.clone();
        loop {
            self.own.enter_guest();
            // For as long as the guest runs: no other thread counts for it.
            let end = windowed.run(kickable, &mut guest, &self.own, &mut lock(&health));
            guest.left();
            // A PLC keeps its processor, and its memory is loaded anew soon: a read that has not ended would write
            // there. A Linux gets another processor.
            if guest.says_done() && !self.own.ending() {
                kickable.settle();
                // The end of a read may have written to a device's registers.
                guest.left();
            }
            self.own.leave_guest();
            let starting = guest.says_done() && windowed.starting();
            self.tell((end, Nanos::ZERO), starting);
            let revival = loop {
                if !windowed.next_window(&self.own) {
                    return self.end();
                }
                match revivals.take() {
                    Ok(Some(revival)) => break revival,
                    Ok(None) => {}
                    Err(Gone) => return self.end(),
                }
            };
            if !self.revive(kickable, &mut guest, revival) {
                return;
            }
            windowed.restarted(kickable.vcpu(), &guest);
        }
    }

    fn run_background<G: Guest>(
        mut self,
        kickable: &mut Kickable,
        mut guest: G,
        revivals: &mut Revivals<G>,
        base: &Timebase,
    ) {
        loop {
            self.own.enter_guest();
            let end = background::run(kickable, &mut guest, &self.own, &self.health, base);
            let left = self.crew.gather(&self.own, end);
            guest.left();
            self.own.leave_guest();
            self.tell(left, false);
            let Some(revival) = wait(&self.own, revivals) else { return self.end() };
            if !self.revive(kickable, &mut guest, revival) {
                return;
            }
        }
    }

    /// Does what is left to do after the guest has been loaded anew; false if it is not.
    fn revive<G: Guest>(
        &mut self,
        kickable: &mut Kickable,
        guest: &mut G,
        revival: Revival<G>,
    ) -> bool {
        let revived = revival(kickable, guest);
        if !revived {
            // A device may have been reset, and only this thread reaches its ports.
            guest.left();
            self.tell((End::NotLoaded, Nanos::ZERO), true);
        }
        revived
    }

    /// Without a guest, whose end has been told. If one was to be started anew, the end of the run is its end.
    fn end(&mut self) {
        if self.own.ending() {
            self.tell((End::Stopped, Nanos::ZERO), true);
        }
    }

    /// Tells of the guest's end, and the CPU time that other processors of it have used.
    fn tell(&mut self, (end, others): (End, Nanos), starting: bool) {
        let mut health = lock(&self.health);
        health.end(end);
        self.ending.tell(Finished {
            end,
            at: Tsc::now(),
            starting,
            noted: health.noted(),
            cpu_time: thread::cpu_time().plus(others),
        });
    }
}

/// Waits for the word to go on; `None` if there will be none, or the run is over. What loads a guest may
/// take longer than the end of a run, so that end wakes the thread too.
pub(super) fn wait<G>(own: &Control, revivals: &mut Revivals<G>) -> Option<Revival<G>> {
    revivals.wait_unless(|| own.ending()).ok().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::health::Table;
    use crate::life::Event;
    use crate::memory::Pages;
    use crate::vcpu::plc::PlcGuest;

    /// What a thread tells that waits for a start which does not come, if the run is over or the loader is gone.
    fn told(over: bool) -> Option<Finished> {
        let (own, (giver, mut ends)) = (Arc::<Control>::default(), handoff(ENDS));
        let mut body = Body {
            _memory: GuestMemory::for_plc(4 << 20, Pages::Small, &[]).unwrap(),
            own: own.clone(),
            health: Arc::new(Mutex::new(Watch::new(Table::PLC).1)),
            crew: Crew::default(),
            ending: Ending { ends: giver, bell: event::eventfd().unwrap() },
        };
        if over {
            Control::stop_all(std::slice::from_ref(&own));
        }
        let (loader, mut revivals) = handoff::<Revival<PlcGuest>>(1);
        let _loader = over.then_some(loader);
        assert!(wait(&own, &mut revivals).is_none());
        body.end();
        ends.take().ok().flatten()
    }

    #[test]
    fn a_guest_that_was_to_start_again_when_the_run_ended_was_stopped_with_it() {
        let finished = told(true).unwrap();
        assert_eq!(finished.end, End::Stopped);
        let mut life = Life::new(Starts::Cold);
        let _ = life.step(Event::RunOver);
        let _ = life.step(Event::Left { finished, action: None, leaving: false });
        assert_eq!(life.finished(), Some(finished));
        assert_eq!(told(false), None, "a loader that has died is no end of the run");
    }

    #[test]
    fn the_end_of_the_run_wakes_a_thread_that_waits_for_a_word_which_does_not_come() {
        crate::vcpu::kick::install().unwrap();
        let own: Arc<Control> = Arc::default();
        let (_loader, mut revivals) = handoff::<Revival<PlcGuest>>(1);
        let (waits, waiting) = std::sync::mpsc::channel();
        let thread = std::thread::spawn({
            let own = own.clone();
            move || {
                own.is_this_thread();
                waits.send(()).unwrap();
                drop(waits);
                wait(&own, &mut revivals).is_none()
            }
        });
        waiting.recv().unwrap();
        // The third word behind the name: it sleeps.
        let state = format!("/proc/self/task/{}/stat", own.thread());
        while !std::fs::read_to_string(&state).unwrap().contains(") S ") {
            std::thread::yield_now();
        }
        Control::stop_all(std::slice::from_ref(&own));
        assert!(thread.join().unwrap());
    }
}
