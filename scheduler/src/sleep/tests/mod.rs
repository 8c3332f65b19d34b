//! Sleeps under clocks that are steady, steered, or change their rate in the middle.

mod layouts;
mod simulated_cpu;

use std::sync::Arc;

use super::*;
use crate::reservation::{KICKER_RUNTIME, Reservation, pieces_within};
use crate::schedules::Schedules;
use crate::switch::ScheduleState;
use crate::table::{Cpu, PartitionId, Placement, Role, Window};
use crate::time::Timebase;

/// One tick is one nanosecond.
const FREQUENCY: TscFrequency = match TscFrequency::from_khz(1_000_000) {
    Some(frequency) => frequency,
    None => unreachable!(),
};

/// A machine whose clock runs at rates that change: by the counter since when, and by how many ppm it is
/// faster.
struct Steered {
    tsc: u64,
    clock: f64,
    rates: Vec<(u64, i64)>,
    sleeps: u32,
}

impl Steered {
    fn new(rates: &[(u64, i64)]) -> Self {
        Self { tsc: 0, clock: 5e9, rates: rates.to_vec(), sleeps: 0 }
    }

    /// The rate now, and when it changes next.
    fn rate(&self) -> (f64, u64) {
        let of = |ppm: i64| 1.0 + ppm as f64 / 1e6;
        let now = self.rates.iter().rev().find(|(since, _)| *since <= self.tsc);
        let next = self.rates.iter().find(|(since, _)| *since > self.tsc);
        (of(now.map_or(0, |(_, ppm)| *ppm)), next.map_or(u64::MAX, |(since, _)| *since))
    }

    /// What the counter says when a sleep until the clock says so is over.
    fn awake_at(&self, until: Nanos) -> u64 {
        let mut ahead = Steered { rates: self.rates.clone(), ..*self };
        ahead.sleep(until);
        ahead.tsc
    }

    fn pass(&mut self, ticks: u64) {
        let mut left = ticks;
        while left > 0 {
            let (rate, next) = self.rate();
            let step = left.min(next - self.tsc);
            self.clock += step as f64 * rate;
            self.tsc += step;
            left -= step;
        }
    }
}

impl Machine for Steered {
    fn tsc(&mut self) -> Tsc {
        self.pass(10);
        Tsc(self.tsc)
    }

    fn moment(&mut self) -> Moment {
        self.pass(20);
        Moment { tsc: Tsc(self.tsc), clock: Nanos(self.clock as u64) }
    }

    fn sleep(&mut self, Nanos(until): Nanos) -> Woken {
        self.sleeps += 1;
        while self.clock < until as f64 {
            let (rate, next) = self.rate();
            let ticks = ((until as f64 - self.clock) / rate).ceil().max(1.0) as u64;
            self.pass(ticks.min(next - self.tsc));
        }
        Woken::OnTime
    }
}

/// Numbers that look random, from Knuth's MMIX generator.
fn below(seed: &mut u64, limit: u64) -> u64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 33) % limit
}

const SLEEPS: [u64; 9] =
    [1_000, 50_000, 70_000, 980_000, 2_000_000, 2_100_000, 9_980_000, 99_900_000, 999_000_000];
/// What ADJ_TICK and ADJ_FREQUENCY allow together.
const STEERINGS: [i64; 7] = [0, 500, -500, 83_333, -83_333, 100_500, -100_500];

