//! Noticing that a Linux's kernel does nothing any more.
//!
//! A Linux has no deadline to miss, so a kernel that has died looks from outside like one that has
//! nothing to do, or much. Three things tell them apart, and all are facts about the processor, not
//! guesses about the kernel:
//!
//! | state | what is seen for [`judge::TIME`] | what else it could be |
//! | --- | --- | --- |
//! | halted | halted with interrupts off, at every look | nothing: no interrupt ends that |
//! | spinning | interrupts off at every look, none injected, processor time used | a section without interrupts that is as long |
//! | deaf | running at every look with interrupts on, none injected, processor time used | nothing: a busy kernel has a tick |
//!
//! In all three the console says nothing meanwhile. The looks are those of the vCPU's own thread
//! ([`crate::vcpu::probe`]), twice a second, and with every tick of the supervisor once there is a
//! suspicion. An idle Linux halts with interrupts on, which is none of the three however long it lasts.
//!
//! KVM's count of injections, a binary statistic of the vCPU, counts what KVM injects by hand. Where
//! the processor delivers interrupts by itself (APICv, AVIC) it does not grow, and then a deaf kernel
//! cannot be told from a busy one: nothing is said of it. A spinning one still can: that its interrupts
//! are off at a hundred looks in a row is no chance.
//!
//! A kernel that has panicked waits with interrupts on, and takes its ticks as before. Only its console
//! tells ([`crate::init_watch::PanicSeen`]), which is the guest's own word.
//!
//! None of this is an error of the health monitor: what should follow from it is what follows from
//! silence, for which a partition has a watchdog. It is told, and stands in the report.

pub mod judge;

use std::fmt;
use std::fs;

use takt_scheduler::time::{Nanos, Timebase};

use crate::init_watch::PanicSeen;
use crate::report::{How, Stuck};
use crate::vcpu::Control;
use judge::{Judge, Look};

/// Between two looks while there is no suspicion.
const INTERVAL: Nanos = Nanos::from_millis(500);

/// Watches over the kernel of one Linux.
#[derive(Debug)]
pub struct KernelWatch {
    judge: Judge,
    panic: PanicSeen,
    /// True between a question to the vCPU's thread and its answer.
    asked: bool,
    next: Nanos,
    printed: bool,
    stuck: Option<Stuck>,
}

/// What has become known of a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// It does nothing any more.
    Stuck(Stuck),
    /// It does something again, after this time.
    GoesOn(Nanos),
}

impl fmt::Display for News {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            News::Stuck(stuck) => {
                write!(
                    f,
                    "its kernel {stuck}; only a restart ends that: `watchdog` in the partition file"
                )?;
                match stuck.how {
                    How::Panicked => f.write_str(" or `panic=10` in its `cmdline` makes one"),
                    How::Spinning | How::Deaf | How::Halted => f.write_str(" makes one"),
                }
            }
            News::GoesOn(after) => {
                write!(f, "its kernel goes on, after {:.3} s", after.0 as f64 / 1e9)
            }
        }
    }
}

impl KernelWatch {
    /// Watches a kernel whose console tells of a panic by `panic`. Looks at the host.
    #[must_use]
    pub fn new(panic: PanicSeen) -> Self {
        Self {
            judge: Judge::new(injections_are_counted()),
            panic,
            asked: false,
            next: INTERVAL,
            printed: false,
            stuck: None,
        }
    }

    /// The console has shown something.
    pub fn printed(&mut self) {
        self.printed = true;
    }

    /// The guest was started anew.
    pub fn restarted(&mut self) {
        self.judge.restarted();
        self.panic.forget();
        // What was printed, or is answered still, is of the guest before.
        (self.stuck, self.asked, self.printed) = (None, false, false);
    }

    /// What is known of the kernel.
    #[must_use]
    pub fn stuck(&self) -> Option<Stuck> {
        self.stuck
    }

    /// Looks after the kernel, with each tick of the supervisor. `control` is that of a thread that
    /// answers questions, if there is one.
    pub fn look(&mut self, base: &Timebase, now: Nanos, control: Option<&Control>) -> Option<News> {
        if let Some(at) = self.panic.instant()
            && self.stuck.is_none_or(|stuck| stuck.how != How::Panicked)
        {
            let stuck = Stuck { how: How::Panicked, since_ns: base.offset(at).0 };
            self.stuck = Some(stuck);
            return Some(News::Stuck(stuck));
        }
        let control = control?;
        let mut news = None;
        if self.asked {
            let sample = control.answer()?;
            self.asked = false;
            let (cpu, printed) = (control.cpu_time()?, std::mem::take(&mut self.printed));
            news = self.judge.look(&Look { at: now, cpu, printed, sample });
            self.next = if self.judge.suspects() { now } else { now.plus(INTERVAL) };
        }
        if now >= self.next {
            control.ask();
            self.asked = true;
        }
        // A panic is known from the kernel itself; its processor says less.
        news.filter(|_| self.stuck.is_none_or(|stuck| stuck.how != How::Panicked)).inspect(|news| {
            self.stuck = match news {
                News::Stuck(stuck) => Some(*stuck),
                News::GoesOn(_) => None,
            };
        })
    }
}

/// Whether KVM injects each interrupt by hand, and so counts it. Where the host does not tell, not.
fn injections_are_counted() -> bool {
    let parameters = ["kvm_intel/parameters/enable_apicv", "kvm_amd/parameters/avic"];
    let values = parameters.map(|path| fs::read_to_string(format!("/sys/module/{path}")).ok());
    counted(values.iter().flatten().map(|value| value.trim()))
}

fn counted<'a>(values: impl IntoIterator<Item = &'a str>) -> bool {
    let mut values = values.into_iter().peekable();
    values.peek().is_some() && values.all(|value| matches!(value, "N" | "0"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injections_count_only_where_no_module_delivers_by_itself() {
        assert!(counted(["N"]) && counted(["0"]));
        assert!(!counted([]) && !counted(["Y"]) && !counted(["1"]) && !counted(["N", "Y"]));
    }

    #[test]
    fn news_say_what_to_do() {
        let told = |how| News::Stuck(Stuck { how, since_ns: 5_120_000_000 }).to_string();
        assert_eq!(
            told(How::Spinning),
            "its kernel spins with interrupts off since 5.120 s; only a restart ends that: \
             `watchdog` in the partition file makes one"
        );
        assert!(told(How::Panicked).ends_with("or `panic=10` in its `cmdline` makes one"));
    }
}
