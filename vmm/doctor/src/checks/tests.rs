//! Recorded hosts, and what the doctor finds on them.

use takt_plan::Allowance;
use takt_scheduler::table::Cpu;

use super::*;
use crate::demand::WindowedCpu;
use crate::finding::Severity::{self, Cannot, Good, Unseen, Warning};
use crate::recorded::Recorded;

pub(super) fn findings(host: &Recorded) -> Vec<Finding> {
    let tree = host.unpack();
    all(&tree.host, &Demand::usual(&tree.host))
}

pub(super) fn finding(host: &Recorded, check: &str) -> Finding {
    findings(host).into_iter().find(|finding| finding.check == check).unwrap()
}

/// Checks that are not good.
fn bad(host: &Recorded) -> Vec<(&'static str, Severity)> {
    let all = findings(host).into_iter().filter(|finding| finding.severity != Good);
    all.map(|finding| (finding.check, finding.severity)).collect()
}

#[test]
fn the_appliance_has_what_its_kernel_can_give() {
    let host = Recorded::named("appliance-rt");
    let expected = [("tsc", Warning), ("budget", Unseen), ("watchdogs", Warning)];
    assert_eq!(bad(&host), expected);
    assert_eq!(finding(&host, "preemption").found, "PREEMPT_RT (6.1.0-56-rt-amd64)");
    let tick = finding(&host, "tick").found;
    assert_eq!(tick, "the host has one CPU, which keeps the time");
}

#[test]
fn what_may_interrupt_the_windows_of_a_file_is_told_with_each_cause() {
    let tree = Recorded::named("appliance-rt").unpack();
    let interrupts = Allowance { tick: 1, linux: 2, ..Allowance::default() };
    let usual = Demand::usual(&tree.host);
    let demand = Demand { interrupts: vec![("plc".into(), interrupts)], ..usual.clone() };
    let found = |demand| {
        let all = all(&tree.host, demand).into_iter();
        all.filter(|it| it.check == "window-interrupts").map(|it| it.found).collect::<String>()
    };
    assert_eq!(
        found(&demand),
        "plc: up to 18us in a window: 1 for the host's tick, 2 for timers of a Linux that Takt cannot place"
    );
    assert_eq!(found(&usual), "a partition file says how many may come in a window");
}

#[test]
fn a_kernel_without_preempt_rt_cannot() {
    let host = Recorded::named("appliance-cloud");
    let preemption = finding(&host, "preemption");
    assert_eq!(preemption.severity, Cannot);
    assert_eq!(preemption.found, "voluntary without PREEMPT_RT (6.1.0-56-cloud-amd64)");
    assert!(bad(&host).contains(&("moved-pages", Warning)));
    assert!(findings(&host).iter().all(|f| f.check == "preemption" || f.severity != Cannot));
}

#[test]
fn how_a_kernel_is_preempted_is_told_by_the_best_source() {
    let host = Recorded::named("appliance-cloud");
    let word = |host: &Recorded| {
        let finding = finding(host, "preemption");
        (finding.found.split(' ').next().unwrap().to_owned(), finding.severity)
    };
    let silent = host.with("log", "").with("proc/cmdline", "quiet");
    assert_eq!(word(&silent), ("unknown".into(), Cannot));
    let built = silent.clone().with("boot/config-6.1.0-56-cloud-amd64", "CONFIG_PREEMPT_NONE=y");
    assert_eq!(word(&built), ("none".into(), Cannot));
    let logged = built.with("log", "[    0.0] Dynamic Preempt: voluntary");
    assert_eq!(word(&logged), ("voluntary".into(), Cannot));
    let asked = logged.with("proc/cmdline", "preempt=none preempt=full -- preempt=lazy");
    assert_eq!(word(&asked), ("full".into(), Warning));
    // A kernel that cannot choose goes by what it was built as.
    let fixed = asked
        .clone()
        .with("log", "")
        .with("proc/version", "Linux version 6.1.0-56-cloud-amd64 (gcc) #1 SMP");
    assert_eq!(word(&fixed), ("none".into(), Cannot));
    assert!(!finding(&fixed, "preemption").remedy.unwrap().contains("preempt="));
    // Linux 5.12 to 5.15 tell of it in their configuration only.
    let config = "CONFIG_PREEMPT=y\nCONFIG_PREEMPT_DYNAMIC=y";
    let told = fixed
        .clone()
        .with("boot/config-6.1.0-56-cloud-amd64", config)
        .with("proc/cmdline", "preempt=none");
    assert_eq!(word(&told), ("none".into(), Cannot));
    let running = asked.with("sys/kernel/debug/sched/preempt", "none (voluntary) full");
    assert_eq!(word(&running), ("voluntary".into(), Cannot));
}

