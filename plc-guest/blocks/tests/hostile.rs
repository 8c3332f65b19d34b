//! What no table shows: properties over any sequence of numbers and times.

use core::f64::consts::TAU;
use proptest::prelude::*;
use std::time::Duration;
use takt_blocks::*;

/// Any double: NaN, infinities, subnormal and huge ones as often as plain ones.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -100.0..100.0,
        prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, f64::MAX]),
    ]
}

fn elapsed() -> impl Strategy<Value = Duration> {
    prop_oneof![
        Just(Duration::ZERO),
        Just(Duration::MAX),
        any::<u64>().prop_map(Duration::from_nanos),
        (0..100_u64).prop_map(Duration::from_millis),
    ]
}

fn calls() -> impl Strategy<Value = Vec<(f64, f64, bool, Duration)>> {
    prop::collection::vec((number(), number(), any::<bool>(), elapsed()), 1..40)
}

proptest! {
    #[test]
    fn a_pid_stays_finite_and_within_its_limits(
        gains in prop::array::uniform4(number()),
        calls in calls(),
    ) {
        let [proportional, integral, derivative, derivative_filter] = gains;
        let mut pid = Pid::new(Tuning {
            proportional, integral, derivative, derivative_filter, low: -1.0, high: 2.0,
        });
        for (set, measured, manual, elapsed) in calls {
            let output = if manual {
                pid.track(set, measured, set, elapsed)
            } else {
                pid.update(set, measured, elapsed)
            };
            prop_assert!((-1.0..=2.0).contains(&output), "{output}");
            prop_assert!(pid.integral().is_finite());
        }
    }

    #[test]
    fn filters_stay_finite(parameters in prop::array::uniform5(number()), calls in calls()) {
        let [a, b, c, d, e] = parameters;
        let mut lag = Lag::new(a);
        let mut second = SecondOrder::new(a, b);
        let mut biquad = Biquad::new(Coefficients { b0: a, b1: b, b2: c, a1: d, a2: e });
        let mut fir = Fir::new([a, b, c]);
        let mut ramp = Ramp::new(a, b, 0.0);
        let mut statistics = Statistics::<3>::new();
        for (value, _, _, elapsed) in calls {
            prop_assert!(lag.update(value, elapsed).is_finite());
            prop_assert!(second.update(value, elapsed).is_finite());
            prop_assert!(biquad.update(value).is_finite());
            prop_assert!(fir.update(value).is_finite());
            prop_assert!(ramp.update(value, elapsed).is_finite());
            statistics.update(value);
            prop_assert!(statistics.least() <= statistics.greatest());
        }
    }

    #[test]
    fn a_lag_stays_between_its_least_and_its_greatest_input(
        time_constant in 0.0..10.0,
        calls in calls(),
    ) {
        let mut lag = Lag::new(time_constant);
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for (value, _, _, elapsed) in calls {
            let value = value.clamp(-1e6, 1e6);
            let output = lag.update(value, elapsed);
            least = least.min(value);
            greatest = greatest.max(value);
            if least.is_finite() {
                prop_assert!(output >= least - 1e-6 && output <= greatest + 1e-6);
            }
        }
    }

    #[test]
    fn a_ramp_is_no_faster_than_it_may(up in 0.0..1e3, down in 0.0..1e3, calls in calls()) {
        let mut ramp = Ramp::new(up, down, 0.0);
        for (value, _, _, elapsed) in calls {
            let value = value.clamp(-1e6, 1e6);
            let before = ramp.output();
            let change = ramp.update(value, elapsed) - before;
            let seconds = elapsed.as_secs_f64();
            prop_assert!(change <= up * seconds + 1e-9 && change >= -down * seconds - 1e-9);
        }
    }

    #[test]
    fn timers_count_no_time_twice(calls in calls(), pt in elapsed()) {
        let (mut ton, mut tof, mut tp) = (Ton::default(), Tof::default(), Tp::default());
        for (_, _, input, elapsed) in calls {
            let q = ton.update(input, pt, elapsed);
            prop_assert!(ton.et() <= pt && (!q || input));
            prop_assert!(tof.update(input, pt, elapsed) || !input);
            prop_assert!(tof.et() <= pt);
            tp.update(input, pt, elapsed);
            prop_assert!(tp.et() <= pt);
        }
    }

    #[test]
    fn a_transform_and_its_inverse_cancel_out(
        values in prop::collection::vec((-1e3..1e3_f64, -1e3..1e3_f64), 256),
    ) {
        let (mut real, mut imaginary): (Vec<f64>, Vec<f64>) = values.iter().copied().unzip();
        fft::transform(&mut real, &mut imaginary).unwrap();
        let power: f64 = real.iter().chain(&imaginary).map(|value| value * value).sum();
        let expected: f64 = values.iter().map(|(re, im)| re * re + im * im).sum();
        // Parseval's theorem.
        prop_assert!((power / 256.0 - expected).abs() <= 1e-9 * expected.max(1.0));
        fft::inverse(&mut real, &mut imaginary).unwrap();
        for (k, (re, im)) in values.iter().enumerate() {
            prop_assert!((real[k] - re).abs() < 1e-10 && (imaginary[k] - im).abs() < 1e-10);
        }
    }
}