#[test]
fn no_sleep_under_a_steady_clock_ends_early_or_late_by_more_than_its_last_piece() {
    for ppm in STEERINGS {
        for length in SLEEPS {
            let mut machine = Steered::new(&[(0, ppm)]);
            let mut sleeper = Sleeper::new(FREQUENCY);
            let wake_ups = WakeUps::default();
            for _ in 0..20 {
                let instant = Tsc(machine.tsc + length);
                machine.sleeps = 0;
                assert_eq!(sleeper.sleep(&mut machine, instant, &wake_ups), Woken::OnTime);
                let late = machine.tsc.checked_sub(instant.0).expect("not early");
                assert!(late <= 7_500, "{ppm} ppm: {length} ns end {late} ns late");
                assert!(machine.sleeps <= 12, "{ppm} ppm, {length} ns: {} sleeps", machine.sleeps);
            }
            let steered = ppm.abs() > 1_000 && length >= 50_000;
            assert_eq!(wake_ups.steered() > 0, steered, "{ppm} ppm, {length} ns");
        }
    }
}

#[test]
fn a_divided_sleep_is_right_whenever_the_rate_changes() {
    let mut seed = 1;
    for _ in 0..20_000 {
        let length = SLEEPS[below(&mut seed, SLEEPS.len() as u64) as usize];
        let mut change = || {
            let at = below(&mut seed, length);
            (at, STEERINGS[below(&mut seed, STEERINGS.len() as u64) as usize])
        };
        let mut rates = vec![change(), change(), change(), (0, 0)];
        rates.sort_unstable();
        let mut machine = Steered::new(&rates);
        // It has not slept before, and so does not trust the clock.
        let mut sleeper = Sleeper::new(FREQUENCY);
        let woken = sleeper.sleep(&mut machine, Tsc(length), &WakeUps::default());
        assert_eq!(woken, Woken::OnTime);
        let late = machine.tsc.checked_sub(length).expect("not early");
        assert!(late <= 7_500, "{rates:?}: {length} ns end {late} ns late");
    }
}

/// Pieces of each of a thousand sleeps until the next millisecond, but for the first.
fn pieces(mut sleeper: Sleeper, ppm: i64) -> (Vec<u32>, WakeUps) {
    let mut machine = Steered::new(&[(0, ppm)]);
    let wake_ups = WakeUps::default();
    let mut pieces = Vec::new();
    for cycle in 1..1_000 {
        machine.sleeps = 0;
        sleeper.sleep(&mut machine, Tsc(cycle * 1_000_000), &wake_ups);
        pieces.push(machine.sleeps);
    }
    (pieces.split_off(2), wake_ups)
}

#[test]
fn a_millisecond_under_a_clock_as_it_should_be_is_two_pieces_and_for_the_lazy_one() {
    for ppm in [0, 500, -500] {
        let (own, wake_ups) = pieces(Sleeper::new(FREQUENCY), ppm);
        assert!(own.iter().all(|pieces| *pieces == 2), "{ppm}: {own:?}");
        assert_eq!(wake_ups.steered(), 0);
        let (lazy, wake_ups) = pieces(Sleeper::new(FREQUENCY).lazy(), ppm);
        assert!(lazy.iter().all(|pieces| *pieces == 1), "{ppm}: {lazy:?}");
        // What 500 ppm leave of a millisecond is waited for.
        assert_eq!((wake_ups.early() > 900, wake_ups.steered()), (ppm > 0, 0), "{ppm}");
    }
}

#[test]
fn where_the_clock_cannot_be_steered_a_sleep_is_one_piece_until_it_is_found_steered() {
    let unsteered = || Sleeper::new(FREQUENCY).by_a_clock_whose_steering_is(Steering::Impossible);
    let (own, wake_ups) = pieces(unsteered(), 0);
    assert!(own.iter().all(|pieces| *pieces == 1), "{own:?}");
    // Also the first, in which there is nothing to compare the clock with.
    assert_eq!((wake_ups.early(), wake_ups.divided(), wake_ups.steered()), (0, 0, 0));
    // If that was a mistake, it is one once.
    let late = lateness(unsteered());
    let is_felt = |ns: &u64| *ns > SHORT.0 / 9 + 100;
    assert_eq!(late.iter().copied().filter(is_felt).count(), 1, "{late:?}");
    let mut machine = Steered::new(&[(0, 1)]);
    let mut sleeper = unsteered();
    for length in SLEEPS {
        let instant = Tsc(machine.tsc + length);
        sleeper.sleep(&mut machine, instant, &WakeUps::default());
        assert!(machine.tsc - instant.0 <= 150, "{length} ns end {} late", machine.tsc - instant.0);
    }
}