#[test]
fn a_virtual_machine_is_known_as_one() {
    let host = Recorded::named("virtual-machine");
    let expected = [
        ("bare-metal", Warning),
        ("tick", Warning),
        ("preemption", Cannot),
        ("budget", Unseen),
        ("console", Warning),
        ("interrupts", Warning),
        ("watchdogs", Warning),
        ("moved-pages", Warning),
    ];
    assert_eq!(bad(&host), expected);
    let remedy = finding(&host, "watchdogs").remedy.unwrap();
    assert_eq!(remedy, "sysctl kernel.watchdog_cpumask=0");
    let tree = host.unpack();
    let domain = domain(&tree.host, &Demand::usual(&tree.host), Cpu(1), "not permitted");
    assert_eq!(domain.severity, Cannot);
    assert!(domain.remedy.unwrap().contains("cgroup_no_v1=cpuset"));
}

#[test]
fn each_setting_of_a_workstation_is_found_and_its_remedy_named() {
    let host = Recorded::named("workstation");
    let expected = [
        ("tsc-watchdog", Warning, "tsc=nowatchdog on the kernel's command line"),
        ("c-states", Cannot, "echo 1 | tee /sys/devices/system/cpu/cpu7/cpuidle/state2/disable"),
        (
            "governor",
            Warning,
            "echo performance | tee /sys/devices/system/cpu/cpu7/cpufreq/scaling_governor",
        ),
        ("smt", Warning, "echo 0 > /sys/devices/system/cpu/cpu3/online"),
        ("tick", Warning, "kernel parameters rcu_nocbs=7 irqaffinity=0-6"),
        ("budget", Warning, "echo HRTICK_DL > /sys/kernel/debug/sched/features"),
        (
            "kvmclock",
            Warning,
            "echo options kvm kvmclock_periodic_sync=0 >> /etc/modprobe.d/takt.conf && modprobe -r kvm_intel && modprobe kvm_intel",
        ),
        (
            "nx-huge-pages",
            Warning,
            "echo 0 > /sys/module/kvm/parameters/nx_huge_pages_recovery_ratio",
        ),
        (
            "nested",
            Warning,
            "echo options kvm_intel nested=0 >> /etc/modprobe.d/takt.conf && modprobe -r kvm_intel",
        ),
        ("interrupts", Warning, "for i in 128; do echo 0-6 > /proc/irq/$i/smp_affinity_list; done"),
        ("watchdogs", Warning, "sysctl kernel.watchdog_cpumask=0-6"),
        ("huge-pages", Warning, "echo madvise > /sys/kernel/mm/transparent_hugepage/enabled"),
    ];
    let found: Vec<_> = findings(&host).into_iter().filter(|f| f.severity != Good).collect();
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (finding, (check, severity, remedy)) in found.iter().zip(expected) {
        assert_eq!((finding.check, finding.severity), (check, severity));
        let told = finding.remedy.as_deref().unwrap();
        assert!(told.contains(remedy), "{told}");
        assert!(finding.cost.is_some());
    }
    let tree = host.unpack();
    assert_eq!(domain(&tree.host, &Demand::usual(&tree.host), Cpu(7), "").severity, Good);
}

#[test]
fn a_workstation_that_was_mended_is_good() {
    let cpu = "sys/devices/system/cpu";
    let host = Recorded::named("workstation")
        .with("proc/cmdline", "tsc=nowatchdog rcu_nocbs=7")
        .with(&format!("{cpu}/cpu7/cpuidle/state2/disable"), "1")
        .with(&format!("{cpu}/cpu7/cpufreq/scaling_governor"), "performance")
        .with(&format!("{cpu}/cpu7/topology/thread_siblings_list"), "7")
        .with(&format!("{cpu}/online"), "0-2,4-7")
        .with("sys/kernel/debug/sched/features", "NO_HRTICK HRTICK_DL")
        .with("sys/module/kvm/parameters/kvmclock_periodic_sync", "N")
        .with("sys/module/kvm/parameters/nx_huge_pages_recovery_ratio", "0")
        .with("sys/module/kvm_intel/parameters/nested", "N")
        .with("proc/irq/128/effective_affinity_list", "2")
        .with("proc/sys/kernel/watchdog_cpumask", "0-2,4-6")
        .with("sys/kernel/mm/transparent_hugepage/enabled", "always [madvise] never");
    assert_eq!(bad(&host), []);
}

