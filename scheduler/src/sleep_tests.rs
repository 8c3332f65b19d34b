use super::*;

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

#[test]
fn a_millisecond_under_a_clock_as_it_should_be_is_one_sleep() {
    for ppm in [0, 500, -500] {
        let mut machine = Steered::new(&[(0, ppm)]);
        let mut sleeper = Sleeper::new(FREQUENCY);
        let wake_ups = WakeUps::default();
        for cycle in 1..1_000 {
            let before = (machine.sleeps, wake_ups.early());
            sleeper.sleep(&mut machine, Tsc(cycle * 1_000_000), &wake_ups);
            if cycle > 2 {
                // What 500 ppm leave of a millisecond is waited for.
                let early = wake_ups.early() - before.1;
                assert_eq!((machine.sleeps - before.0, early), (1, u64::from(ppm > 0)), "{ppm}");
            }
        }
        assert_eq!(wake_ups.steered(), 0);
    }
}

#[test]
fn the_first_step_of_the_rate_is_the_only_one_that_is_felt() {
    // Ten milliseconds each at a rate that is slower by 10 %, and at one that is as it should be.
    let rates: Vec<_> = (1..40).map(|i| (i * 10_500_000, -100_000 * (i as i64 % 2))).collect();
    let mut machine = Steered::new(&rates);
    let mut sleeper = Sleeper::new(FREQUENCY);
    let mut late = Vec::new();
    for cycle in 1..400 {
        let instant = cycle * 1_000_000;
        sleeper.sleep(&mut machine, Tsc(instant), &WakeUps::default());
        late.push(machine.tsc.checked_sub(instant).expect("not early"));
    }
    let felt: Vec<_> = late.iter().filter(|&&ns| ns > 7_500).collect();
    assert!(felt.len() == 1 && *felt[0] <= 1_000_000 / 9, "{felt:?}");
    assert_eq!(late.iter().position(|&ns| ns > 7_500), Some(10));
}

#[test]
fn a_clock_that_has_been_steady_for_long_is_trusted_again() {
    let mut machine = Steered::new(&[(0, 0), (5_000_000, 100_000), (6_000_000, 0)]);
    let mut sleeper = Sleeper::new(FREQUENCY);
    let wake_ups = WakeUps::default();
    for cycle in 1..u64::from(DISTRUST) + 20 {
        sleeper.sleep(&mut machine, Tsc(cycle * 1_000_000), &wake_ups);
    }
    assert_eq!(wake_ups.steered(), 1);
    let before = machine.sleeps;
    sleeper.sleep(&mut machine, Tsc((u64::from(DISTRUST) + 20) * 1_000_000), &wake_ups);
    assert_eq!(machine.sleeps - before, 1);
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

#[test]
fn moments_agree_if_the_clock_keeps_its_rate() {
    let at = |tsc, clock| Moment { tsc: Tsc(tsc), clock: Nanos(clock) };
    let second = 1_000_000_000;
    for (clock, agrees) in [
        (second, true),
        (second + 900_000, true),
        (second - 900_000, true),
        (second + 1_100_000, false),
        (second - 1_100_000, false),
        (0, false),
        (u64::MAX, false),
    ] {
        let agreed = at(second, clock).agrees_with(at(0, 0), FREQUENCY);
        assert_eq!(agreed, agrees, "{clock}");
    }
    // A counter that has gone back has not gone on.
    assert!(!at(0, second).agrees_with(at(second, 0), FREQUENCY));
}