/// How late each of 400 sleeps until the next millisecond ends, while the rate changes every ten by a tenth.
fn lateness(mut sleeper: Sleeper) -> Vec<u64> {
    let rates: Vec<_> = (1..40).map(|i| (i * 10_500_000, -100_000 * (i as i64 % 2))).collect();
    let mut machine = Steered::new(&rates);
    let mut late = Vec::new();
    for cycle in 1..400 {
        let instant = cycle * 1_000_000;
        sleeper.sleep(&mut machine, Tsc(instant), &WakeUps::default());
        late.push(machine.tsc.checked_sub(instant).expect("not early"));
    }
    late
}

#[test]
fn no_step_of_the_rate_is_felt_by_more_than_a_guard_has_room_for() {
    let late = lateness(Sleeper::new(FREQUENCY));
    let worst = late.iter().max();
    assert!(worst.is_some_and(|ns| *ns <= SHORT.0 / 9 + 100), "{late:?}");
}

#[test]
fn the_first_step_of_the_rate_is_the_only_one_that_the_lazy_feel() {
    let late = lateness(Sleeper::new(FREQUENCY).lazy());
    let is_felt = |ns: &u64| *ns > SHORT.0 / 9 + 100;
    let felt: Vec<u64> = late.iter().copied().filter(is_felt).collect();
    assert!(felt.len() == 1 && felt[0] <= 1_000_000 / 9, "{felt:?}");
    assert_eq!(late.iter().position(is_felt), Some(10));
}

#[test]
fn the_lazy_wake_once_before_an_instant_under_a_clock_that_is_not_trusted() {
    for ppm in STEERINGS {
        for length in [113_000, 400_000, 1_000_000, 2_000_000] {
            let mut machine = Steered::new(&[(0, ppm)]);
            let mut sleeper = Sleeper::new(FREQUENCY).lazy();
            sleeper.distrust = DISTRUST;
            let wake_ups = WakeUps::default();
            for sleep in 1..20 {
                let instant = Tsc(machine.tsc + length);
                sleeper.sleep(&mut machine, instant, &wake_ups);
                let late = machine.tsc.checked_sub(instant.0).expect("not early");
                // A ninth of a ninth.
                let most = (length / 81).max(SHORT.0 / 9) + 200;
                assert!(late <= most, "{ppm} ppm: {length} ns end {late} ns late");
                assert_eq!(wake_ups.divided(), sleep, "{ppm} ppm, {length} ns");
            }
        }
    }
}

#[test]
fn what_the_lazy_are_told_in_mid_sleep_is_their_wake_up() {
    let mut machine = Told(Steered::new(&[(0, 0), (2_100_000, -100_000)]), 2_600_000, 0);
    let mut sleeper = Sleeper::new(FREQUENCY).lazy();
    let wake_ups = WakeUps::default();
    for end in [1_000_000, 2_000_000] {
        assert_eq!(sleeper.sleep(&mut machine, Tsc(end), &wake_ups), Woken::OnTime);
    }
    assert!(!wake_ups.distrusting());
    machine.2 = 0;
    assert_eq!(sleeper.sleep(&mut machine, Tsc(3_000_000), &wake_ups), Woken::BySignal);
    assert_eq!(sleeper.sleep(&mut machine, Tsc(3_000_000), &wake_ups), Woken::OnTime);
    assert!(wake_ups.distrusting());
    // Until it was told, and from there on to the end.
    assert_eq!(machine.2, 2);
    let late = machine.0.tsc.checked_sub(3_000_000).expect("not early");
    assert!(late <= 400, "{late}");
}