#[test]
fn no_cpu_that_the_file_names_is_to_be_switched_off() {
    let remedy = |host: &Recorded, change: fn(&mut Demand)| {
        let tree = host.unpack();
        let mut demand = Demand::usual(&tree.host);
        change(&mut demand);
        cpus::siblings(&tree.host, &demand).remedy.unwrap()
    };
    let host = Recorded::named("workstation");
    let offline = "echo 0 > /sys/devices/system/cpu/cpu3/online";
    assert_eq!(remedy(&host, |_| {}), offline);
    let apart = "in the partition file, give the partitions of CPU 3,7 CPUs of different cores";
    assert_eq!(remedy(&host, |demand| demand.others.push(Cpu(3))), apart);
    let both = |demand: &mut Demand| {
        let on_three = WindowedCpu { cpu: Cpu(3), ..demand.windowed[0].clone() };
        demand.windowed.insert(0, on_three);
    };
    assert_eq!(remedy(&host, both), apart);
    let fixed = host.without("sys/devices/system/cpu/cpu3/online");
    let told = remedy(&fixed, |_| {});
    assert!(told.contains("CPU 3 cannot be switched off") && !told.contains("echo"), "{told}");
}

#[test]
fn a_kernel_that_is_locked_down_is_no_matter_of_privileges() {
    let host = Recorded::named("workstation").without("sys/kernel/debug/sched/features");
    let of =
        |mode: &str| finding(&host.clone().with("sys/kernel/security/lockdown", mode), "budget");
    for mode in ["none [integrity] confidentiality", "none integrity [confidentiality]"] {
        let budget = of(mode);
        assert_eq!(budget.severity, Unseen);
        let remedy = budget.remedy.unwrap();
        assert!(budget.found.contains("locked down") && remedy.contains("Secure Boot"), "{remedy}");
    }
    assert!(of("[none] integrity confidentiality").remedy.unwrap().contains("debugfs"));
}

#[test]
fn a_kernel_that_stops_guests_for_split_locks_is_found() {
    let host = Recorded::named("workstation");
    let of = |host: &Recorded| finding(host, "split-locks");
    let fatal = host.clone().with("proc/cmdline", "quiet split_lock_detect=fatal");
    assert_eq!(of(&fatal).severity, Good, "no such processor");
    let detects = |host: Recorded| host.with("proc/cpuinfo", "flags\t\t: fpu split_lock_detect");
    let fatal = of(&detects(fatal));
    assert_eq!(fatal.severity, Cannot);
    assert!(fatal.remedy.unwrap().contains("split_lock_detect=off"));
    let switch = "proc/sys/kernel/split_lock_mitigate";
    for (line, mitigates, severity, remedy) in [
        ("quiet", None, Warning, "kernel parameter split_lock_detect=off"),
        ("quiet", Some("1"), Warning, "sysctl kernel.split_lock_mitigate=0"),
        ("split_lock_detect=warn", Some("1"), Warning, "sysctl kernel.split_lock_mitigate=0"),
        ("split_lock_detect=warn", Some("0"), Good, ""),
        ("split_lock_detect=off", Some("1"), Good, ""),
        ("split_lock_detect=ratelimit:9", None, Good, ""),
    ] {
        let mut host = detects(host.clone().with("proc/cmdline", line));
        if let Some(mitigates) = mitigates {
            host = host.with(switch, mitigates);
        }
        let found = of(&host);
        assert_eq!(found.severity, severity, "{line} {mitigates:?}");
        assert!(found.remedy.unwrap_or_default().contains(remedy), "{line} {mitigates:?}");
    }
}

