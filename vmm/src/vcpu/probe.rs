//! Asking a vCPU's thread how its guest is.
//!
//! Only the thread that owns a vCPU can look at its state, and only while the guest is out. So the
//! supervisor notes a question and kicks; the thread looks, leaves the answer in some atomics, and
//! goes back into the guest. A question is asked again before its answer was taken only if the guest was started
//! anew meanwhile, so no answer is written while another is read. Neither side waits: the answer of a thread that gets no processor is late.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use kvm_bindings::KVM_MP_STATE_HALTED;

use super::Control;
use super::kick::Kickable;

/// How a guest was when its thread looked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// It has interrupts switched off.
    pub interrupts_off: bool,
    /// It waits for an interrupt.
    pub halted: bool,
    /// How many interrupts KVM has injected by hand; `None` if it does not tell.
    pub injections: Option<u64>,
}

/// A question and its answer.
#[derive(Debug, Default)]
pub struct Probe {
    asked: AtomicBool,
    answered: AtomicBool,
    interrupts_off: AtomicBool,
    halted: AtomicBool,
    /// One more than the number; 0 for none.
    injections: AtomicU64,
}

impl Control {
    /// Asks the thread of a background partition to look at its guest. An answer that was not taken is forgotten.
    pub fn ask(&self) {
        self.probe.answered.store(false, Ordering::SeqCst);
        self.probe.asked.store(true, Ordering::SeqCst);
        self.kick();
    }

    /// The answer, once; `None` as long as there is none.
    #[must_use]
    pub fn answer(&self) -> Option<Sample> {
        self.probe.answered.swap(false, Ordering::SeqCst).then(|| Sample {
            interrupts_off: self.probe.interrupts_off.load(Ordering::SeqCst),
            halted: self.probe.halted.load(Ordering::SeqCst),
            injections: self.probe.injections.load(Ordering::SeqCst).checked_sub(1),
        })
    }

    /// Answers what was asked, if anything was; on the thread of the vCPU, which is out of its guest.
    pub(super) fn look_if_asked(&self, kickable: &mut Kickable) {
        if self.probe.asked.swap(false, Ordering::SeqCst) {
            self.tell(kickable.sample());
        }
    }

    fn tell(&self, sample: Sample) {
        let injections = sample.injections.map_or(0, |count| count.saturating_add(1));
        self.probe.interrupts_off.store(sample.interrupts_off, Ordering::SeqCst);
        self.probe.halted.store(sample.halted, Ordering::SeqCst);
        self.probe.injections.store(injections, Ordering::SeqCst);
        self.probe.answered.store(true, Ordering::SeqCst);
    }
}

impl Kickable {
    /// Looks at the guest. Two system calls; does not allocate.
    fn sample(&mut self) -> Sample {
        // KVM leaves the flag at every return of `KVM_RUN` (`post_kvm_run_save`).
        let interrupts_off = self.vcpu().get_kvm_run().if_flag == 0;
        let halted =
            self.vcpu().get_mp_state().is_ok_and(|state| state.mp_state == KVM_MP_STATE_HALTED);
        Sample { interrupts_off, halted, injections: self.count_injections() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};

    use crate::init_watch::PanicSeen;
    use crate::kernel_watch::{KernelWatch, News};
    use crate::report::How;
    use crate::vcpu::kick;

    #[test]
    fn an_answer_is_taken_once_and_whole() {
        let control = Control::default();
        assert_eq!(control.answer(), None);
        for injections in [None, Some(0), Some(7), Some(u64::MAX - 1)] {
            let sample = Sample { interrupts_off: true, halted: injections.is_none(), injections };
            control.tell(sample);
            assert_eq!((control.answer(), control.answer()), (Some(sample), None));
        }
    }

    #[test]
    fn a_kernel_that_was_started_anew_has_all_the_time_to_start_whatever_the_one_before_did() {
        kick::install().unwrap();
        let control = Control::default();
        control.thread.store(kick::this_thread(), Ordering::SeqCst);
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc(0), frequency };
        let mut watch = KernelWatch::new(PanicSeen::default());
        let dead = Sample { interrupts_off: true, halted: true, injections: None };
        let lived = Sample { interrupts_off: false, ..dead };
        let mut look = |ms, sample: Option<Sample>| {
            sample.into_iter().for_each(|sample| control.tell(sample));
            watch.printed();
            watch.restarted();
            watch.look(&base, Nanos::from_millis(ms), Some(&control))
        };
        // An answer of the one before, a question that it was asked, and what it has printed last.
        assert_eq!([look(500, None), look(500, Some(lived)), look(500, None)], [None; 3]);
        assert_eq!(watch.look(&base, Nanos::from_millis(500), Some(&control)), None);
        let told = (501..20_000).step_by(20).find_map(|ms| {
            control.tell(dead);
            let news = watch.look(&base, Nanos::from_millis(ms), Some(&control))?;
            Some((ms, news))
        });
        let Some((at, News::Stuck(stuck))) = told else { panic!("{told:?}") };
        assert_eq!(stuck.how, How::Halted);
        assert!((10_500..11_100).contains(&at), "{at}");
    }
}