#[test]
fn a_rate_that_no_steering_explains_is_measured_again() {
    let instant = Tsc(1_000_000);
    // By the counter, the clock is asked for what it says a millisecond later; where it is not known, before the last ninth.
    for (ppm, at) in
        [(-100_000, 900_000), (100_000, 1_100_000), (-200_000, 889_000), (300_000, 889_000)]
    {
        let mut machine = Steered::new(&[(0, ppm)]);
        let until = Sleeper::new(FREQUENCY).at_rate_of_now(&mut machine, instant);
        let until = until.less(Nanos(5_000_000_000)).0;
        assert!(until.abs_diff(at) <= 2_000, "{ppm} ppm: {until}");
    }
}

/// A machine whose first reading of the clock after a sleep is late, since nothing of it is in a cache.
struct Cold(Told, bool);

impl Machine for Cold {
    fn tsc(&mut self) -> Tsc {
        self.0.tsc()
    }

    fn moment(&mut self) -> Moment {
        let tsc = self.0.tsc();
        if std::mem::take(&mut self.1) {
            self.0.0.pass(200);
        }
        Moment { tsc, ..self.0.moment() }
    }

    fn sleep(&mut self, until: Nanos) -> Woken {
        self.1 = true;
        self.0.sleep(until)
    }
}

#[test]
fn a_late_reading_after_a_sleep_spoils_no_measurement() {
    let steered = Steered::new(&[(0, 0), (2_100_000, -100_000)]);
    let mut machine = Cold(Told(steered, 2_200_000, 0), false);
    let mut sleeper = Sleeper::new(FREQUENCY).lazy();
    let wake_ups = WakeUps::default();
    for end in [1_000_000, 2_000_000] {
        assert_eq!(sleeper.sleep(&mut machine, Tsc(end), &wake_ups), Woken::OnTime);
    }
    assert_eq!(sleeper.sleep(&mut machine, Tsc(3_000_000), &wake_ups), Woken::BySignal);
    assert_eq!(sleeper.sleep(&mut machine, Tsc(3_000_000), &wake_ups), Woken::OnTime);
    let late = machine.0.0.tsc.checked_sub(3_000_000).expect("not early");
    assert!(late <= 10_000, "{late}");
}

/// A machine that sends a signal at this instant, once, and counts sleeps.
struct Told(Steered, u64, u32);

impl Machine for Told {
    fn tsc(&mut self) -> Tsc {
        self.0.tsc()
    }

    fn moment(&mut self) -> Moment {
        self.0.moment()
    }

    fn sleep(&mut self, until: Nanos) -> Woken {
        self.2 += 1;
        let mut woken = Watched(Steered::new(&self.0.rates), Vec::new());
        (woken.0.tsc, woken.0.clock) = (self.0.tsc, self.0.clock);
        woken.sleep(until);
        if self.0.tsc < self.1 && woken.0.tsc > self.1 {
            self.0.pass(self.1 - self.0.tsc);
            return Woken::BySignal;
        }
        (self.0.tsc, self.0.clock) = (woken.0.tsc, woken.0.clock);
        Woken::OnTime
    }
}

/// A machine that keeps the instants at which it woke a sleeper between pieces.
struct Watched(Steered, Vec<u64>);

impl Machine for Watched {
    fn tsc(&mut self) -> Tsc {
        self.0.tsc()
    }

    fn moment(&mut self) -> Moment {
        self.0.moment()
    }

    fn sleep(&mut self, until: Nanos) -> Woken {
        let woken = self.0.sleep(until);
        self.1.push(self.0.tsc);
        woken
    }
}

