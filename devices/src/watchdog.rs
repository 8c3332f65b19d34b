//! A watchdog timer: it notices that nothing is heard of a machine any more.
//!
//! Of the watchdogs that PCs have had, Linux distributions leave out nearly all drivers in their
//! kernels for virtual machines. What is left in all of them is `wdat_wdt`, which drives whatever the
//! ACPI table WDAT describes ("Hardware Watchdog Timers Design Specification", Microsoft 2006). So
//! the registers here are our own, four of 32 bits, and the table says which is which.
//!
//! The timer runs from the machine's start and cannot be stopped: the file that gave it to the
//! machine wants to know of its silence, whatever the guest thinks of that. The guest may choose a
//! shorter time than the one that it was given, never a longer one.
//!
//! The registers belong to the vCPU's thread, and whether the time is up is for another one to see:
//! a guest that is silent may not leave its processor ever again. Both hold a [`Timer`]. Time is an
//! argument, in nanoseconds since any one instant.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use crate::ports::PortDevice;

/// Length of a count, the unit of the registers, in ms.
pub const PERIOD_MS: u32 = 10;
const PERIOD_NS: u64 = PERIOD_MS as u64 * 1_000_000;

/// No heartbeat is waited for.
const OFF: u64 = u64::MAX;

/// The timer itself.
#[derive(Clone, Debug)]
pub struct Timer(Arc<State>);

#[derive(Debug)]
struct State {
    /// The longest time that the guest may choose, in counts.
    most: u32,
    /// The time that it has chosen.
    counts: AtomicU32,
    /// When it is up; [`OFF`] if it does not run.
    due: AtomicU64,
    expired: AtomicBool,
    /// The last start of the machine was for its silence.
    after_silence: AtomicBool,
}

impl Timer {
    /// A timer of so many counts, which does not run yet.
    #[must_use]
    pub fn new(counts: u32) -> Timer {
        Timer(Arc::new(State {
            most: counts.max(1),
            counts: AtomicU32::new(counts.max(1)),
            due: AtomicU64::new(OFF),
            expired: AtomicBool::new(false),
            after_silence: AtomicBool::new(false),
        }))
    }

    /// The machine starts: the time runs, all of it.
    pub fn start(&self, now: u64) {
        let state = &self.0;
        state.after_silence.store(state.expired.swap(false, Ordering::SeqCst), Ordering::SeqCst);
        state.counts.store(state.most, Ordering::SeqCst);
        self.feed(now);
    }

    /// The machine runs no more. That it was silent is remembered for its next start.
    pub fn stop(&self) {
        self.0.due.store(OFF, Ordering::SeqCst);
    }

    /// The time begins anew, if it runs: the machine is not let run now.
    pub fn hold(&self, now: u64) {
        let due = self.0.due.load(Ordering::SeqCst);
        if due != OFF {
            let next = now.saturating_add(self.time());
            // If this fails the guest has given a sign, or ended.
            let _ = self.0.due.compare_exchange(due, next, Ordering::SeqCst, Ordering::SeqCst);
        }
    }

    /// True if the time is up, and this has not been reported yet.
    #[must_use]
    pub fn expires(&self, now: u64) -> bool {
        let due = self.0.due.load(Ordering::SeqCst);
        // Between the look and the exchange the guest may have given a sign, or ended.
        let is_up = due <= now
            && self.0.due.compare_exchange(due, OFF, Ordering::SeqCst, Ordering::SeqCst).is_ok();
        if is_up {
            self.0.expired.store(true, Ordering::SeqCst);
        }
        is_up
    }

    /// True once it has [expired](Self::expires), until the next start.
    #[must_use]
    pub fn has_expired(&self) -> bool {
        self.0.expired.load(Ordering::SeqCst)
    }

    /// The longest time that the guest may choose, in counts.
    #[must_use]
    pub fn most(&self) -> u32 {
        self.0.most
    }

    /// The time that the guest has, in ns.
    #[must_use]
    pub fn time(&self) -> u64 {
        u64::from(self.0.counts.load(Ordering::SeqCst)) * PERIOD_NS
    }

    fn feed(&self, now: u64) {
        self.0.due.store(now.saturating_add(self.time()), Ordering::SeqCst);
    }

    fn left(&self, now: u64) -> u32 {
        let left = self.0.due.load(Ordering::SeqCst).saturating_sub(now) / PERIOD_NS;
        u32::try_from(left).unwrap_or(u32::MAX).min(self.0.most)
    }
}

/// The registers of a timer.
pub struct Watchdog<C> {
    timer: Timer,
    clock: C,
}

/// Offset of the time that the guest has, in counts.
pub const COUNT: u16 = 0;
/// Offset of what is left of it, in counts; read only.
pub const LEFT: u16 = 4;
/// Offset of the control register: 1 is a heartbeat; reads as 1, since the timer runs.
pub const CONTROL: u16 = 8;
/// Offset of the status register: 1 if the machine was restarted for its silence; 0 clears it.
pub const STATUS: u16 = 12;
/// How many ports the registers take.
pub const PORTS: u16 = 16;
/// The value of the control and the status register.
pub const SET: u32 = 1;

impl<C: Fn() -> u64> Watchdog<C> {
    /// The registers of `timer`, by this clock.
    #[must_use]
    pub fn new(timer: Timer, clock: C) -> Self {
        Self { timer, clock }
    }
}

