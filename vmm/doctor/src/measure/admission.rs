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

use crate::demand::WindowedCpu;
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
    cpu: &WindowedCpu,
    admission: &Admission,
    domain: Option<&Finding>,
) -> Finding {
    const CHECK: &str = "reservations";
    const COST: &str = "the PLC's thread gets no reservation, and takt run does not start";
    let permille: u64 = cpu.reservations.iter().map(Reservation::permille).sum();
    let asked = format!(
        "CPU {}: {} reservations of {}.{} % together",
        cpu.cpu.0,
        cpu.reservations.len(),
        permille / 10,
        permille % 10
    );
    let unlimited = host.text("proc/sys/kernel/sched_rt_runtime_us").as_deref() == Some("-1");
    if let Some(domain) = domain {
        let ceiling = CEILING_PERMILLE / 10;
        let found =
            format!("{asked}: not tried without a domain; kernels admit {ceiling} % in one");
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
                Some(libc::EPERM) => "sudo takt doctor",
                Some(libc::EBUSY) => {
                    "end other SCHED_DEADLINE threads (ps -eLo cls,pid,comm | grep DLN), or make the windows shorter"
                }
                Some(libc::EINVAL) => "sysctl kernel.sched_deadline_period_min_us=50",
                _ => "a kernel with SCHED_DEADLINE (Linux 3.14 or later)",
            };
            let found = format!("{asked}; refused is {what}");
            match error.raw_os_error() {
                Some(libc::EPERM) => Finding::unseen(CHECK, found, COST, remedy),
                _ => Finding::cannot(CHECK, found, COST, remedy),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demand::Demand;
    use crate::recorded::Recorded;

    /// What is said of an answer, on a host where this process may everything.
    fn judged(admission: &Admission, domain: Option<&Finding>) -> (Severity, String) {
        let tree = Recorded::named("workstation").unpack();
        let cpu = &Demand::usual(&tree.host).windowed[0];
        let finding = judge(&tree.host, cpu, admission, domain);
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
        let cpu = &Demand::usual(&tree.host).windowed[0];
        assert_eq!(judge(&tree.host, cpu, &Admission::All, None).severity, Severity::Warning);
    }
}