/// A schedule of 1 ms in which these spans of microseconds are windows with a guard of 20 us each.
fn rest_in(windows: &[(u64, u64)]) -> Rest {
    let frame = Nanos::from_millis(1);
    let placements: Vec<_> = windows
        .iter()
        .map(|_| Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::from_micros(20) } })
        .collect();
    let windows = windows.iter().enumerate().map(|(partition, (from, to))| Window {
        partition: PartitionId(partition),
        offset: Nanos::from_micros(*from),
        duration: Nanos::from_micros(to - from),
        period: frame,
    });
    let windows: Vec<_> = windows.collect();
    let schedules = Schedules::new(frame, &placements, &[&windows]).unwrap();
    let base = Timebase { epoch: Tsc(0), frequency: FREQUENCY };
    let board = Arc::new(ScheduleState::new(frame, 1));
    Rest::new(schedules.quiet_on(Cpu(0), None).unwrap(), board, base)
}

#[test]
fn a_wake_up_between_pieces_comes_outside_of_the_windows_of_others() {
    // Where it is wanted, 112 us before its instant, there is a window up to 930 us.
    let rest = rest_in(&[(0, 100), (800, 930)]);
    let mut machine = Watched(Steered::new(&[(0, 0)]), Vec::new());
    let mut sleeper = Sleeper::new(FREQUENCY).resting(rest);
    for cycle in 1..100 {
        let instant = Tsc(cycle * 1_000_000 - 20_000);
        sleeper.sleep(&mut machine, instant, &WakeUps::default());
    }
    let between = machine.1.iter().map(|at| at % 1_000_000).filter(|at| *at < 970_000);
    let between: Vec<u64> = between.collect();
    // From the third sleep on, in which the clock is trusted.
    assert!(between.len() >= 97, "{}", between.len());
    for at in &between {
        let quiet = (775_000..935_000).contains(at) || *at < 105_000;
        assert!(!quiet, "a wake-up at {at}");
    }
}

#[test]
fn what_follows_a_wake_up_between_pieces_comes_outside_of_the_windows_of_others() {
    // Where it is wanted it would be over in time, but not the interrupt that comes up to 50 us after it.
    let rest = rest_in(&[(0, 100), (900, 930)]);
    let (runtime, period) = (Nanos::from_micros(100), Nanos::from_millis(1));
    let rest = rest.reserved(&Reservation { runtime, period });
    let mut machine = Watched(Steered::new(&[(0, 0)]), Vec::new());
    let mut sleeper = Sleeper::new(FREQUENCY).resting(rest);
    for cycle in 1..100 {
        let instant = Tsc(cycle * 1_000_000 - 20_000);
        sleeper.sleep(&mut machine, instant, &WakeUps::default());
    }
    // From the second sleep on, in which the clock is trusted.
    let trusted = machine.1.iter().filter(|at| **at > 1_000_000);
    let between = trusted.map(|at| at % 1_000_000).filter(|at| *at < 970_000);
    let between: Vec<u64> = between.collect();
    assert!(between.len() >= 97, "{}", between.len());
    // Another comes after all windows, too late for what follows it.
    for at in &between {
        let clear = (105_000..825_000).contains(at) || *at >= 935_000;
        assert!(clear, "a wake-up at {at}");
    }
}

/// Windows of others up to 50 us before the release that a thread wakes for 20 us early.
const BEFORE_A_RELEASE: [&[(u64, u64)]; 6] = [
    &[(900, 950)],
    &[(850, 950)],
    &[(793, 950)],
    &[(700, 950)],
    &[(0, 430), (480, 950)],
    &[(0, 100), (150, 250), (300, 950)],
];

