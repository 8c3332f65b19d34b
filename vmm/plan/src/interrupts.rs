//! What interrupts of the host may take from a window.
//!
//! Takt keeps timers out of windows where it can ([`takt_scheduler::quiet`]). What is left comes in at
//! most so often in a window, and is allowed for in the analysis of tasks:
//!
//! * the host's tick. Its place is chosen, but a clock that is steered carries it into windows sooner or
//!   later;
//! * a processor of a Linux on the same CPU whose kernel means harm: it has one timer that Takt does not see (the one-shot
//!   and periodic modes of its local APIC), and does not run while a window is used. So it goes off once, or
//!   each time that KVM lets a periodic one (`min_timer_period_us`);
//! * the kernel's timer that takes a deadline thread's bandwidth back, some time after the thread has gone to sleep. The window
//!   enforcer of the CPU has one, and so has the thread of each other partition with windows there. None of them wakes in
//!   this window, so each goes off once at the most. That of the partition's own thread is gone when the thread wakes;
//! * on a host whose clock may be steered, the window enforcer, which looks at the clock within a window that another
//!   partition follows closely and within a long one ([`takt_scheduler::close`]). That takes up to 7 us, and the timer for its
//!   bandwidth goes off once more, so it counts as three. Under a clock that is not trusted there are more looks, which
//!   are not counted;
//! * a Linux that starts anew and whose first CPU is another one. A mapping of Takt's process goes with each processor of the old
//!   machine, also with the one that no thread runs (`vmm/src/apic_keys.rs`), and one with the page by which a host's processor
//!   keeps APICs in hardware. For each, the kernel interrupts all CPUs on which a thread of that process runs, to empty the TLB
//!   (`flush_tlb_mm_range`, arch/x86/mm/tlb.c). With VMX each of its processors that ran on this CPU is one interrupt more
//!   (`loaded_vmcs_clear`, arch/x86/kvm/vmx/vmx.c);
//! * a Linux that starts anew and whose first CPU is this one. The thread that makes its machine new is bound to this CPU, so no
//!   window is open here while it runs. With VMX each processor of the new machine that runs on another CPU is one interrupt here,
//!   since that thread has run it first. If the Linux has windows, that thread also looks ten times a second whether the new processor is taken;
//! * a PLC that starts anew and has memory of a function behind VFIO, whose reset takes each such mapping away for a while
//!   (`vfio_pci_zap_bars`, drivers/vfio/pci/vfio_pci_core.c);
//! * an interrupt that releases a task of the partition's own. The guest lets it come once for each job of that task,
//!   which is an exit, and takes it, which is another.
//!
//! Other interrupts of devices are not counted: their owner says where they go (`takt doctor`). Nor are wake-ups by other CPUs,
//! which are interrupts on kernels without PREEMPT_RT only. There no wake-up has a bound, and nothing is proved.

use takt_scheduler::close::looks_within;
use takt_scheduler::schedules::Schedules;
use takt_scheduler::table::{PartitionId, Placement, Role};
use takt_scheduler::time::Nanos;

/// What one may take: 1.8 us by SVM and 5.8 us by VMX were the longest in emulated machines, the latter
/// where KVM flushes a cache in software after each (L1TF).
pub const INTERRUPT: Nanos = Nanos::from_micros(6);
/// The shortest tick of a host, with `CONFIG_HZ=1000`.
const TICK: Nanos = Nanos::from_millis(1);
/// How often the thread that makes a Linux new looks whether the Linux's own is there to take it
/// (`vmm/src/restart/linux.rs`). With windows that one takes it in its next window.
const LOADER_LOOKS: Nanos = Nanos::from_millis(100);
/// The shortest period of a guest's timer (`min_timer_period_us`, arch/x86/kvm/x86.c).
const PERIODIC: Nanos = Nanos::from_micros(200);

/// The interrupts that may come in a window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Allowance {
    /// Of the host's tick.
    pub tick: u64,
    /// Of the timers of Linuxes on the same CPU.
    pub linux: u64,
    /// Of the kernel's timers for the bandwidth of deadline threads.
    pub bandwidth: u64,
    /// For looks of the window enforcer at the clock, three for each.
    pub looks: u64,
    /// For new starts of other partitions, one of each.
    pub new_starts: u64,
    /// Interrupts that release tasks, and the exits by which they are let in.
    pub devices: u64,
}

impl Allowance {
    /// What all of them take.
    #[must_use]
    pub fn time(&self) -> Nanos {
        Nanos(self.terms().iter().map(|(count, _)| count).sum::<u64>() * INTERRUPT.0)
    }