#[test]
fn a_kernel_that_may_give_the_counter_up_is_found_before_it_does() {
    let host = Recorded::named("workstation");
    let of = |host: Recorded| finding(&host, "tsc-watchdog").severity;
    assert_eq!(of(host.clone()), Warning);
    for (line, severity) in [
        ("quiet tsc=reliable", Good),
        ("tsc=nowatchdog quiet", Good),
        ("tsc=recalibrate,nowatchdog", Warning),
        ("tsc=recalibrate", Warning),
        ("tsc=reliable tsc=noirqtime", Good),
    ] {
        assert_eq!(of(host.clone().with("proc/cmdline", line)), severity, "{line}");
    }
    let sure = host.with("proc/cpuinfo", "flags : constant_tsc nonstop_tsc tsc_adjust");
    assert_eq!(of(sure.clone()), Good);
    assert_eq!(of(sure.clone().with("sys/devices/system/node/online", "0-3")), Warning);
    for (version, severity) in [("5.17.0", Good), ("5.16.9", Warning), ("7.0.0-rc1", Good)] {
        let version = format!("Linux version {version} (gcc)");
        assert_eq!(of(sure.clone().with("proc/version", &version)), severity, "{version}");
    }
    assert_eq!(of(sure.with("proc/version", "none")), Warning);
}

#[test]
fn a_clock_that_is_steered_further_than_ntp_does_is_told_with_the_remedy() {
    let host = Recorded::named("workstation");
    let good = finding(&host, "clock-steering");
    assert_eq!(good.severity, Good);
    assert_eq!(
        good.found,
        "-12.3 ppm, +0 ppm of it by the length of a tick (10000 us); kept by NTP; the host's tick creeps by 12.3 us in each \
         second, and so comes into windows"
    );
    let printed = "-f  freq.adjust:  0 (65536 = 1ppm)\n status:  64 (UNSYNC)\n-t  tick:   10833";
    let steered = finding(&host.clone().with("adjtimex", printed), "clock-steering");
    assert_eq!(steered.severity, Warning);
    assert!(
        steered.found.starts_with("+83300.0 ppm")
            && steered.found.contains("(STA_UNSYNC); the host's tick creeps by 83300.0 us")
    );
    assert!(steered.remedy.unwrap().contains("maxslewrate 500"));
    assert_eq!(finding(&host.without("adjtimex"), "clock-steering").severity, Unseen);
}

#[test]
fn a_console_that_is_written_to_with_interrupts_off_is_told() {
    let host = Recorded::named("virtual-machine");
    let console = finding(&host, "console");
    assert_eq!(console.found, "the kernel writes messages of levels below 4 to ttyS0");
    let of = |host: Recorded| finding(&host, "console").severity;
    assert_eq!(of(host.clone().with("proc/sys/kernel/printk", "3 4 1 7")), Good);
    assert_eq!(of(host.clone().with("sys/kernel/realtime", "1")), Good);
    let nowhere = "ttynull0             --- (EC    )  240:0";
    for consoles in [nowhere, "ttyS0 -W- ( C p  )   4:64", ""] {
        assert_eq!(of(host.clone().with("proc/consoles", consoles)), Good, "{consoles}");
    }
    assert_eq!(of(host.clone().with("proc/sys/kernel/printk", "")), Unseen);
    assert_eq!(of(host.without("proc/consoles")), Unseen);
}

#[test]
fn timers_leave_only_a_cpu_without_a_tick() {
    let host = Recorded::named("workstation");
    assert_eq!(finding(&host, "timers").severity, Good);
    let host = host.with("sys/devices/system/cpu/nohz_full", "6-7");
    let timers = finding(&host, "timers");
    assert_eq!(timers.severity, Warning);
    assert!(timers.found.contains("CPU 7"), "{}", timers.found);
    assert_eq!(timers.remedy.unwrap(), "sysctl kernel.timer_migration=0");
    let host = host.with("proc/sys/kernel/timer_migration", "0");
    assert_eq!(finding(&host, "timers").severity, Good);
}

#[test]
fn pages_that_are_not_split_are_not_taken_away() {
    let host = Recorded::named("workstation").with("sys/module/kvm/parameters/nx_huge_pages", "N");
    assert_eq!(finding(&host, "nx-huge-pages").severity, Good);
}

