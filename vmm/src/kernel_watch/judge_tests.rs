//! Kernels that hang, and kernels that only look so.

use super::*;

const RUNNING: Sample = Sample { interrupts_off: false, halted: false, injections: Some(500) };
const IDLE: Sample = Sample { halted: true, ..RUNNING };
const OFF: Sample = Sample { interrupts_off: true, ..RUNNING };
const HALTED: Sample = Sample { halted: true, ..OFF };

/// Looks at a kernel every 100 ms, which uses this part of the processor, in percent.
struct Kernel {
    judge: Judge,
    at: u64,
    cpu: u64,
    share: u64,
    news: Vec<(u64, News)>,
}

impl Kernel {
    fn new(injections_are_counted: bool) -> Self {
        let judge = Judge::new(injections_are_counted);
        Self { judge, at: 0, cpu: 0, share: 65, news: Vec::new() }
    }

    /// One that has shown that it lives, at time 0.
    fn alive() -> Self {
        let mut kernel = Self::new(true);
        kernel.look(IDLE, true);
        kernel.at = 0;
        kernel
    }

    fn look(&mut self, sample: Sample, printed: bool) {
        let (at, cpu) = (Nanos::from_millis(self.at), Nanos::from_millis(self.cpu));
        let news = self.judge.look(&Look { at, cpu, printed, sample });
        self.news.extend(news.map(|news| (self.at, news)));
        self.at += 100;
        self.cpu += self.share;
    }

    fn stay(&mut self, sample: Sample, ms: u64) {
        (0..ms / 100).for_each(|_| self.look(sample, false));
    }
}

fn stuck(how: How, since_ms: u64) -> News {
    News::Stuck(Stuck { how, since_ns: since_ms * 1_000_000 })
}

#[test]
fn a_kernel_that_spins_or_has_halted_for_good_is_told_once_after_its_time() {
    for (sample, how) in [(OFF, How::Spinning), (HALTED, How::Halted), (RUNNING, How::Deaf)] {
        let mut kernel = Kernel::alive();
        kernel.stay(sample, 60_000);
        assert_eq!(kernel.news, [(2_000, stuck(how, 0))]);
    }
}

#[test]
fn an_idle_linux_is_never_told_of_however_long_it_idles() {
    let mut kernel = Kernel::alive();
    kernel.share = 0;
    kernel.stay(IDLE, 3_600_000);
    assert_eq!(kernel.news, []);
}

#[test]
fn a_busy_linux_takes_its_ticks() {
    let mut kernel = Kernel::alive();
    for n in 0..1_000 {
        kernel.look(Sample { injections: Some(n), ..RUNNING }, false);
        kernel.look(Sample { injections: Some(n), ..OFF }, false);
    }
    // Where they are not counted, what is seen is whether they are switched off.
    let mut uncounted = Kernel::new(false);
    for injections in [None, Some(7)] {
        uncounted.stay(Sample { injections, ..RUNNING }, 60_000);
        for _ in 0..100 {
            uncounted.stay(Sample { injections, ..OFF }, 1_900);
            uncounted.look(Sample { injections, ..RUNNING }, false);
        }
    }
    assert_eq!((kernel.news, uncounted.news), (vec![], vec![]));
}

#[test]
fn a_kernel_that_spins_is_told_of_where_injections_are_not_counted_too() {
    let mut kernel = Kernel::new(false);
    kernel.look(Sample { injections: None, ..RUNNING }, false);
    kernel.stay(Sample { injections: None, ..OFF }, 5_000);
    assert_eq!(kernel.news, [(2_100, stuck(How::Spinning, 100))]);
}

#[test]
fn a_kernel_that_gets_no_processor_is_not_to_blame() {
    let mut kernel = Kernel::alive();
    kernel.share = 1;
    kernel.stay(OFF, 20_000);
    assert_eq!(kernel.news, []);
}

#[test]
fn before_its_first_heartbeat_a_kernel_has_more_time() {
    let mut kernel = Kernel::new(true);
    kernel.stay(OFF, 30_000);
    assert_eq!(kernel.news, [(10_000, stuck(How::Spinning, 0))]);
    let mut unpacks = Kernel::new(true);
    unpacks.stay(OFF, 9_900);
    unpacks.stay(IDLE, 1_000);
    assert_eq!(unpacks.news, []);
}

#[test]
fn a_byte_on_the_console_is_a_heartbeat() {
    let mut kernel = Kernel::alive();
    for _ in 0..30 {
        kernel.stay(OFF, 1_900);
        kernel.look(OFF, true);
    }
    assert_eq!(kernel.news, []);
}

#[test]
fn a_kernel_that_goes_on_is_told_of_too() {
    let mut kernel = Kernel::alive();
    kernel.stay(OFF, 3_000);
    kernel.look(Sample { injections: Some(501), ..OFF }, false);
    kernel.stay(IDLE, 3_000);
    let goes_on = News::GoesOn(Nanos::from_millis(3_000));
    assert_eq!(kernel.news, [(2_000, stuck(How::Spinning, 0)), (3_000, goes_on)]);
}

#[test]
fn a_start_forgets_what_was_before() {
    let mut kernel = Kernel::alive();
    kernel.stay(HALTED, 1_900);
    kernel.judge.restarted();
    assert!(!kernel.judge.suspects());
    kernel.stay(HALTED, 5_000);
    assert_eq!(kernel.news, []);
}

#[test]
fn a_second_look_makes_a_suspicion() {
    let mut kernel = Kernel::alive();
    assert!(!kernel.judge.suspects());
    kernel.look(OFF, false);
    assert!(!kernel.judge.suspects());
    kernel.look(OFF, false);
    assert!(kernel.judge.suspects());
    kernel.look(RUNNING, false);
    assert!(!kernel.judge.suspects());
    // What is known needs no more looks than what is not suspected.
    kernel.stay(OFF, 5_000);
    assert!(!kernel.news.is_empty() && !kernel.judge.suspects());
}
