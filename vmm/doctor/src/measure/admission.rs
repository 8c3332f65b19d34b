//! Does the kernel admit the deadline threads of a CPU?
//!
//! The same threads as in a run, with the same reservations, all at the same time; each ends as
//! soon as all have their answer, and its bandwidth goes back with it. No CPU is set apart for the
//! trial, since that would change the host: where a pinned thread is refused for want of a
//! scheduling domain, what a run would do about it is looked up, not tried.

use std::io;
use std::sync::{Arc, Barrier};
use std::thread;

use takt_scheduler::enforce::{become_deadline, pin_to};
use takt_scheduler::reservation::{CEILING_PERMILLE, Reservation};

use crate::checks;
use crate::demand::{Demand, WindowedCpu};
use crate::finding::{Finding, Severity};
use crate::host::{Capability, Host};

/// What the kernel has answered.
#[derive(Debug)]
pub enum Admission {
    /// All threads were admitted.
    All,
    /// A thread could not be pinned.
    NotPinned(io::Error),
    /// A thread that was pinned was refused.
    Refused(Reservation, io::Error),
    /// The host gives no threads.
    NoThread(io::Error),
}

impl Admission {
    /// What was refused for want of a scheduling domain, and not of a privilege.
    #[must_use]
    pub fn needs_a_domain(&self, host: &Host) -> Option<String> {
        match self {
            Admission::Refused(_, error)
                if error.raw_os_error() == Some(libc::EPERM) && host.may(Capability::Schedule) =>
            {
                Some(error.to_string())
            }
            _ => None,
        }
    }
}

/// Tries.
#[must_use]
pub fn try_on(cpu: &WindowedCpu) -> Admission {
    let all = Arc::new(Barrier::new(cpu.reservations.len()));
    let mut threads = Vec::new();
    for &reservation in &cpu.reservations {
        let (all, cpu) = (Arc::clone(&all), cpu.cpu);
        let attempt = move || {
            let answer = pin_to(cpu).map_err(Admission::NotPinned).and_then(|()| {
                become_deadline(reservation).map_err(|e| Admission::Refused(reservation, e))
            });
            all.wait();
            answer
        };
        match thread::Builder::new().name("trial".into()).spawn(attempt) {
            Ok(thread) => threads.push(thread),
            // Those that wait for this one wait until this process ends, which is soon.
            Err(error) => return Admission::NoThread(error),
        }
    }
    let mut answers = threads.into_iter().map(|thread| {
        thread.join().unwrap_or_else(|_| Err(Admission::NoThread(io::Error::other("it died"))))
    });
    answers.find_map(Result::err).unwrap_or(Admission::All)
}