    /// How many there are of each cause.
    #[must_use]
    pub fn terms(&self) -> [(u64, &'static str); 6] {
        let Allowance { tick, linux, bandwidth, looks, new_starts, devices } = *self;
        [
            (tick, "the host's tick"),
            (linux, "timers of a Linux that Takt cannot place"),
            (bandwidth, "the kernel's timers for the bandwidth of threads"),
            (looks, "looks of the window enforcer at the clock"),
            (new_starts, "new starts of other partitions"),
            (devices, "interrupts that release tasks, and letting them in"),
        ]
    }
}

/// What other partitions have.
#[derive(Debug, Default)]
pub struct Others {
    /// Those that are Linuxes.
    pub linuxes: Vec<PartitionId>,
    /// How many pieces of memory they have together of functions behind VFIO.
    pub device_memory: u64,
}

/// What may come in each window of `partition`, by its longest one in any schedule. `released` are the least times between two
/// releases of the tasks that its interrupts release.
pub fn allowance(
    schedules: &Schedules,
    partition: PartitionId,
    others: &Others,
    released: &[Nanos],
) -> Allowance {
    let own = schedules.placements()[partition.0].cpu;
    let processors = |id: PartitionId| schedules.tables()[0].processors_of(id);
    let beside = others.linuxes.iter().filter(|linux| processors(**linux).any(|cpu| cpu == own));
    let windowed = schedules.placements().iter().enumerate().filter(|(i, placement)| {
        *i != partition.0 && placement.cpu == own && matches!(placement.role, Role::Windowed { .. })
    });
    let bandwidth = 1 + windowed.count() as u64;
    let longest = schedules.timetable_of(partition).map_or(Nanos::ZERO, |t| t.longest());
    let within = |period: Nanos| 1 + longest.0 / period.0;
    // Each has a timer of its own.
    let linux = beside.count() as u64 * within(PERIODIC);
    let of_new_start = |linux: &PartitionId| {
        let all = processors(*linux).count() as u64;
        let here = processors(*linux).filter(|cpu| *cpu == own).count() as u64;
        match schedules.placements()[linux.0] {
            Placement { cpu, .. } if cpu != own => all + 2 + here,
            Placement { role: Role::Windowed { .. }, .. } => within(LOADER_LOOKS),
            Placement { .. } => all - here,
        }
    };
    let new_starts = others.device_memory + others.linuxes.iter().map(of_new_start).sum::<u64>();
    // Between two of one task lies a release. So one can come just before a release and the next just after it, and
    // then the minimum passes.
    let devices = released.iter().map(|minimum| 2 * (1 + within(*minimum))).sum();
    Allowance {
        tick: within(TICK),
        linux,
        bandwidth,
        looks: 3 * looks(schedules, partition),
        new_starts,
        devices,
    }
}

/// How often the window enforcer may look within a window of a partition, under any schedule.
fn looks(schedules: &Schedules, partition: PartitionId) -> u64 {
    let Placement { cpu, role } = schedules.placements()[partition.0];
    let guard = match role {
        Role::Windowed { guard } => guard,
        Role::Background => Nanos::ZERO,
    };
    let windows = schedules.tables().iter().flat_map(|table| table.windows_on(cpu));
    let all = windows.zip(schedules.must_end_in_time_on(cpu).into_iter().flatten());
    let own = all.filter(|(window, _)| window.partition == partition);
    own.map(|(window, must)| looks_within(window.duration, guard, must)).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::table::{Cpu, Window};

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    /// For a window of so many us, on the CPU of a Linux or on another.
    fn for_window(duration: u64, linux_cpu: usize) -> Nanos {
        with_interrupts(duration, &[linux_cpu], &[])
    }

    /// The same with Linuxes on these CPUs.
    fn beside(duration: u64, linux_cpus: &[usize]) -> Nanos {
        with_interrupts(duration, linux_cpus, &[])
    }

    fn with_interrupts(duration: u64, linux_cpus: &[usize], released: &[Nanos]) -> Nanos {
        let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } };
        let linux = |cpu: &usize| Placement { cpu: Cpu(*cpu), role: Role::Background };
        let placements: Vec<_> = std::iter::once(plc).chain(linux_cpus.iter().map(linux)).collect();
        let window = Window {
            partition: PartitionId(0),
            offset: us(0),
            duration: us(duration),
            period: us(20_000),
        };
        let schedules = Schedules::new(us(20_000), &placements, &[&[window]]).unwrap();
        let linuxes = (1..=linux_cpus.len()).map(PartitionId).collect();
        let others = Others { linuxes, device_memory: 0 };
        allowance(&schedules, PartitionId(0), &others, released).time()
    }

    #[test]
    fn a_window_allows_for_ticks_and_for_the_timer_of_a_linux_beside_it() {
        // One is the window enforcer's. A Linux that starts anew on another CPU interrupts three times.
        assert_eq!(for_window(300, 0), us(6 + 18), "a tick, and two of a period of 200 us");
        assert_eq!(for_window(300, 1), us(6 + 18 + 6));
        let in_a_long_one = us(6 + 18 + 18 + 18);
        assert_eq!(for_window(2_500, 1), in_a_long_one, "and a look at the clock");
        assert_eq!(for_window(150, 0), us(6 + 12));
        assert_eq!(beside(300, &[0, 0]), us(6 + 30), "each Linux has a timer");
        assert_eq!(beside(300, &[0, 1]), us(6 + 18 + 18));
    }

    #[test]
    fn a_window_allows_for_the_bandwidth_of_threads_on_its_cpu_and_for_looks_at_the_clock() {
        let guard = us(20);
        let on = |cpu| Placement { cpu: Cpu(cpu), role: Role::Windowed { guard } };
        let window = |partition, offset, duration| Window {
            partition: PartitionId(partition),
            offset: us(offset),
            duration: us(duration),
            period: us(2_000),
        };
        let windows =
            [window(0, 50, 100), window(1, 250, 300), window(2, 600, 300), window(3, 50, 300)];
        let placements = [on(0), on(0), on(0), on(1)];
        let schedules = Schedules::new(us(2_000), &placements, &[&windows]).unwrap();
        let of = |partition| {
            let allowed = allowance(&schedules, PartitionId(partition), &Others::default(), &[]);
            (allowed.bandwidth, allowed.looks)
        };
        // The window enforcer, and the threads of the two others. It looks within one that another follows closely.
        assert_eq!([0, 1, 2, 3].map(of), [(3, 0), (3, 3), (3, 0), (1, 0)]);
    }

    #[test]
    fn a_window_allows_for_one_new_start_of_each_other_partition() {
        let at = |cpu| Placement { cpu: Cpu(cpu), role: Role::Background };
        let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } };
        let window = Window {
            partition: PartitionId(0),
            offset: us(0),
            duration: us(300),
            period: us(1_000),
        };
        let beside = |cpus: &[usize], device_memory| {
            let placements: Vec<_> =
                [plc].into_iter().chain(cpus.first().copied().map(at)).collect();
            let schedules = Schedules::new(us(1_000), &placements, &[&[window]]).unwrap();
            let further = cpus.iter().skip(1).map(|cpu| (PartitionId(1), Cpu(*cpu)));
            let schedules = schedules.with_further(&further.collect::<Vec<_>>());
            let linuxes = cpus.first().map(|_| PartitionId(1)).into_iter().collect();
            let others = Others { linuxes, device_memory };
            allowance(&schedules, PartitionId(0), &others, &[]).new_starts
        };
        assert_eq!(beside(&[0], 0), 0, "what makes it new is on the PLC's own CPU");
        assert_eq!(beside(&[0, 1, 2], 0), 2, "its further processors first run elsewhere");
        assert_eq!(beside(&[1, 2], 0), 4);
        assert_eq!(beside(&[1, 0], 0), 5, "one of its processors has run here");
        assert_eq!(beside(&[], 2), 2);
        let placements = [plc, Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(0) } }];
        let other = Window { partition: PartitionId(1), offset: us(500), ..window };
        let schedules = Schedules::new(us(1_000), &placements, &[&[window, other]]).unwrap();
        let others = Others { linuxes: vec![PartitionId(1)], device_memory: 0 };
        let with_windows = allowance(&schedules, PartitionId(0), &others, &[]);
        assert_eq!(with_windows.new_starts, 1, "who makes it new looks whether it is taken");
    }

    #[test]
    fn a_window_allows_for_interrupts_that_release_tasks() {
        // Two in a window that is shorter than the minimum, with two exits each.
        assert_eq!(with_interrupts(300, &[], &[us(1_000)]), us(6 + 6 + 4 * 6));
        assert_eq!(with_interrupts(300, &[], &[us(1_000), us(200)]), us(6 + 6 + 4 * 6 + 6 * 6));
    }
}