impl<C: Fn() -> u64 + Send> PortDevice for Watchdog<C> {
    fn read(&mut self, offset: u16, data: &mut [u8]) {
        let state = &self.timer.0;
        let value = match offset {
            COUNT => state.counts.load(Ordering::SeqCst),
            LEFT => self.timer.left((self.clock)()),
            CONTROL => SET,
            STATUS => state.after_silence.load(Ordering::SeqCst).into(),
            _ => 0,
        };
        data.fill(0);
        if let Ok(data) = <&mut [u8; 4]>::try_from(data) {
            *data = value.to_le_bytes();
        }
    }

    fn write(&mut self, offset: u16, data: &[u8]) {
        let Ok(value) = data.try_into().map(u32::from_le_bytes) else { return };
        let state = &self.timer.0;
        match (offset, value) {
            // A time that is up stays up.
            _ if self.timer.has_expired() => {}
            (COUNT, counts) => {
                state.counts.store(counts.clamp(1, state.most), Ordering::SeqCst);
                self.timer.feed((self.clock)());
            }
            (CONTROL, SET) => self.timer.feed((self.clock)()),
            (STATUS, 0) => state.after_silence.store(false, Ordering::SeqCst),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn running() -> (Timer, Arc<AtomicU64>, Watchdog<impl Fn() -> u64 + Send>) {
        let timer = Timer::new(100);
        let now = Arc::new(AtomicU64::new(5 * MS));
        let clock = now.clone();
        timer.start(5 * MS);
        (timer.clone(), now, Watchdog::new(timer, move || clock.load(Ordering::SeqCst)))
    }

    fn read(watchdog: &mut impl PortDevice, offset: u16) -> u32 {
        let mut data = [0; 4];
        watchdog.read(offset, &mut data);
        u32::from_le_bytes(data)
    }

    #[test]
    fn silence_is_noticed_once_when_the_time_is_up_and_not_before() {
        let (timer, now, mut watchdog) = running();
        assert!(!timer.expires(1_005 * MS - 1));
        now.store(900 * MS, Ordering::SeqCst);
        assert_eq!(read(&mut watchdog, LEFT), 10);
        watchdog.write(CONTROL, &SET.to_le_bytes());
        assert_eq!(read(&mut watchdog, LEFT), 100);
        assert!(!timer.expires(1_900 * MS - 1));
        assert!(!timer.has_expired());
        assert!(timer.expires(1_900 * MS));
        assert!(timer.has_expired());
        assert!(!timer.expires(2_000 * MS));
        // Too late.
        watchdog.write(CONTROL, &SET.to_le_bytes());
        watchdog.write(COUNT, &50_u32.to_le_bytes());
        assert!(timer.has_expired() && !timer.expires(u64::MAX - 1));
    }

    #[test]
    fn a_machine_that_is_off_is_not_silent_and_its_next_start_has_all_the_time() {
        let (timer, _, mut watchdog) = running();
        watchdog.write(COUNT, &7_u32.to_le_bytes());
        timer.stop();
        assert!(!timer.expires(u64::MAX - 1));
        timer.start(0);
        assert_eq!((read(&mut watchdog, COUNT), read(&mut watchdog, STATUS)), (100, 0));
        assert!(timer.expires(1_000 * MS));
        timer.stop();
        timer.start(0);
        assert!(!timer.has_expired());
        assert_eq!(read(&mut watchdog, STATUS), SET);
        watchdog.write(STATUS, &[0; 4]);
        assert_eq!(read(&mut watchdog, STATUS), 0);
    }

    #[test]
    fn while_the_machine_is_not_let_run_the_time_does_not() {
        let (timer, now, mut watchdog) = running();
        timer.hold(1_004 * MS);
        now.store(1_004 * MS, Ordering::SeqCst);
        assert_eq!(read(&mut watchdog, LEFT), 100);
        assert!(!timer.expires(2_004 * MS - 1));
        assert!(timer.expires(2_004 * MS));
        // Neither a time that is up nor one that does not run.
        timer.hold(2_004 * MS);
        assert!(timer.has_expired() && !timer.expires(u64::MAX - 1));
        timer.stop();
        timer.hold(2_004 * MS);
        assert!(!timer.expires(u64::MAX - 1));
    }

    #[test]
    fn the_guest_may_choose_less_time_and_never_more() {
        let (timer, _, mut watchdog) = running();
        for (asked, given) in [(30, 30), (0, 1), (100, 100), (101, 100), (u32::MAX, 100)] {
            watchdog.write(COUNT, &u32::to_le_bytes(asked));
            assert_eq!(read(&mut watchdog, COUNT), given);
            assert_eq!(timer.time(), u64::from(given) * PERIOD_NS);
        }
    }

    #[test]
    fn only_a_heartbeat_is_one() {
        let (timer, now, mut watchdog) = running();
        now.store(500 * MS, Ordering::SeqCst);
        for offset in (0..=PORTS).chain([u16::MAX]).filter(|offset| *offset != COUNT) {
            for value in [0, 2, 0x100, u32::MAX, SET] {
                for width in [1, 2, 4, 8] {
                    if (offset, value, width) != (CONTROL, SET, 4) {
                        let data = [value.to_le_bytes(), [0; 4]].concat();
                        watchdog.write(offset, &data[..width]);
                        let mut data = [0; 8];
                        watchdog.read(offset, &mut data[..width]);
                    }
                }
            }
        }
        for width in [0, 1, 2, 3, 5, 8] {
            watchdog.write(COUNT, &[0xff; 8][..width]);
        }
        assert!(timer.expires(1_005 * MS));
    }
}
