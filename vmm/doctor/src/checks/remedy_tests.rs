//! What the doctor proposes on recorded hosts, and that it can be typed.

use takt_scheduler::table::Cpu;

use super::tests::{finding, findings};
use super::*;
use crate::finding::Severity::{Cannot, Good, Unseen, Warning};
use crate::recorded::Recorded;

#[test]
fn a_command_overwrites_no_file_of_the_owners_and_is_whole() {
    let intel = Recorded::named("workstation");
    let amd = intel
        .clone()
        .without("sys/module/kvm_intel/parameters/nested")
        .with("sys/module/kvm_amd/parameters/nested", "1")
        .with("proc/cpuinfo", "flags : svm constant_tsc nonstop_tsc");
    let steered = intel.clone().with("adjtimex", "freq.adjust: 0\nstatus: 64\ntick: 10833");
    let others = ["appliance-rt", "appliance-cloud", "virtual-machine"].map(Recorded::named);
    for host in others.into_iter().chain([intel, amd.clone(), steered]) {
        for finding in findings(&host) {
            let told = finding.remedy.unwrap_or_default();
            assert!(!told.contains(" > /etc/") && !told.contains(".conf,"), "{told}");
        }
    }
    let told = finding(&amd, "kvmclock").remedy.unwrap();
    assert!(told.ends_with("&& modprobe -r kvm_amd && modprobe kvm_amd"), "{told}");
}

#[test]
fn a_command_that_asks_again_asks_for_the_same_file() {
    let tree = Recorded::named("workstation")
        .with("proc/self/status", "CapEff:\t0000000000000000")
        .without("sys/kernel/debug/sched/features")
        .unpack();
    let file = Some("/etc/takt/my plant.toml".into());
    let demand = Demand { file, ..Demand::usual(&tree.host) };
    let again = "sudo takt doctor '/etc/takt/my plant.toml'";
    let mut found = all(&tree.host, &demand);
    found.push(domain(&tree.host, &demand, Cpu(7), "not permitted"));
    let asking: Vec<_> =
        found.iter().filter(|it| it.remedy.as_ref().is_some_and(|r| r.ends_with(again))).collect();
    let checks: Vec<_> = asking.iter().map(|finding| finding.check).collect();
    assert_eq!(checks, ["privileges", "budget", "memlock", "domain"]);
}

#[test]
fn a_tick_stays_with_deadline_threads_and_brings_less_where_the_kernel_cleans_up_elsewhere() {
    const NOHZ_FULL: &str = "sys/devices/system/cpu/nohz_full";
    let host = Recorded::named("workstation");
    let of = |line: &str| finding(&host.clone().with("proc/cmdline", line), "tick");
    for line in ["quiet", "rcu_nocbs=1-6", "rcu_nocbs=7 rcu_nocbs=1", "rcu_nocbs"] {
        let tick = of(line);
        assert_eq!(tick.severity, Warning, "{line}");
        assert!(!tick.remedy.unwrap().contains("nohz_full"));
    }
    for line in ["rcu_nocbs=1-7", "rcu_nocbs=all", "rcu_nocbs=1,5-N"] {
        assert_eq!(of(line).severity, Good, "{line}");
    }
    assert_eq!(of("rcu_nocbs=7 skew_tick=0").severity, Good);
    let skewed = of("rcu_nocbs=7 skew_tick=1");
    assert_eq!(skewed.severity, Warning);
    assert_eq!(skewed.remedy.unwrap(), "take skew_tick off the kernel's command line");
    let implied = finding(&host.with(NOHZ_FULL, "6-7"), "tick");
    let kept = "CPU 7 has the host's tick, which deadline threads keep; takt run places its epoch to it if its windows leave room";
    assert_eq!((implied.severity, implied.found.as_str()), (Good, kept));
}

#[test]
fn no_domain_can_be_made_of_an_isolated_cpu() {
    let of = |isolated: &str, line: &str| {
        let host = Recorded::named("workstation").with("proc/cmdline", line);
        let tree = host.with("sys/devices/system/cpu/isolated", isolated).unpack();
        domain(&tree.host, &Demand::usual(&tree.host), Cpu(3), "not permitted")
    };
    let several = of("2-3", "isolcpus=2-3");
    assert_eq!(several.severity, Cannot);
    assert_eq!(
        several.remedy.unwrap(),
        "take isolcpus off the kernel's command line, or isolate one CPU only"
    );
    // It would not be refused, if it were only for that.
    let one = of("3", "isolcpus=3");
    assert_eq!(one.severity, Cannot);
    assert_eq!(one.remedy.unwrap(), "take isolcpus off the kernel's command line");
    assert_eq!(of("2", "isolcpus=2").severity, Good);
    assert_eq!(of("", "isolcpus=managed_irq,2-3").severity, Good);
}

#[test]
fn interrupts_that_cannot_be_moved_are_the_kernels_to_place() {
    let host = Recorded::named("workstation");
    let told = finding(&host, "interrupts").remedy.unwrap();
    assert!(told.contains("isolcpus=managed_irq,7, or fewer queues"), "{told}");
    assert!(!told.contains("irqaffinity"), "{told}");
    let unread = finding(&host.without("proc/interrupts"), "interrupts");
    assert_eq!(unread.severity, Unseen);
}

#[test]
fn only_a_cpu_that_is_there_is_switched_on() {
    let tree =
        Recorded::named("workstation").with("sys/devices/system/cpu/online", "0-2,4-7").unpack();
    let mut demand = Demand::usual(&tree.host);
    demand.others = vec![Cpu(3), Cpu(8)];
    assert_eq!(
        cpus::online(&tree.host, &demand).remedy.unwrap(),
        "echo 1 > /sys/devices/system/cpu/cpu3/online; this host has no CPU 8: name another one in the partition file"
    );
}