#[test]
fn no_wake_up_between_pieces_is_in_a_window_under_a_clock_that_is_trusted() {
    for windows in BEFORE_A_RELEASE {
        let mut machine = Watched(Steered::new(&[(0, 0)]), Vec::new());
        let mut sleeper = Sleeper::new(FREQUENCY).resting(rest_in(windows));
        for cycle in 1..50 {
            let instant = Tsc(cycle * 1_000_000 - 20_000);
            sleeper.sleep(&mut machine, instant, &WakeUps::default());
        }
        // From the second sleep on.
        let trusted = machine.1.iter().filter(|at| **at > 1_000_000).map(|at| at % 1_000_000);
        let trusted: Vec<u64> = trusted.collect();
        assert!(trusted.len() >= 2 * 48, "{windows:?}: {trusted:?}");
        // From their guards, with a lead, to a while after their ends.
        let is_in = |at: &u64| {
            windows.iter().any(|(from, to)| {
                ((from * 1_000).saturating_sub(30_000)..to * 1_000 + 5_000).contains(at)
            })
        };
        let within: Vec<&u64> = trusted.iter().filter(|at| is_in(at)).collect();
        assert!(within.is_empty(), "{windows:?}: {within:?}");
    }
}

#[test]
fn a_window_enforcer_that_does_not_trust_the_clock_wakes_at_no_release() {
    for (start, end) in [(100, 211), (100, 205), (100, 215), (300, 420)] {
        let rates = [(0, 0), (5_500_000, -100_000), (6_500_000, 0)];
        let mut machine = Watched(Steered::new(&rates), Vec::new());
        let rest = rest_in(&[(start, end)]);
        let mut sleeper = Sleeper::new(FREQUENCY).lazy().resting(rest);
        for frame in 0..60 {
            let [start, end] = [start, end].map(|us| Tsc(frame * 1_000_000 + us * 1_000));
            sleeper.sleep_to_end(&mut machine, (start, end), false, &WakeUps::default());
        }
        let behind: Vec<u64> = machine.1.into_iter().filter(|at| *at > 10_000_000).collect();
        assert!(behind.len() > 99, "it looks between, too");
        let at_release = |at: &&u64| {
            let until = (start * 1_000 + 1_000_000 - **at % 1_000_000) % 1_000_000;
            (1..15_000 - 2_000).contains(&until)
        };
        assert_eq!(behind.iter().filter(at_release).count(), 0, "{start}..{end}");
    }
}

#[test]
fn an_end_that_must_be_in_time_is_late_by_what_follows_a_look_at_most() {
    for length in (120..900).step_by(20) {
        for step in (10_000_000..11_000_000).step_by(10_000) {
            let mut machine = Steered::new(&[(0, 0), (step, -100_000)]);
            let mut sleeper = Sleeper::new(FREQUENCY).lazy().resting(rest_in(&[(60, 60 + length)]));
            for frame in 0..12 {
                let [start, end] = [60, 60 + length].map(|us| frame * 1_000_000 + us * 1_000);
                let wake_ups = WakeUps::default();
                sleeper.sleep_to_end(&mut machine, (Tsc(start), Tsc(end)), true, &wake_ups);
                let late = machine.tsc.checked_sub(end).expect("not early");
                assert!(late <= 21_500, "{length} us, a step at {step}: {late} ns late");
            }
        }
    }
}

#[test]
fn who_is_told_by_a_signal_believes_it() {
    let wake_ups = WakeUps::default();
    let mut machine = Told(Steered::new(&[(0, 0)]), 3_500_000, 0);
    let mut sleeper = Sleeper::new(FREQUENCY).lazy();
    for end in [1_000_000, 2_000_000, 3_000_000] {
        assert_eq!(sleeper.sleep(&mut machine, Tsc(end), &wake_ups), Woken::OnTime);
    }
    assert!(!wake_ups.distrusting());
    assert_eq!(sleeper.sleep(&mut machine, Tsc(4_000_000), &wake_ups), Woken::BySignal);
    assert!(wake_ups.distrusting(), "it would be told again");
}