#[test]
fn amds_kvm_has_a_switch_for_nested_guests_too() {
    let host = Recorded::named("workstation")
        .without("sys/module/kvm_intel/parameters/nested")
        .with("sys/module/kvm_amd/parameters/nested", "1");
    let nested = finding(&host, "nested");
    assert_eq!(nested.severity, Warning);
    assert!(nested.found.starts_with("kvm_amd "), "{}", nested.found);
}

#[test]
fn a_clock_that_the_kernel_gave_up_is_told_with_its_reason() {
    let host = Recorded::named("workstation")
        .with("sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet")
        .with("log", "[ 9.1] tsc: Marking TSC unstable due to clocksource watchdog\n[ 9.2] x");
    let tsc = finding(&host, "tsc");
    assert_eq!(tsc.severity, Cannot);
    assert!(tsc.found.ends_with("found it unstable: clocksource watchdog"), "{}", tsc.found);
}

#[test]
fn memory_moves_between_nodes_only_where_there_are_several() {
    let host = Recorded::named("workstation").with("proc/sys/kernel/numa_balancing", "1");
    assert_eq!(finding(&host, "moved-pages").severity, Good);
    let two = host.with("sys/devices/system/node/online", "0-1");
    let remedy = finding(&two, "moved-pages").remedy.unwrap();
    assert_eq!(remedy, "sysctl kernel.numa_balancing=0");
}

#[test]
fn without_privileges_it_says_what_it_could_not_see() {
    let host = Recorded::named("workstation")
        .with("proc/self/status", "CapEff:\t0000000000000000")
        .without("sys/kernel/debug/sched/features");
    let found = bad(&host);
    assert!(found.contains(&("privileges", Unseen)) && found.contains(&("budget", Unseen)));
    assert!(found.contains(&("memlock", Unseen)));
    // In a container, root may be without this one capability.
    let contained = host.clone().with("proc/self/status", "CapEff:\t0000000000800000");
    assert_eq!(finding(&contained, "memlock").severity, Cannot);
    let unlimited = host.with("proc/self/limits", "Max locked memory    unlimited   unlimited");
    assert_eq!(finding(&unlimited, "memlock").severity, Good);
    let tree = unlimited.unpack();
    assert_eq!(domain(&tree.host, &Demand::usual(&tree.host), Cpu(7), "").severity, Unseen);
}

#[test]
fn a_cpu_and_memory_that_are_not_there_are_missed() {
    let tree = Recorded::named("workstation").unpack();
    let usual = Demand::usual(&tree.host);
    let mut demand = Demand { memory: 32 << 30, ..usual };
    demand.others.push(Cpu(8));
    let of = |check: &str| {
        all(&tree.host, &demand).into_iter().find(|finding| finding.check == check).unwrap()
    };
    let none = "this host has no CPU 8: name another one in the partition file";
    assert_eq!(of("cpus").remedy.unwrap(), none);
    assert_eq!(of("memory").severity, Cannot);
    demand.trusted_dma.push("0000:00:06.0".into());
    let iommu = platform::iommu(&tree.host, &demand);
    assert_eq!(iommu.severity, Warning);
    assert!(iommu.found.contains("2 groups") && iommu.found.contains("0000:00:06.0"));
}

#[test]
fn a_host_that_talks_nonsense_is_survived() {
    let odd =
        ["", "\u{fffd}", "[", "]x[", "0-99999999999", "99999999999999999999999", ":\n:::\n 1:"];
    let unit = "etc/systemd/system/takt.service";
    let host = Recorded::named("workstation").with(unit, "ExecStart=takt run x");
    let tree = host.unpack();
    for path in host.paths() {
        for content in odd {
            let before = tree.change(&path, content);
            let found = all(&tree.host, &Demand::usual(&tree.host));
            assert_eq!(found.len(), 29, "{path}: {content:?}");
            tree.change(&path, &before);
        }
    }
    let nothing = Host::recorded(std::path::Path::new("/no/such/folder"), String::new());
    assert_eq!(all(&nothing, &Demand::usual(&nothing)).len(), 29);
}

