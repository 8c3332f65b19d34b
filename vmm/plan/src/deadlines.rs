//! Whether the tasks of the partitions meet their deadlines, under each schedule.
//!
//! A file whose tasks cannot be in time is as wrong as one whose windows overlap, and is refused
//! like it: both are mistakes in a plan, and both would show only in operation. That goes for a
//! set that the analysis cannot prove, too. The remedy is the same as for one that fails, so the
//! two are not told apart.
//!
//! Each schedule is judged by itself; `docs/analysis.md` says what that leaves out.

use takt_scheduler::analysis::{
    Analysis, Load, Method, Miss, Rule, Supply, SupplyError, Task, TaskSet, Verdict, analyse,
    analyse_with,
};
use takt_scheduler::guard::{AUTO_LEAST, ENTRY};
use takt_scheduler::schedules::{ScheduleId, Schedules};
use takt_scheduler::table::{PartitionId, Role};
use takt_scheduler::time::Nanos;

use super::diagnostic::{Diagnostic, Span, quote};
use super::events;
use super::interrupts::{self, Allowance, Others};
use super::partition::Checked;
use super::program_tasks;
use super::schedules::Draft;
use super::{Bar, Kind, MemorySource, Passthrough};

/// What a wake-up may take from the beginning of each window, if no guard absorbs it: as long as
/// the default guard, which is well above the wake-up latency that the latency lab found. A
/// partition with this guard or a longer one loses nothing in the analysis.
pub const WAKE_UP_ALLOWANCE: Nanos = Nanos::from_micros(20);

/// The tasks of a partition meet their deadlines under a schedule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Met {
    /// The schedule.
    pub schedule: ScheduleId,
    /// How it was shown.
    pub method: Method,
    /// The longest time from a job's release to its completion, for each task in the order of the
    /// file; an upper bound where the method is one.
    pub responses: Box<[Nanos]>,
    /// How much of what the windows give is asked for.
    pub load: Load,
    /// What each window is taken to lose to a wake-up that no guard absorbs, or to the kick of the
    /// partition before it.
    pub wake_up: Nanos,
    /// The interrupts that each window is taken to lose time to.
    pub interrupts: Allowance,
    /// What is known of the jobs of each task of programs; empty for tasks of the file.
    pub rules: Box<[Rule]>,
}

/// The interrupts that may come in each window of a partition. `passthrough` is what each partition has of the host's devices.
pub fn interrupts(
    partitions: &[Checked],
    schedules: &Schedules,
    passthrough: &[Passthrough],
    partition: PartitionId,
) -> Allowance {
    let others =
        partitions.iter().zip(passthrough).filter(|(it, _)| it.partition.id() != partition);
    let is_linux = |it: &Checked| matches!(it.partition.kind(), Kind::Linux { .. });
    let linuxes = others.clone().filter(|(it, _)| is_linux(it));
    let others = Others {
        linuxes: linuxes.map(|(it, _)| it.partition.id()).collect(),
        device_memory: others.map(|(_, devices)| behind_vfio(devices)).sum(),
    };
    let released = events::of_interrupts(&partitions[partition.0].programs);
    interrupts::allowance(schedules, partition, &others, &released)
}

/// How many pieces of memory are of functions that VFIO resets: all of a function, if one of its tables says so.
fn behind_vfio(devices: &Passthrough) -> u64 {
    let of_memory = devices.memory.iter().filter_map(|memory| match &memory.source {
        MemorySource::Pci(bar) => Some(bar),
        _ => None,
    });
    let all = of_memory.clone().chain(devices.ports.iter().filter_map(|ports| ports.bar.as_ref()));
    let is_confined = |bar: &&Bar| all.clone().any(|it| it.vfio && it.function == bar.function);
    of_memory.filter(is_confined).count() as u64
}

/// Analyses the tasks of one partition in each schedule in which it has a window.
pub fn check(
    draft: &Draft<'_>,
    schedules: &Schedules,
    partition: PartitionId,
    interrupts: Allowance,
) -> Result<Vec<Met>, Diagnostic> {
    let mut met = Vec::new();
    let owner = &draft.partitions[partition.0];
    let nothing = owner.tasks.tasks.is_empty();
    if nothing && owner.programs.is_empty() {
        return Ok(met);
    }
    let wake_up = match schedules.placements()[partition.0].role {
        // A guard that follows the host may be at its shortest when a wake-up is late.
        Role::Windowed { .. } if owner.partition.auto_guard => WAKE_UP_ALLOWANCE.less(AUTO_LEAST),
        Role::Windowed { guard } => WAKE_UP_ALLOWANCE.less(guard),
        Role::Background => WAKE_UP_ALLOWANCE,
    };
    // The thread wakes up meanwhile, but gets the CPU only when the one that is kicked sleeps.
    let wake_up = match schedules.kick_into(partition) {
        Nanos::ZERO => wake_up,
        kick => wake_up.max(kick.plus(ENTRY)),
    };
    for (i, table) in schedules.tables().iter().enumerate() {
        let schedule = ScheduleId(i);
        let rules = match owner.programs[..] {
            [] => None,
            _ => {
                let tasks = &owner.partition.program_tasks;
                let all = schedules.tables();
                Some(program_tasks::rules(tasks, &owner.programs, partition, all, table)?)
            }
        };
        if nothing {
            continue;
        }
        let case = Case { draft, partition, schedule, rules, wake_up, interrupts };
        match Supply::of(table, partition, wake_up, interrupts.time()) {
            Ok(supply) => met.push(case.judge(&supply)?),
            Err(SupplyError::NoWindows { .. }) => {}
            Err(SupplyError::NothingLeft { .. }) => return Err(case.nothing_left()),
        }
    }
    Ok(met)
}

