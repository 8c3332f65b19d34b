//! A CPU whose threads sleep by one clock, for tests. While one of them is in its window, only the first thread, which
//! ends windows, can run; what else wakes meanwhile waits.
//!
//! Each thread is one of the test's process, and has the simulated CPU by turns.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};

use super::*;

/// From the end of a window until a program that has to be kicked is out.
const KICK: u64 = 26_000;
/// What the thread that ends windows needs the processor for: a wake-up in which it looks at the clock, and a signal to
/// another thread. In the lab and, for the signal, on a kernel 6.18 in a virtual machine.
pub(super) const LOOK: u64 = 7_000;
pub(super) const SIGNAL: u64 = 2_600;
/// The same of another thread that wakes.
pub(super) const WAKE: u64 = 3_500;
/// The thread that ends windows.
pub(super) const ENFORCER: usize = 0;

#[derive(Clone, Copy, Debug)]
pub(super) enum State {
    /// Has the processor, between its sleeps.
    Running,
    /// Until the clock says so.
    Asleep(Nanos),
    /// Its guest has the processor, until this instant.
    InWindow(u64),
    Gone,
}

struct Thread {
    state: State,
    told: bool,
    window_ends: u64,
}

struct World {
    clock: Steered,
    threads: Vec<Thread>,
    turn: usize,
    /// A thread is up until then, and others wait.
    busy_until: u64,
}

impl World {
    /// Lets time pass until one has something to do, whose turn it is.
    fn go_on(&mut self) {
        let taken = self.threads.iter().any(|it| matches!(it.state, State::InWindow(_)));
        let due = |(place, thread): (usize, &Thread)| {
            let at = match thread.state {
                State::Gone => return None,
                State::Asleep(_) if taken && place != ENFORCER => return None,
                State::Asleep(until) if !thread.told => self.clock.awake_at(until),
                State::InWindow(until) => until,
                State::Running | State::Asleep(_) => 0,
            };
            let waits = matches!(thread.state, State::Asleep(_)) && place != ENFORCER;
            let at = if waits { at.max(self.busy_until) } else { at };
            Some((at.max(self.clock.tsc), place))
        };
        // None when all are gone.
        let Some((at, turn)) = self.threads.iter().enumerate().filter_map(due).min() else {
            return;
        };
        self.clock.pass(at - self.clock.tsc);
        self.turn = turn;
    }
}

pub(super) struct SimulatedCpu {
    world: Mutex<World>,
    turns: Vec<Condvar>,
}

impl SimulatedCpu {
    pub(super) fn new(rates: &[(u64, i64)], threads: usize) -> Arc<SimulatedCpu> {
        let thread = || Thread { state: State::Running, told: false, window_ends: 0 };
        let threads: Vec<Thread> = (0..threads).map(|_| thread()).collect();
        let turns = threads.iter().map(|_| Condvar::new()).collect();
        let clock = Steered::new(rates);
        let world = World { clock, threads, turn: ENFORCER, busy_until: 0 };
        Arc::new(SimulatedCpu { world: Mutex::new(world), turns })
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }

    pub(super) fn now(&self) -> u64 {
        self.world().clock.tsc
    }

    /// Waits for the first turn of this thread.
    pub(super) fn begin(&self, me: usize) {
        let world = self.turns[me].wait_while(self.world(), |world| world.turn != me);
        world.unwrap().threads[me].state = State::Running;
    }

    /// Gives the processor up until this state is over.
    pub(super) fn give_up(&self, me: usize, state: State) {
        let mut world = self.world();
        world.threads[me].state = state;
        world.go_on();
        if world.turn != me {
            self.turns[world.turn].notify_one();
        }
        drop(world);
        if !matches!(state, State::Gone) {
            self.begin(me);
        }
    }

    /// This thread's guest runs in a window that ends then, and wants to run so long.
    pub(super) fn run_window(&self, me: usize, ends: u64, until: u64) {
        self.world().threads[me].window_ends = ends;
        self.give_up(me, State::InWindow(until));
        self.world().threads[me].window_ends = 0;
    }

    /// Kicks a thread out of its guest if its window is over.
    pub(super) fn end_window(&self, thread: usize) {
        let mut world = self.world();
        let now = world.clock.tsc;
        let thread = &mut world.threads[thread];
        if let State::InWindow(until) = &mut thread.state
            && thread.window_ends <= now
        {
            *until = (*until).min(now + KICK);
        }
    }

    /// This thread needs the processor so long, and others wait.
    pub(super) fn work(&self, time: u64) {
        let mut world = self.world();
        world.busy_until = world.busy_until.max(world.clock.tsc) + time;
    }

    /// Wakes a thread that sleeps, by a signal. False for another.
    pub(super) fn tell(&self, thread: usize) -> bool {
        let thread = &mut self.world().threads[thread];
        let asleep = matches!(thread.state, State::Asleep(_));
        thread.told |= asleep;
        asleep
    }
}

/// One of its threads, and the instants at which it woke.
pub(super) struct OnCpu(pub(super) Arc<SimulatedCpu>, pub(super) usize, pub(super) Vec<u64>);

impl Machine for OnCpu {
    fn tsc(&mut self) -> Tsc {
        self.0.world().clock.tsc()
    }

    fn moment(&mut self) -> Moment {
        self.0.world().clock.moment()
    }

    fn sleep(&mut self, until: Nanos) -> Woken {
        let OnCpu(cpu, me, woken) = self;
        cpu.give_up(*me, State::Asleep(until));
        cpu.work(if *me == ENFORCER { LOOK } else { WAKE });
        let mut world = cpu.world();
        woken.push(world.clock.tsc);
        match std::mem::take(&mut world.threads[*me].told) {
            true => Woken::BySignal,
            false => Woken::OnTime,
        }
    }
}
