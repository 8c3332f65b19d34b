//! How the host's kernel schedules.

use takt_host::mounts;
use takt_scheduler::table::Cpu;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Capability, Host, written};

/// Whether the kernel can always be preempted.
///
/// A kernel may let the command line choose (`PREEMPT_DYNAMIC`, of which it tells in its version since 5.16, and by its
/// configuration since 5.12); which model holds is then told by debugfs, by the command line, by the log of the boot, or by the
/// configuration. Any other kernel ignores what the command line says.
pub fn preemption(host: &Host) -> Finding {
    const CHECK: &str = "preemption";
    if is_realtime(host) {
        return Finding::good(CHECK, format!("PREEMPT_RT ({})", host.kernel()));
    }
    let model = model(host);
    let found =
        format!("{} without PREEMPT_RT ({})", model.as_deref().unwrap_or("unknown"), host.kernel());
    let remedy =
        "install and start a PREEMPT_RT kernel; in Debian: apt install linux-image-rt-amd64";
    if model.as_deref() == Some("full") {
        let cost = "wake-ups wait for interrupt handlers and spin locks; most are early enough, and the rest has no bound. A thread that another CPU wakes can interrupt a window";
        return Finding::warning(CHECK, found, cost, remedy);
    }
    let less = match is_dynamic(host) {
        true => "; better than nothing: the kernel parameter preempt=full",
        false => "",
    };
    Finding::cannot(
        CHECK,
        found,
        "a wake-up waits until the kernel is done with what it is doing, and that has no bound",
        format!("{remedy}{less}"),
    )
}

/// Whether the command line of the kernel chooses how it is preempted.
fn is_dynamic(host: &Host) -> bool {
    let told = host.text("proc/version").is_some_and(|it| it.contains("PREEMPT_DYNAMIC"));
    told || has_option(host, "CONFIG_PREEMPT_DYNAMIC=y")
}

/// Whether this is a line of the kernel's configuration.
fn has_option(host: &Host, line: &str) -> bool {
    let config = host.text(&format!("boot/config-{}", host.kernel()));
    config.is_some_and(|config| config.lines().any(|one| one == line))
}

/// Whether the kernel is one with PREEMPT_RT.
pub fn is_realtime(host: &Host) -> bool {
    let version = host.text("proc/version").unwrap_or_default();
    host.number("sys/kernel/realtime") == Some(1) || version.contains("PREEMPT_RT")
}

fn model(host: &Host) -> Option<String> {
    const MODELS: [(&str, &str); 4] = [
        ("CONFIG_PREEMPT=y", "full"),
        ("CONFIG_PREEMPT_LAZY=y", "lazy"),
        ("CONFIG_PREEMPT_VOLUNTARY=y", "voluntary"),
        ("CONFIG_PREEMPT_NONE=y", "none"),
    ];
    let running = host.text("sys/kernel/debug/sched/preempt").and_then(|text| {
        let (_, rest) = text.split_once('(')?;
        Some(rest.split_once(')')?.0.to_owned())
    });
    let asked = || host.parameter("preempt").filter(|_| is_dynamic(host));
    let logged = || host.logged("Dynamic Preempt: ").map(str::to_owned);
    let built = || {
        let found = MODELS.iter().find(|(line, _)| has_option(host, line))?;
        Some(found.1.to_owned())
    };
    running.or_else(asked).or_else(logged).or_else(built)
}

/// Whether a reservation ends when it is used up, and not at the next tick.
pub fn budget(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "budget";
    const FILE: &str = "sys/kernel/debug/sched/features";
    let cost = "if a kick failed, a PLC that overruns its window would be stopped by the host's tick only, up to some milliseconds late";
    let locked = host.chosen("sys/kernel/security/lockdown");
    let locked = locked.filter(|mode| ["integrity", "confidentiality"].contains(&mode.as_str()));
    match (host.text(FILE), locked) {
        (None, Some(mode)) => Finding::unseen(
            CHECK,
            format!("the kernel is locked down ({mode}), so not even root can read /{FILE}"),
            cost,
            "switch Secure Boot off in the firmware; or accept it, since it matters only if a kick fails",
        ),
        (None, None) => Finding::unseen(
            CHECK,
            format!("/{FILE} cannot be read"),
            cost,
            format!("sudo mount -t debugfs none /sys/kernel/debug; sudo {}", demand.command()),
        ),
        (Some(features), _)
            if features.split_whitespace().any(|feature| feature == "HRTICK_DL") =>
        {
            Finding::good(CHECK, "ends on time (HRTICK_DL)")
        }
        (Some(_), _) => Finding::warning(
            CHECK,
            "SCHED_DEADLINE looks at budgets at the host's tick only",
            cost,
            format!("echo HRTICK_DL > /{FILE}"),
        ),
    }
}

/// Whether Takt could give a CPU a scheduling domain of its own, where a pinned deadline thread is
/// refused without one. Nothing is tried: making one changes the host.
///
/// A CPU of `isolcpus` gets none. Kernels since 6.7 call the cpuset's partition invalid
/// (`prstate_housekeeping_conflict` in `kernel/cgroup/cpuset.c`), those before make no domain of it
/// (`generate_sched_domains`). One that is alone in `isolcpus` is not refused, and needs none.
pub fn domain(host: &Host, demand: &Demand, Cpu(cpu): Cpu, refused: &str) -> Finding {
    const CHECK: &str = "domain";
    const COST: &str = "the PLC's thread gets no reservation, and takt run does not start";
    let isolated = host.isolated();
    if isolated.contains(&Cpu(cpu)) {
        let less = if isolated.len() > 1 { ", or isolate one CPU only" } else { "" };
        return Finding::cannot(
            CHECK,
            format!(
                "a deadline thread on CPU {cpu} alone is refused ({refused}), and the kernel makes no cpuset's domain of an isolated CPU: isolated are {}",
                written(&isolated)
            ),
            COST,
            format!("take isolcpus off the kernel's command line{less}"),
        );
    }
    match mounts::find_below(host.root()) {
        Ok(_) if !host.may(Capability::Administer) => Finding::unseen(
            CHECK,
            format!(
                "a deadline thread on CPU {cpu} alone is refused ({refused}); takt run as root could make a cpuset for it"
            ),
            COST,
            format!("sudo {}", demand.command()),
        ),
        Ok(root) => Finding::good(
            CHECK,
            format!(
                "takt run will make a cpuset of CPU {cpu} below {}, and take it back",
                root.display()
            ),
        ),
        Err(error) => Finding::cannot(
            CHECK,
            format!(
                "a deadline thread on CPU {cpu} alone is refused ({refused}), and takt run cannot make a cpuset for it"
            ),
            COST,
            error.to_string(),
        ),
    }
}