/// Says what it means. `domain` is what was found about a scheduling domain, if one is needed.
#[must_use]
pub fn judge(
    host: &Host,
    demand: &Demand,
    cpu: &WindowedCpu,
    admission: &Admission,
    domain: Option<&Finding>,
) -> Finding {
    const CHECK: &str = "reservations";
    const COST: &str = "the PLC's thread gets no reservation, and takt run does not start";
    let permille: u64 = cpu.reservations.iter().map(Reservation::permille).sum();
    let asked = format!(
        "CPU {}: {} reservations of {} together",
        cpu.cpu.0,
        cpu.reservations.len(),
        percent(permille)
    );
    if let (Admission::Refused(..), Some(limit)) = (admission, Limit::of(host))
        && !limit.admits(&cpu.reservations)
    {
        return Finding::cannot(
            CHECK,
            format!("{asked}; the kernel admits {} at most", percent(limit.permille())),
            COST,
            format!("sysctl kernel.sched_rt_runtime_us={}", limit.period_us / 20 * 19),
        );
    }
    let unlimited = host.text("proc/sys/kernel/sched_rt_runtime_us").as_deref() == Some("-1");
    if let Some(domain) = domain {
        let limit = Limit::of(host).map_or(CEILING_PERMILLE, |limit| limit.permille());
        let limit = percent(limit.min(CEILING_PERMILLE));
        let found = format!("{asked}: not tried without a domain; kernels admit {limit} in one");
        return match domain.severity {
            Severity::Good => Finding::good(CHECK, found),
            _ => Finding::unseen(CHECK, found, COST, "mend `domain` first"),
        };
    }
    match admission {
        Admission::All if unlimited => Finding::warning(
            CHECK,
            format!("{asked}, and the kernel admits whatever is asked for"),
            "another program's reservation can take the time that this PLC was promised",
            "sysctl kernel.sched_rt_runtime_us=950000",
        ),
        Admission::All => Finding::good(CHECK, format!("{asked}, admitted")),
        Admission::NoThread(error) => Finding::cannot(
            CHECK,
            format!("{asked}: no thread: {error}"),
            COST,
            "ulimit -u unlimited",
        ),
        Admission::NotPinned(error) => Finding::cannot(
            CHECK,
            format!("{asked}: no thread may run there: {error}"),
            COST,
            format!(
                "bring the CPU into this process's cpuset; a killed takt may have left /sys/fs/cgroup/takt-cpu{}",
                cpu.cpu.0
            ),
        ),
        Admission::Refused(reservation, error) => {
            let what = format!("{} in {}: {error}", reservation.runtime, reservation.period);
            let remedy = match error.raw_os_error() {
                Some(libc::EPERM) => format!("sudo {}", demand.command()),
                Some(libc::EBUSY) => {
                    "end other SCHED_DEADLINE threads (ps -eLo cls,pid,comm | grep DLN), or make the windows shorter".into()
                }
                Some(libc::EINVAL) => "sysctl kernel.sched_deadline_period_min_us=50".into(),
                _ => "a kernel with SCHED_DEADLINE (Linux 3.14 or later)".into(),
            };
            let found = format!("{asked}; refused is {what}");
            match error.raw_os_error() {
                Some(libc::EPERM) => Finding::unseen(CHECK, found, COST, remedy),
                _ => Finding::cannot(CHECK, found, COST, remedy),
            }
        }
    }
}

/// What the kernel lets the reservations of a CPU have, in this domain or in one that is made: in each
/// `period_us` as much as `runtime_us` (`init_dl_bw` in `kernel/sched/deadline.c`), less `kept`.
struct Limit {
    runtime_us: u64,
    period_us: u64,
    /// Parts of a thousand that the kernel reserves for ordinary threads.
    kept: u64,
}

impl Limit {
    /// That of this host; `None` if there is none.
    fn of(host: &Host) -> Option<Self> {
        // Without a limit the first is -1.
        let runtime_us = host.number("proc/sys/kernel/sched_rt_runtime_us")?;
        let period_us = host.number("proc/sys/kernel/sched_rt_period_us").unwrap_or(1_000_000);
        // `sched_init_dl_servers`, as it ships.
        let kept = if checks::since(&host.kernel(), [6, 12]) { 50 } else { 0 };
        Some(Self { runtime_us, period_us, kept })
    }

    fn admits(&self, reservations: &[Reservation]) -> bool {
        let asked: u128 = reservations.iter().map(|r| share(r.runtime.0, r.period.0)).sum();
        asked + share(self.kept, 1000) <= share(self.runtime_us, self.period_us)
    }

    fn permille(&self) -> u64 {
        let all = u128::from(self.runtime_us) * 1000 / u128::from(self.period_us.max(1));
        u64::try_from(all).unwrap_or(u64::MAX).saturating_sub(self.kept)
    }
}

/// A share of a CPU as the kernel counts it (`to_ratio` in `kernel/sched/core.c`).
fn share(runtime: u64, period: u64) -> u128 {
    (u128::from(runtime) << 20) / u128::from(period.max(1))
}