/// One partition under one schedule.
struct Case<'a> {
    draft: &'a Draft<'a>,
    partition: PartitionId,
    schedule: ScheduleId,
    /// Of the tasks of programs.
    rules: Option<Vec<Rule>>,
    wake_up: Nanos,
    interrupts: Allowance,
}

impl Case<'_> {
    fn judge(&self, supply: &Supply) -> Result<Met, Diagnostic> {
        let owner = &self.draft.partitions[self.partition.0];
        let Analysis { method, verdict, load } = self.analyse(&owner.tasks.set, supply);
        let (task, found) = match verdict {
            Verdict::Meets { responses } => {
                let Case { schedule, wake_up, interrupts, .. } = *self;
                let rules = self.rules.as_deref().unwrap_or_default().into();
                return Ok(Met { schedule, method, responses, load, wake_up, interrupts, rules });
            }
            Verdict::Misses(Miss { task, release, deadline, undone }) => {
                let found = format!(
                    "{} misses its deadline: released at {release}, due at {deadline}, \
                     {undone} undone",
                    self.subject(task)
                );
                (task, found)
            }
            Verdict::Unproven { task, demand, supply } => {
                let period = owner.tasks.set.tasks()[task].period;
                let due = self.rules.as_ref().and_then(|rules| rules.get(task));
                let due = due.map_or(period, |rule| rule.deadline);
                let found = format!(
                    "{} is not proven to meet its deadlines: in {due} it and the more urgent \
                     tasks may ask for {demand}, and the windows may give only {supply}",
                    self.subject(task)
                );
                (task, found)
            }
        };
        let name = quote(&owner.partition.name);
        let largest = self.largest_budget(&owner.tasks.set, task, supply);
        let stated = |budget: Nanos| {
            let micros = budget.less(owner.tasks.overhead).0 / owner.tasks.multiples[task] / 1_000;
            (micros > 0).then(|| Nanos::from_micros(micros))
        };
        let allowed = match largest.and_then(stated) {
            Some(budget) => format!(
                "with all else as it is, a budget of at most {budget}; or more time in the windows \
                 of {name}"
            ),
            None => format!(
                "more time in the windows of {name}, or smaller budgets or longer periods of \
                 several of its tasks"
            ),
        };
        let Load { span, demand, supply } = load;
        let label = format!(
            "in {span} the windows of {name} give {supply}, and its tasks ask for {demand}"
        );
        let budget = owner.tasks.budgets[task].clone();
        Err(Diagnostic::new(budget, found, allowed).and(self.window(), label))
    }

    fn analyse(&self, set: &TaskSet, supply: &Supply) -> Analysis {
        match &self.rules {
            None => analyse(set, supply),
            Some(rules) => analyse_with(set, rules, supply),
        }
    }

    fn nothing_left(&self) -> Diagnostic {
        let owner = &self.draft.partitions[self.partition.0];
        let name = quote(&owner.partition.name);
        let interrupts = self.interrupts.time();
        let overhead = self.wake_up.plus(interrupts);
        let takers =
            if self.wake_up > Nanos::ZERO { "a wake-up and interrupts" } else { "interrupts" };
        let found = format!(
            "in the schedule {} no window of {name} is longer than the {overhead} that {takers} \
             may take of it: its tasks get nothing",
            quote(self.draft.schedules[self.schedule.0].name.get_ref())
        );
        let longest = self.draft.longest(self.schedule, self.partition);
        let guard_helps = self.wake_up > Nanos::ZERO
            && longest.is_some_and(|window| window.duration.get_ref().0 > interrupts);
        let allowed = if guard_helps {
            format!("longer windows, or a `release_guard` of {WAKE_UP_ALLOWANCE} for {name}")
        } else {
            "longer windows".to_owned()
        };
        Diagnostic::new(self.window(), found, allowed).and(owner.name.clone(), "it has tasks")
    }

    fn subject(&self, task: usize) -> String {
        let owner = &self.draft.partitions[self.partition.0];
        format!(
            "in the schedule {} the task {} of {}",
            quote(self.draft.schedules[self.schedule.0].name.get_ref()),
            quote(&owner.tasks.tasks[task].name),
            quote(&owner.partition.name)
        )
    }

    /// The partition's longest window.
    fn window(&self) -> Span {
        let window = self.draft.longest(self.schedule, self.partition);
        let header = &self.draft.schedules[self.schedule.0].header;
        window.map_or_else(|| header.clone(), |window| window.duration.span())
    }

    /// The largest budget of one task, in whole microseconds, with which all tasks of the set meet
    /// their deadlines. A smaller budget never makes a deadline be missed, so it can be searched for.
    fn largest_budget(&self, set: &TaskSet, task: usize, supply: &Supply) -> Option<Nanos> {
        let meets = |micros: u64| {
            let mut tasks: Vec<Task> = set.tasks().to_vec();
            tasks[task].budget = Nanos::from_micros(micros);
            let set = TaskSet::new(&tasks);
            set.is_ok_and(|set| matches!(self.analyse(&set, supply).verdict, Verdict::Meets { .. }))
        };
        // All up to `good` are good, zero standing for "none"; `bad` is bad, as the given one is.
        let (mut good, mut bad) = (0, set.tasks()[task].budget.0.div_ceil(1_000));
        while bad - good > 1 {
            let middle = good + (bad - good) / 2;
            if meets(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        (good > 0).then(|| Nanos::from_micros(good))
    }
}
