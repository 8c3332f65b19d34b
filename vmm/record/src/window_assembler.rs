//! Puts a window back together from what its ring brings.
//!
//! A window comes as some detours and, after them, one record. The search for a cause, and a drawing
//! of the window, need both at once. A full ring drops what does not fit, so detours may arrive whose
//! window never does: those must not be taken for detours of the next one.

use crate::{DETOURS_MAX, Detour, Record, WindowRecord};

/// Gathers the detours of one partition's next window. Its memory is fixed.
#[derive(Debug)]
pub struct WindowAssembler {
    detours: Vec<Detour>,
    /// True if the window of these detours was handed out.
    complete: bool,
}

impl Default for WindowAssembler {
    fn default() -> Self {
        Self { detours: Vec::with_capacity(DETOURS_MAX as usize), complete: false }
    }
}

impl WindowAssembler {
    /// Takes the next record. Gives a window with its detours, in the order of time and none
    /// within another, once it is whole.
    pub fn add(&mut self, record: &Record) -> Option<(WindowRecord, &[Detour])> {
        if self.complete {
            self.detours.clear();
            self.complete = false;
        }
        match record {
            Record::Detour(detour) => {
                // Only after lost windows can there be more; the latest are the ones that may
                // belong to the next window.
                if self.detours.len() >= DETOURS_MAX as usize {
                    self.detours.remove(0);
                }
                self.detours.push(*detour);
                None
            }
            Record::Guard(_) | Record::Skipped(_) => None,
            Record::Window(window) => {
                let mut earliest = window.entered;
                self.detours.retain(|d| {
                    let fits =
                        earliest <= d.left && d.left <= d.entered && d.entered <= window.left;
                    if fits {
                        earliest = d.entered;
                    }
                    fits
                });
                self.complete = true;
                Some((*window, &self.detours))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Exit;
    use takt_scheduler::schedules::ScheduleId;
    use takt_scheduler::time::Tsc;

    fn detour(left: u64, entered: u64) -> Record {
        Record::Detour(Detour { exit: Exit::Other, left: Tsc(left), entered: Tsc(entered) })
    }

    fn window(entered: u64, left: u64) -> Record {
        Record::Window(WindowRecord {
            sequence: 0,
            schedule: ScheduleId(0),
            skipped: 0,
            release: Tsc(entered),
            end: Tsc(left),
            due: Tsc(entered),
            woken: Tsc(entered),
            entered: Tsc(entered),
            left: Tsc(left),
            kicked: None,
            claim: None,
            last_stamp: Tsc(0),
            exits: 1,
            kernel_exits: 0,
            overrun: false,
            unfinished: false,
            has_tasks: false,
            ended: false,
        })
    }

    fn lefts(gathered: Option<(WindowRecord, &[Detour])>) -> Vec<u64> {
        gathered.unwrap().1.iter().map(|d| d.left.0).collect()
    }

    #[test]
    fn a_window_comes_with_its_own_detours_only() {
        let mut gather = WindowAssembler::default();
        assert!(gather.add(&detour(110, 120)).is_none());
        assert!(gather.add(&detour(130, 140)).is_none());
        assert_eq!(lefts(gather.add(&window(100, 200))), [110, 130]);
        assert!(lefts(gather.add(&window(300, 400))).is_empty());
    }

    #[test]
    fn detours_of_a_window_that_was_lost_are_not_those_of_the_next() {
        let mut gather = WindowAssembler::default();
        for n in 0..u64::from(DETOURS_MAX) {
            gather.add(&detour(100 + 2 * n, 101 + 2 * n));
        }
        gather.add(&detour(310, 320));
        assert_eq!(lefts(gather.add(&window(300, 400))), [310]);
        assert_eq!(gather.detours.capacity(), DETOURS_MAX as usize);
    }

    #[test]
    fn detours_that_cannot_be_are_dropped() {
        let mut gather = WindowAssembler::default();
        for (left, entered) in [(150, 140), (110, 130), (120, 125), (0, u64::MAX), (130, 200)] {
            gather.add(&detour(left, entered));
        }
        assert_eq!(lefts(gather.add(&window(100, 200))), [110, 130]);
    }
}