#[test]
fn who_is_to_be_told_of_a_steered_clock_is_told_early() {
    let told = Arc::new(AtomicU64::new(0));
    let count = told.clone();
    let rest = rest_in(&[(0, 100)]).on_steered(Box::new(move || {
        count.fetch_add(1, Ordering::Relaxed);
    }));
    let mut machine = Steered::new(&[(0, 0), (10_200_000, -100_000)]);
    let mut sleeper = Sleeper::new(FREQUENCY).resting(rest);
    for cycle in 1..100 {
        let instant = Tsc(cycle * 1_000_000 - 20_000);
        sleeper.sleep(&mut machine, instant, &WakeUps::default());
        // In the sleep in which the rate changes.
        assert_eq!(told.load(Ordering::Relaxed) > 0, cycle >= 11, "{cycle}");
    }
}

#[test]
fn a_clock_that_has_been_steady_for_long_is_trusted_again() {
    let mut machine = Steered::new(&[(0, 0), (5_000_000, 100_000), (6_000_000, 0)]);
    let mut sleeper = Sleeper::new(FREQUENCY);
    let wake_ups = WakeUps::default();
    for cycle in 1..u64::from(DISTRUST) + 20 {
        sleeper.sleep(&mut machine, Tsc(cycle * 1_000_000), &wake_ups);
    }
    assert!((1..=4).contains(&wake_ups.steered()), "each piece of that millisecond at most");
    let before = machine.sleeps;
    sleeper.sleep(&mut machine, Tsc((u64::from(DISTRUST) + 20) * 1_000_000), &wake_ups);
    assert_eq!(machine.sleeps - before, 2);
}

#[test]
fn an_instant_that_has_passed_does_not_sleep() {
    let mut sleeper = Sleeper::new(FREQUENCY);
    assert_eq!(sleeper.until(Tsc(0), &WakeUps::default()), Woken::OnTime);
}

#[test]
fn a_sleep_by_the_kernel_does_not_end_early() {
    // Whatever the counter's true rate is: a sleep is over when the counter says so.
    for mhz in [500, 1_000, 2_000, 8_000] {
        let frequency = TscFrequency::from_khz(mhz * 1_000).unwrap();
        let mut sleeper = Sleeper::new(frequency);
        let wake_ups = WakeUps::default();
        for _ in 0..3 {
            let until = Tsc::now().after(Ticks(1_000_000));
            assert_eq!(sleeper.until(until, &wake_ups), Woken::OnTime);
            assert!(Tsc::now() >= until);
        }
    }
}

/// Most wake-ups of a lazy sleeper in the last `period` of sleeps of this length, their ends included, at any rate.
fn most_wake_ups(length: Nanos, period: Nanos) -> u64 {
    let at_rate = |ppm| {
        let mut machine = Watched(Steered::new(&[(0, ppm)]), Vec::new());
        let mut sleeper = Sleeper::new(FREQUENCY).lazy();
        let wake_ups = (1..30).map(|cycle| {
            machine.1.clear();
            let instant = cycle * length.0;
            sleeper.sleep(&mut machine, Tsc(instant), &WakeUps::default());
            machine.1.iter().filter(|at| **at + period.0 > instant).count() as u64
        });
        wake_ups.max().unwrap()
    };
    STEERINGS.into_iter().map(at_rate).max().unwrap()
}

#[test]
fn the_budget_of_the_kicker_is_enough_for_the_wake_ups_of_a_long_sleep() {
    for length in [2_100, 3_000, 5_000, 10_000, 40_000, 60_000, 100_000, 1_000_000, 4_000_000] {
        let periods =
            [400, 900, 2_000, 3_000, 5_000, 10_000, 20_000, 40_000, 100_000, 1_000_000, 4_000_000];
        for period in periods.into_iter().filter(|period| *period <= length) {
            let [length, period] = [length, period].map(Nanos::from_micros);
            let budget = KICKER_RUNTIME.plus(pieces_within(period, length));
            // What they take in the lab: 9 us for the end, 7 us for each of the others.
            let used = Nanos::from_micros(9 + 7 * (most_wake_ups(length, period) - 1));
            assert!(used <= budget, "{length} by {period}: {used} of {budget}");
        }
    }
}