fn percent(permille: u64) -> String {
    format!("{}.{} %", permille / 10, permille % 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorded::Recorded;

    /// What is said of an answer, on a host where this process may everything.
    fn judged(admission: &Admission, domain: Option<&Finding>) -> (Severity, String) {
        let tree = Recorded::named("workstation").unpack();
        let demand = Demand::usual(&tree.host);
        let finding = judge(&tree.host, &demand, &demand.windowed[0], admission, domain);
        (finding.severity, finding.remedy.unwrap_or_default())
    }

    fn refused(errno: i32) -> Admission {
        let reservation = Demand::usual(&Host::recorded("/none".as_ref(), String::new())).windowed
            [0]
        .reservations[0];
        Admission::Refused(reservation, io::Error::from_raw_os_error(errno))
    }

    #[test]
    fn a_refusal_is_told_by_its_reason() {
        assert_eq!(judged(&Admission::All, None).0, Severity::Good);
        let (severity, remedy) = judged(&refused(libc::EBUSY), None);
        assert!(severity == Severity::Cannot && remedy.contains("DLN"), "{remedy}");
        let (severity, remedy) = judged(&refused(libc::EINVAL), None);
        assert!(severity == Severity::Cannot && remedy.contains("period_min_us"), "{remedy}");
        assert_eq!(judged(&refused(libc::EPERM), None).0, Severity::Unseen);
    }

    #[test]
    fn what_needs_a_domain_is_as_good_as_the_domain() {
        let host = Recorded::named("workstation").unpack();
        let refused = refused(libc::EPERM);
        assert!(refused.needs_a_domain(&host.host).is_some());
        assert_eq!(judged(&refused, Some(&Finding::good("domain", ""))).0, Severity::Good);
        let none = Finding::cannot("domain", "", "", "");
        assert_eq!(judged(&refused, Some(&none)).0, Severity::Unseen);
        let user = Recorded::named("workstation").with("proc/self/status", "CapEff:\t0").unpack();
        assert_eq!(refused.needs_a_domain(&user.host), None);
    }

    #[test]
    fn admission_without_control_is_a_warning() {
        let host = Recorded::named("workstation").with("proc/sys/kernel/sched_rt_runtime_us", "-1");
        let tree = host.unpack();
        let demand = Demand::usual(&tree.host);
        let finding = judge(&tree.host, &demand, &demand.windowed[0], &Admission::All, None);
        assert_eq!(finding.severity, Severity::Warning);
    }

    #[test]
    fn what_the_kernel_admits_in_no_domain_is_not_good() {
        let of = |runtime: &str, period: &str, errno| {
            let host = Recorded::named("workstation")
                .with("proc/sys/kernel/sched_rt_runtime_us", runtime)
                .with("proc/sys/kernel/sched_rt_period_us", period)
                .unpack();
            let demand = Demand::usual(&host.host);
            let domain = (errno == libc::EPERM).then(|| Finding::good("domain", ""));
            let cpu = &demand.windowed[0];
            judge(&host.host, &demand, cpu, &refused(errno), domain.as_ref())
        };
        // What is asked for are 50.7 %, and this kernel keeps 5 % back.
        let enough = of("560000", "1000000", libc::EPERM);
        assert_eq!(enough.severity, Severity::Good);
        assert!(enough.found.ends_with("kernels admit 51.0 % in one"), "{}", enough.found);
        for (runtime, period, remedy) in [
            ("550000", "1000000", "sysctl kernel.sched_rt_runtime_us=950000"),
            ("0", "1000000", "sysctl kernel.sched_rt_runtime_us=950000"),
            ("950000", "10000000", "sysctl kernel.sched_rt_runtime_us=9500000"),
        ] {
            for errno in [libc::EPERM, libc::EBUSY] {
                let less = of(runtime, period, errno);
                assert_eq!(less.severity, Severity::Cannot, "{runtime} {period} {errno}");
                assert_eq!(less.remedy.unwrap(), remedy);
            }
        }
    }
}