#[test]
fn huge_pages_that_are_insisted_on_must_be_set_aside() {
    use takt_plan::{HugePageSize, HugePages};
    const FOLDER: &str = "sys/kernel/mm/hugepages/hugepages-2048kB";
    let host = |total: &str, free: &str| {
        Recorded::named("appliance-rt")
            .with(&format!("{FOLDER}/nr_hugepages"), total)
            .with(&format!("{FOLDER}/free_hugepages"), free)
            .with("proc/meminfo", "MemAvailable:     300000 kB")
            .unpack()
    };
    let mut demand = Demand::usual(&host("0", "0").host);
    demand.memory = 264 << 20;
    demand.pages =
        vec![(HugePages::Of(HugePageSize::TwoMiB), 8 << 20), (HugePages::Auto, 256 << 20)];
    let finding = |total: &str, free: &str, check| {
        let all = all(&host(total, free).host, &demand);
        all.into_iter().find(|finding| finding.check == check).unwrap()
    };
    let few = finding("10", "3", "huge-pages-set-aside");
    assert_eq!(
        (few.severity, few.found.as_str()),
        (Cannot, "3 of 2MiB are free, of 10; partitions insist on 4")
    );
    assert_eq!(few.remedy.unwrap(), format!("echo 11 > /{FOLDER}/nr_hugepages"));
    let some = finding("10", "10", "huge-pages-set-aside");
    assert_eq!(some.severity, Good);
    assert_eq!(
        some.found,
        "10 of 2MiB are free, too few for the 128 of a Linux, which does without"
    );
    assert_eq!(finding("10", "10", "memory").severity, Cannot);
    let all = finding("132", "132", "huge-pages-set-aside").found;
    assert_eq!(all, "132 of 2MiB are free, 128 of them for a Linux");
    let memory = finding("132", "132", "memory");
    assert_eq!(memory.severity, Good);
    assert!(
        memory.found.ends_with(
            "0 MiB for the guests and 264 MiB of theirs in huge pages that are set aside"
        ),
        "{}",
        memory.found
    );
}

#[test]
fn shares_of_the_cache_are_planned_as_the_run_would() {
    use takt_host::resctrl::Asked;
    let of = |record: &str| {
        let parts = record.split("== ").filter_map(|part| part.split_once('\n'));
        parts.fold(Recorded::named("workstation"), |host, (path, text)| host.with(path, text))
    };
    let host = of(include_str!("../../../host/tests/hosts/resctrl-xeon.host"));
    let mut demand = Demand::usual(&host.unpack().host);
    let with = |host: &Recorded, ways, demand: &mut Demand| {
        let (partition, cpu) = ("plc".to_owned(), Cpu(3));
        demand.shares = vec![Asked { partition, cpu, domain: None, ways, percent: Some(50) }];
        let all = all(&host.unpack().host, demand);
        all.into_iter().find(|finding| finding.check == "shares").unwrap()
    };
    let good = with(&host, Some(4), &mut demand);
    assert_eq!((good.severity, good.found.as_str()), (Good, "plc: L3:0=f, MB:0=50"));
    let many = with(&host, Some(12), &mut demand);
    assert_eq!(many.severity, Cannot);
    assert_eq!(many.remedy.unwrap(), "at most 10 ways for all partitions together");
    // What a killed Takt has left does not count.
    let left = host
        .clone()
        .with("sys/fs/resctrl/schemata", "L3:0=7f0;1=7ff")
        .with("sys/fs/resctrl/takt-old/schemata", "L3:0=f;1=7ff");
    assert_eq!(with(&left, Some(4), &mut demand).severity, Good);
    let other = host.clone().with("sys/fs/resctrl/db/schemata", "L3:0=3;1=7ff");
    assert!(with(&other, Some(4), &mut demand).remedy.unwrap().contains("rmdir the group db"));
    let gone = Recorded::named("workstation").with("proc/filesystems", "nodev\tresctrl");
    let gone = with(&gone, Some(4), &mut demand);
    assert_eq!(gone.remedy.unwrap(), "mount -t resctrl resctrl /sys/fs/resctrl");
    let apart = of(include_str!("../../../host/tests/hosts/resctrl-xeon-cdp.host"));
    let apart = with(&apart, Some(4), &mut demand);
    assert!(apart.found.contains("`cdp`"), "{}", apart.found);
    let epyc = of(include_str!("../../../host/tests/hosts/resctrl-epyc.host"));
    let epyc = with(&epyc, Some(4), &mut demand);
    assert_eq!(epyc.remedy.unwrap(), "leave `memory_bandwidth` out");
}
