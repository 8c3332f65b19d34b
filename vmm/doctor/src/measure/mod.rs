//! What is measured, because what the host says of itself is not enough.
//!
//! Each part measures into a value of its own and judges it in a function of that value, which is
//! what the tests test. Nothing stays behind: threads end, and the kernel takes back what they had.

mod admission;
mod interrupts;
mod rate;
mod smi;
mod virtualisation;
mod wake_up;
mod warp;

use std::thread;
use std::time::{Duration, Instant};

use crate::checks;
use crate::demand::Demand;
use crate::examination;
use crate::finding::Finding;
use crate::host::Host;
use crate::progress::Progress;

use interrupts::Counts;
use rate::Rate;
use takt_host::kvm::Found;

/// Time between two looks at the clocks, and between two messages of progress.
const STEP: Duration = Duration::from_millis(100);
/// What a measurement takes where windows are frequent.
const USUAL: Duration = Duration::from_secs(3);

/// How long to measure so that each CPU has windows enough: 130 s with the longest period that a kernel admits.
#[must_use]
pub fn usual_duration(demand: &Demand) -> Duration {
    demand.windowed.iter().map(wake_up::least_time).fold(USUAL, Duration::max)
}

/// Measures everything; takes `duration` and a little more.
#[must_use]
pub fn all(host: &Host, demand: &Demand, duration: Duration, progress: &Progress) -> Vec<Finding> {
    progress.say("running kernel-mode code in a guest");
    let examined = examination::ask();
    let mut findings = virtualisation::findings(host, demand, &examined);
    progress.say("asking for reservations");
    for cpu in &demand.windowed {
        let admission = admission::try_on(cpu);
        let refused = admission.needs_a_domain(host);
        let domain = refused.map(|refused| checks::domain(host, demand, cpu.cpu, &refused));
        findings.push(admission::judge(host, demand, cpu, &admission, domain.as_ref()));
        findings.extend(domain);
    }
    progress.say("comparing the counters of the CPUs");
    findings.push(warp::finding(host, demand));
    let kvm_khz = match examined {
        Ok(Found::Complete(machines)) => machines.tsc_khz,
        _ => None,
    };
    findings.extend(while_windows_run(host, demand, kvm_khz, duration, progress));
    findings
}

/// What needs time: wake-ups and gaps on each CPU with windows, and meanwhile the counter's rate,
/// interrupts, and system management interrupts.
fn while_windows_run(
    host: &Host,
    demand: &Demand,
    kvm_khz: Option<u32>,
    duration: Duration,
    progress: &Progress,
) -> Vec<Finding> {
    let frequency = rate::estimate();
    let (before, smi_before) = (Counts::read(host), smi::count(host, demand));
    let end = Instant::now() + duration;
    let threads: Vec<_> = demand
        .windowed
        .iter()
        .map(|cpu| {
            let own = cpu.clone();
            let run = move || wake_up::measure(&own, frequency, end);
            (cpu, thread::Builder::new().name("plc".into()).spawn(run).ok())
        })
        .collect();
    let mut rate = Rate::start();
    while let Some(left) = end.checked_duration_since(Instant::now()) {
        let gone = duration.saturating_sub(left);
        progress.say(&format!(
            "being a PLC: {:.1} s of {:.1} s",
            gone.as_secs_f32(),
            duration.as_secs_f32()
        ));
        thread::sleep(STEP.min(left));
        rate.look();
    }
    progress.done();
    let mut findings = vec![rate.finding(host, demand), rate.clock(host, demand, kvm_khz)];
    let measured: Vec<_> =
        threads.into_iter().map(|(cpu, it)| (cpu, it.and_then(|it| it.join().ok()))).collect();
    let after = Counts::read(host);
    findings.push(smi::finding(host, demand, smi_before, smi::count(host, demand)));
    for (cpu, measured) in measured {
        let interrupts = after.since(&before, cpu.cpu);
        findings.extend(wake_up::findings(host, demand, cpu, measured, &interrupts));
    }
    findings
}

#[cfg(test)]
mod tests {
    use takt_scheduler::time::Nanos;

    use super::*;

    #[test]
    fn a_measurement_lasts_longer_where_windows_are_seldom() {
        let mut demand = Demand::usual(&Host::recorded("/none".as_ref(), String::new()));
        assert_eq!(usual_duration(&demand), Duration::from_secs(3));
        demand.windowed[0].period = Nanos::from_millis(1_000);
        assert_eq!(usual_duration(&demand), Duration::from_secs(31));
        demand.windowed.clear();
        assert_eq!(usual_duration(&demand), USUAL);
    }
}