#[test]
fn a_transform_of_65536_values_is_as_exact_as_one_of_few() {
    const LENGTH: usize = 65_536;
    let at = |j: usize| TAU * 12_345.0 * j as f64 / LENGTH as f64;
    let mut real: Vec<f64> = (0..LENGTH).map(|j| at(j).cos()).collect();
    let mut imaginary: Vec<f64> = (0..LENGTH).map(|j| at(j).sin()).collect();
    fft::transform(&mut real, &mut imaginary).unwrap();
    for k in 0..LENGTH {
        let expected = if k == 12_345 { LENGTH as f64 } else { 0.0 };
        assert!((real[k] - expected).abs() < 1e-6 && imaginary[k].abs() < 1e-6, "{k}: {}", real[k]);
    }
}

#[test]
fn a_transform_refuses_what_is_no_power_of_two() {
    for length in [0, 3, 6, 1_000] {
        let error = fft::transform(&mut vec![0.0; length], &mut vec![0.0; length]).unwrap_err();
        assert_eq!(error, fft::FftError::Length(length));
    }
    let error = fft::transform(&mut [0.0; 4], &mut [0.0; 8]).unwrap_err();
    assert_eq!(error.to_string(), "4 real parts, but 8 imaginary parts");
    let (mut real, mut imaginary) = ([3.5], [1.0]);
    fft::transform(&mut real, &mut imaginary).unwrap();
    assert_eq!((real, imaginary), ([3.5], [1.0]));
}

#[test]
fn counters_stop_at_the_ends_of_their_type() {
    let mut up = Ctu::<i16>::default();
    for _ in 0..40_000 {
        up.update(true, false, 0);
        up.update(false, false, 0);
    }
    assert_eq!(up.cv(), i16::MAX);
    let mut down = Ctd::<u32>::default();
    down.update(false, true, 1);
    for _ in 0..3 {
        down.update(true, false, 1);
        down.update(false, false, 1);
    }
    assert_eq!((down.cv(), down.q()), (0, true));
}

#[test]
fn blocks_without_room_do_nothing() {
    assert_eq!(Fir::<0>::default().update(1.0), 0.0);
    assert_eq!(Delay::<0>::new(5).update(1.0), 1.0);
    let mut statistics = Statistics::<0>::new();
    statistics.update(1.0);
    assert_eq!((statistics.count(), statistics.mean(), statistics.variance()), (0, 0.0, 0.0));
    assert_eq!(Multiplexer::default().update::<f64>(0, &[]), None);
}

/// Gain of a section at a frequency: root mean square of its response, against that of the sine.
fn gain(coefficients: Coefficients, frequency: f64) -> f64 {
    let mut section = Biquad::new(coefficients);
    let mut squares = 0.0;
    for n in 0..20_000 {
        let output = section.update((TAU * frequency * f64::from(n)).sin());
        // The second half is a whole number of periods, long after the start.
        squares += if n < 10_000 { 0.0 } else { output * output };
    }
    (squares / 5_000.0).sqrt()
}

#[test]
fn designed_sections_have_the_gains_of_their_kind() {
    let half_power = std::f64::consts::FRAC_1_SQRT_2;
    let low = Coefficients::low_pass(0.05, biquad::BUTTERWORTH);
    let high = Coefficients::high_pass(0.05, biquad::BUTTERWORTH);
    let band = Coefficients::band_pass(0.05, 2.0);
    let notch = Coefficients::notch(0.05, 2.0);
    // At 0.4 the low-pass has 1 / sqrt(1 + (tan 0.4 pi / tan 0.05 pi)^4).
    for (coefficients, frequency, expected) in [
        (low, 0.001, 1.0),
        (low, 0.05, half_power),
        (low, 0.4, 0.002_648_2),
        (high, 0.05, half_power),
        (high, 0.4, 1.0),
        (band, 0.05, 1.0),
        (notch, 0.05, 0.0),
        (notch, 0.001, 1.0),
    ] {
        let found = gain(coefficients, frequency);
        assert!((found - expected).abs() < 1e-4, "{frequency}: {found}, expected {expected}");
    }
}

#[test]
fn a_state_may_be_copied_in_the_middle() {
    let mut first = Pid::new(Tuning { proportional: 2.0, integral: 0.5, ..Tuning::default() });
    first.update(1.0, 0.9, Duration::from_millis(10));
    let mut second = first;
    let step = Duration::from_millis(7);
    assert_eq!(first.update(1.0, 0.95, step), second.update(1.0, 0.95, step));
    assert_eq!(first, second);
}
