//! What is done in time that no task needs.
//!
//! A program that starts anew is set up, CAN objects are sent, a change goes on, values are copied, orders are carried out:
//! a piece at a time, each short and only if there is time for it before the next release. When there is nothing left, the rest of
//! the window is given away.

use super::kernel::{Kernel, Window};
use super::processor;
use super::program::Program;
use takt_kernel::time::Span;
use takt_plc_guest::{cycle, interrupt, pages, port};

/// Time that printing a line may take, in ticks: 60 us at 1 GHz, 12 us at 5 GHz.
const PRINTING_TICKS: u64 = 60_000;
/// Time that one piece of a program's set-up may take.
const LOADING: Span = Span(20_000);

impl Kernel {
    /// Nothing is ready.
    #[inline(never)]
    pub fn idle(&mut self) {
        if self.begin_window().is_none() {
            return;
        }
        interrupt::end();
        if self.print_untold() {
            return;
        }
        if self.stop_what_waits() {
            return;
        }
        if self.clock.tsc(self.scheduler.next_event()) < self.window.end_tsc {
            // It may be the deadline of a job that is over.
            let next = self.clock.tsc(self.scheduler.look_ahead());
            if next < self.window.end_tsc {
                let at = processor::wait_until(next);
                self.pass_time(self.clock.instant(at));
                return;
            }
        }
        // A task that waits again and again for less than a piece takes leaves no time either.
        self.window.idled = true;
        if !self.do_a_piece(true) {
            if next_window_is_far(self.window.end_tsc) {
                self.tell_figures();
            }
            pages::publish_done(cycle::now());
            // If the window ends before this is written, it must not give the next one away.
            port::write(takt_abi::port::DONE, takt_abi::port::done(self.window.release));
        }
    }

    /// An initialisation or a freewheeling task may never end, and then no time is idle. The others of the partition
    /// must come back all the same: a piece in each window after such a one. No values are copied beside it: they could be
    /// half of a job's.
    #[inline(never)]
    pub fn help_others(&mut self) {
        if !self.window.starved || self.window.helped || self.begin_window().is_none() {
            return;
        }
        self.window.helped = true;
        self.scheduler.look_ahead();
        if !self.stop_what_waits()
            && !self.do_a_piece(false)
            && next_window_is_far(self.window.end_tsc)
        {
            self.tell_figures();
        }
    }

    /// Does a piece of what is done in time that no task needs; values are copied if no task has a job. False if there is
    /// nothing to do, or no time for it.
    fn do_a_piece(&mut self, idle: bool) -> bool {
        let Window { release, release_tsc, end_tsc: end, .. } = self.window;
        self.load_a_piece()
            || self.io.send_waiting(release, end)
            || self.change_some(end)
            || idle && self.take_sample(release, release_tsc, end)
            || self.serve_order(release, end)
    }

    /// Sets up some of a program that starts anew.
    fn load_a_piece(&mut self) -> bool {
        let release = self.window.release;
        let mut programs = self.programs.iter_mut().flatten();
        // Zeros that are still to be written must not come behind what its next life writes.
        let stops = |p: &Program| self.exchanges.stops_of(p.id.0);
        let Some(program) = programs.find(|p| p.can_load(release) && !stops(p)) else {
            return false;
        };
        let end = self.clock.instant(self.window.end_tsc).min(self.scheduler.next_event());
        if self.clock.instant(cycle::now()).after(LOADING) > end {
            return false;
        }
        let id = program.id;
        self.live.forces.unsettle(id.0);
        if program.load_some() {
            let now = self.now();
            self.scheduler.start(id, now);
        }
        true
    }
}

/// True if a line can be printed before the window ends, and the release after it waits for nothing.
fn next_window_is_far(end_tsc: u64) -> bool {
    end_tsc.saturating_sub(cycle::now()) > PRINTING_TICKS
}
