//! The PLC's kernel: tasks of programs at ring 3.

use takt_program::build::{Event, Object, Task};
use takt_program::{Direction, Nanoseconds, ObjectKind};
use takt_test_programs::{Entry, Program, cyclic, on, us};
use takt_tests::{File, Outcome, plc_image, save_bytes};

/// A program of a test, by its name, with further lines of its table.
pub type Named<'a> = (&'a str, Program, &'a str);

/// The lines of a PLC that runs programs.
pub fn lines(test: &str, programs: &[Named<'_>]) -> String {
    let tables = programs.iter().map(|(name, program, more)| {
        let image = save_bytes(&format!("{test}-{name}.plc"), &program.image());
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n{more}\n")
    });
    let tables: String = tables.collect();
    format!("image = {:?}\nmemory = \"32MiB\"\n{tables}", plc_image("kernel"))
}

/// Such a PLC, with a window of so many us in each frame.
pub fn plc(test: &str, frame_us: u64, window_us: u64, programs: &[Named<'_>]) -> File {
    let file = File::new(&format!("{frame_us}us")).plc_with("plc", &lines(test, programs));
    file.schedule("normal").window("plc", 0, window_us)
}

/// A task with a budget.
pub fn limited(task: Task, budget_us: u64) -> Task {
    Task { budget: Some(Nanoseconds(budget_us * 1_000)), ..task }
}

/// A row of the last table of figures, by the names of its columns.
pub struct Row<'a>(Vec<&'a str>);

impl<'a> Row<'a> {
    pub fn of(outcome: &'a Outcome, task: &str) -> Self {
        let mut rows = outcome
            .output
            .lines()
            .filter_map(|line| line.trim().split_once("] ").map(|(_, row)| row));
        let found = rows.rfind(|row| row.split_whitespace().next() == Some(task));
        let row = found.unwrap_or_else(|| panic!("no figures of {task}\n{}", outcome.output));
        Self(row.split_whitespace().collect())
    }

    pub fn number(&self, column: &str) -> u64 {
        const COLUMNS: [&str; 12] = [
            "task", "jobs", "missed", "overrun", "skipped", "exec-min", "exec-max", "response",
            "start", "slack", "stack", "switches",
        ];
        let place = COLUMNS.iter().position(|name| *name == column);
        self.0[place.expect("there is such a column")].parse().expect("it is a number")
    }

    /// Fails unless so many jobs were complete, and all in time.
    pub fn assert_in_time(&self, jobs: u64) {
        assert!(self.number("jobs") >= jobs, "{:?}", self.0);
        for column in ["missed", "overrun", "skipped"] {
            assert_eq!(self.number(column), 0, "{column}: {:?}", self.0);
        }
    }
}

/// Fails unless each job of a task began within 10 ns of its release, but for what an interrupt of the
/// host explains.
pub fn assert_on_time(outcome: &Outcome, task: &str) {
    assert_on_time_in(outcome, "plc", task);
}

/// The same of a task of another partition than `plc`.
pub fn assert_on_time_in(outcome: &Outcome, partition: &str, task: &str) {
    outcome.assert_punctual(partition);
    let start = Row::of(outcome, task).number("start");
    let allowed = outcome.number(partition, "release_latency_ns.max").max(10);
    assert!(start <= allowed, "{task} began {start} ns late\n{}", outcome.output);
}

#[test]
fn a_task_runs_at_ring_3_at_each_release() {
    let program = Program::new("one").task(cyclic("main", us(1000), 0, Entry::Work), 1000);
    let file = plc("tasks-one", 1000, 300, &[("one", program, "")]);
    let outcome = file.run("tasks-one").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    Row::of(&outcome, "one.main").assert_in_time(900);
    assert_on_time(&outcome, "one.main");
    // 2000 instructions and some.
    let longest = Row::of(&outcome, "one.main").number("exec-max");
    assert!((2_000..20_000).contains(&longest), "{longest}\n{}", outcome.output);
}

pub fn object(name: &str, kind: ObjectKind) -> Object {
    Object { name: name.into(), kind }
}

#[test]
fn tasks_exchange_messages_and_exclude_each_other() {
    let program = Program::new("p")
        .object(object("queue", ObjectKind::Queue { message_bytes: 8, depth: 4 }))
        .object(object("semaphore", ObjectKind::Semaphore { ceiling: 1 }))
        // Waits for a message for most of its period.
        .task(cyclic("receive", us(1_000), 0, Entry::Receive), 900_000)
        .task(cyclic("guarded", us(500), 1, Entry::Guarded), 100)
        .task(cyclic("send", us(1_000), 2, Entry::Send), 0)
        // Its critical section spans windows.
        .task(cyclic("section", us(50_000), 3, Entry::Guarded), 300_000);
    let file = plc("tasks-objects", 250, 100, &[("p", program, "on_deadline = \"log\"")]);
    let outcome = file.run("tasks-objects").lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops itself"), "{}", outcome.output);
    assert!(Row::of(&outcome, "p.receive").number("jobs") > 1_000, "{}", outcome.output);
    assert!(Row::of(&outcome, "p.section").number("jobs") > 30, "{}", outcome.output);
}

#[test]
fn event_tasks_see_edges_and_messages() {
    let bit = Event::Rise("Main.bit".into());
    let sender = Program::new("s")
        .port("numbers", Direction::Out)
        .bit("Main.bit")
        .task(cyclic("write", us(4_000), 0, Entry::WritePort), 0)
        .task(cyclic("toggle", us(2_000), 1, Entry::Toggle), 0)
        .task(on("edge", bit, us(1_000), 2, Entry::Nothing), 0);
    let message = Event::Channel("numbers".into());
    let receiver = Program::new("r")
        .port("numbers", Direction::In)
        // The kernel looks for events at each end of their jobs, with the same message still in the queue.
        .task(cyclic("first", us(1_000), 0, Entry::Nothing), 0)
        .task(cyclic("second", us(1_000), 0, Entry::Nothing), 0)
        .task(on("read", message, us(1_000), 0, Entry::ReadPort), 0);
    // Two tasks wait at one sampling port.
    let writer = Program::new("w")
        .port("level", Direction::Out)
        .task(cyclic("write", us(4_000), 3, Entry::WritePort), 0);
    let level = || Event::Channel("level".into());
    let watcher = Program::new("o")
        .port("level", Direction::In)
        .task(on("first", level(), us(1_000), 3, Entry::Nothing), 0)
        .task(on("second", level(), us(1_000), 4, Entry::Nothing), 0);
    let file = File::new("1ms")
        .plc_with("plc", &lines("tasks-events", &[("sender", sender, ""), ("writer", writer, "")]))
        .plc_with(
            "other",
            &lines("tasks-events", &[("receiver", receiver, ""), ("watcher", watcher, "")]),
        )
        .lines(
            "[[channel]]\nname = \"numbers\"\nkind = \"queuing\"\nmessage_bytes = 8\n\
             source = \"plc:numbers\"\ndestinations = [\"other:numbers\"]\ndepth = 8",
        )
        .lines(
            "[[channel]]\nname = \"level\"\nkind = \"sampling\"\nmessage_bytes = 8\n\
             source = \"plc:level\"\ndestinations = [\"other:level\"]\nrefresh_period = \"1s\"",
        )
        .schedule("normal")
        .window("plc", 100, 200)
        .window("other", 500, 200);
    let outcome = file.run("tasks-events").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    Row::of(&outcome, "sender.edge").assert_in_time(220);
    Row::of(&outcome, "receiver.read").assert_in_time(220);
    for task in ["watcher.first", "watcher.second"] {
        Row::of(&outcome, task).assert_in_time(220);
    }
}

#[test]
fn an_endless_job_is_ended_at_its_budget_and_lesser_tasks_go_on() {
    let endless = limited(cyclic("endless", us(10_000), 0, Entry::Endless), 200);
    let runaway = Program::new("r").task(endless, 0);
    let good = Program::new("g").task(cyclic("main", us(10_000), 5, Entry::Work), 1_000);
    let stopped = limited(cyclic("endless", us(20_000), 1, Entry::Endless), 200);
    let stopped = Program::new("s").task(stopped, 0);
    let anew = Program::new("a").task(cyclic("later", us(20_000), 2, Entry::FaultLater), 3);
    let programs = [
        ("runaway", runaway, "on_overrun = \"skip\""),
        ("stopped", stopped, "on_overrun = \"stop\""),
        ("good", good, ""),
        ("anew", anew, "on_fault = \"restart\""),
    ];
    let outcome =
        plc("tasks-budget", 1_000, 300, &programs).run("tasks-budget").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let skipped = Row::of(&outcome, "runaway.endless");
    assert!(skipped.number("skipped") > 90 && skipped.number("jobs") == 0, "{}", outcome.output);
    outcome
        .assert_shows("program stopped, task endless: has used up its budget: the program stops");
    Row::of(&outcome, "good.main").assert_in_time(90);
    // Every third job faults, and the program begins anew.
    assert!(Row::of(&outcome, "anew.later").number("jobs") > 20, "{}", outcome.output);
    outcome.assert_shows("program anew, task later: invalid opcode");
}
