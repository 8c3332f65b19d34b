//! The PLC's kernel: tasks of programs at ring 3.

use takt_program::build::{Event, Object, Task};
use takt_program::{Direction, Nanoseconds, ObjectKind};
use takt_test_programs::{Entry, Program, cyclic, freewheeling, on, us};
use takt_tests::{BUSY, File, Outcome, long, plc_image, save_bytes};

/// A program of a test, by its name, with further lines of its table.
type Named<'a> = (&'a str, Program, &'a str);

/// The lines of a PLC that runs programs.
fn lines(test: &str, programs: &[Named<'_>]) -> String {
    let tables = programs.iter().map(|(name, program, more)| {
        let image = save_bytes(&format!("{test}-{name}.plc"), &program.image());
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n{more}\n")
    });
    let tables: String = tables.collect();
    format!("image = {:?}\nmemory = \"32MiB\"\n{tables}", plc_image("kernel"))
}

/// Such a PLC, with a window of so many us in each frame.
fn plc(test: &str, frame_us: u64, window_us: u64, programs: &[Named<'_>]) -> File {
    let file = File::new(&format!("{frame_us}us")).plc_with("plc", &lines(test, programs));
    file.schedule("normal").window("plc", 0, window_us)
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
    outcome.assert_punctual("plc");
    let start = Row::of(outcome, task).number("start");
    let allowed = outcome.number("plc", "release_latency_ns.max").max(10);
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

#[test]
fn a_call_for_the_time_takes_120_instructions_at_most() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Times), 1_000);
    let file = plc("tasks-times", 1_000, 300, &[("p", program, "")]);
    let outcome = file.run("tasks-times").lasting("1500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // With three instructions of the program's for each call.
    let shortest = Row::of(&outcome, "p.main").number("exec-min");
    assert!(shortest <= 123 * 1_000, "{shortest}\n{}", outcome.output);
}

#[test]
fn six_tasks_of_two_programs_span_windows_and_cost_the_most_urgent_nothing() {
    let fast = Program::new("fast")
        .task(cyclic("control", us(250), 0, Entry::Destroy), 0)
        .task(cyclic("middle", us(1_000), 10, Entry::Work), 20_000)
        .task(freewheeling("rest", 200, Entry::Work), 1_000);
    // 1.2 ms and 2 ms of work, 100 us at a time.
    let slow = Program::new("slow")
        .init(Entry::Nothing)
        .task(cyclic("long", us(20_000), 20, Entry::Work), 600_000)
        .task(cyclic("longest", us(100_000), 30, Entry::Work), 1_000_000)
        .task(cyclic("patterns", us(50_000), 25, Entry::Patterns), 10_000);
    let programs = [("fast", fast, ""), ("slow", slow, "")];
    let (duration, jobs) = if long() { ("60s", 239_000) } else { ("4s", 11_000) };
    let file = plc("tasks-six", 250, 100, &programs).linux(BUSY);
    let outcome = file.run("tasks-six").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for (task, jobs) in [
        ("fast.control", jobs),
        ("fast.middle", jobs / 4),
        ("slow.long", jobs / 80),
        ("slow.patterns", jobs / 200),
        ("slow.longest", jobs / 400),
    ] {
        Row::of(&outcome, task).assert_in_time(jobs - 1);
    }
    assert!(Row::of(&outcome, "slow.longest").number("response") > 1_000_000, "it spans windows");
    assert_on_time(&outcome, "fast.control");
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
}

#[test]
fn registers_survive_preemption_at_any_instant() {
    let urgent = Program::new("urgent").task(cyclic("destroy", us(250), 0, Entry::Destroy), 0);
    let lesser = Program::new("lesser")
        .task(cyclic("one", us(100_000), 10, Entry::Patterns), 100_000)
        .task(cyclic("two", us(120_000), 5, Entry::Patterns), 30_000);
    let programs = [("urgent", urgent, ""), ("lesser", lesser, "")];
    let outcome =
        plc("tasks-patterns", 250, 100, &programs).run("tasks-patterns").lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // A changed register stops the program.
    Row::of(&outcome, "lesser.one").assert_in_time(10);
    let preempted = Row::of(&outcome, "lesser.one").number("switches");
    assert!(preempted > 1_000, "{preempted}");
    assert_on_time(&outcome, "urgent.destroy");
}

/// Each fault, and what is said of it. (The emulated processor has no alignment checks and no
/// exceptions of SSE.)
const FAULTS: &[(Entry, &str)] = &[
    (Entry::Null, "page fault, read of 0x0 "),
    (Entry::WriteCode, "page fault, write of 0x40000000"),
    (Entry::WriteConstants, "page fault, write of 0x40001000"),
    (Entry::WriteInput, "page fault, write of 0x68000000"),
    (Entry::WriteInformation, "page fault, write of 0x6ffff"),
    (Entry::WriteCallPage, "page fault, write of 0x3ffff000"),
    (Entry::JumpIntoData, "page fault, execution of 0x50000000"),
    (Entry::JumpFar, "general protection fault"),
    (Entry::Overflow, "page fault, write of 0x600fbff8"),
    // A stack fault, and in QEMU a general protection fault.
    (Entry::NoStack, " fault at 0x4000"),
    (Entry::Halt, "general protection fault"),
    (Entry::CloseInterrupts, "general protection fault"),
    (Entry::Port, "general protection fault"),
    (Entry::ControlRegister, "general protection fault"),
    (Entry::ModelRegister, "general protection fault"),
    (Entry::Gates, "general protection fault"),
    (Entry::Invalid, "invalid opcode"),
    (Entry::Divide, "division by zero at 0x"),
    (Entry::DivideInstruction, "divide error"),
    (Entry::Misaligned, "general protection fault"),
    (Entry::Step, "debug"),
    (Entry::StepIntoCall, "debug"),
    (Entry::Breakpoint, "general protection fault"),
    (Entry::FalseTick, "general protection fault"),
    (Entry::OldCall, "general protection fault"),
    (Entry::Base, "invalid opcode"),
    (Entry::Segment, "general protection fault"),
    (Entry::ExtendedState, "invalid opcode"),
    (Entry::SetExtendedState, ""),
    (Entry::Avx, "invalid opcode"),
    (Entry::X87, "x87 floating point"),
    (Entry::ReadKernel, "page fault, read of 0x100000"),
    (Entry::ReadRam, "page fault, read of 0xffff800000200000"),
    (Entry::WriteStatus, "page fault, write of 0xc0001000"),
];

/// Most programs of a partition, with room for the neighbour.
const AT_ONCE: usize = 15;

#[test]
fn a_fault_at_ring_3_stops_its_program_and_no_other() {
    for (part, faults) in FAULTS.chunks(AT_ONCE).enumerate() {
        let neighbour = cyclic("main", us(1_000), 0, Entry::Work);
        let mut programs = vec![("neighbour", Program::new("n").task(neighbour, 100), "")];
        let names: Vec<String> =
            (0..faults.len()).map(|number| format!("fault-{number}")).collect();
        for (name, (entry, _)) in names.iter().zip(faults) {
            // One fault in each window, so that each has its time.
            let task = cyclic("main", us(100_000), 1 + programs.len() as u8, *entry);
            programs.push((name, Program::new("f").task(task, 0), ""));
        }
        let test = format!("tasks-faults-{part}");
        let outcome = plc(&test, 1_000, 400, &programs).run(&test).lasting("2500ms").run();
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        for (name, (entry, text)) in names.iter().zip(faults) {
            let told = format!("program {name}, task main: ");
            let line = outcome.output.lines().find(|line| line.contains(&told));
            let line = line.unwrap_or_else(|| panic!("{entry:?} was not told\n{}", outcome.output));
            assert!(line.contains(text) && line.contains("the program stops"), "{entry:?}: {line}");
        }
        Row::of(&outcome, "neighbour.main").assert_in_time(900);
        assert_on_time(&outcome, "neighbour.main");
    }
}

#[test]
fn a_fault_is_told_with_file_line_and_column() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Divide), 0);
    let outcome = plc("tasks-place", 1_000, 300, &[("p", program, "")])
        .run("tasks-place")
        .lasting("1s")
        .run();
    outcome.assert_shows("program p, task main: division by zero at 0x4000");
    outcome.assert_shows("(tank.st:12:7): the program stops");
}

#[test]
fn hostile_calls_get_errors_and_flags_do_no_harm() {
    let bad = Program::new("bad")
        .task(cyclic("calls", us(1_000), 10, Entry::BadCalls), 0)
        .task(cyclic("flags", us(1_000), 11, Entry::Flags), 0);
    let good = Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Nothing), 0);
    let programs = [("bad", bad, ""), ("good", good, "")];
    let outcome =
        plc("tasks-calls", 1_000, 400, &programs).run("tasks-calls").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    Row::of(&outcome, "bad.calls").assert_in_time(900);
    Row::of(&outcome, "bad.flags").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
}

fn object(name: &str, kind: ObjectKind) -> Object {
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

/// A task with a budget.
fn limited(task: Task, budget_us: u64) -> Task {
    Task { budget: Some(Nanoseconds(budget_us * 1_000)), ..task }
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

#[test]
fn a_fault_of_a_job_that_has_used_up_its_budget_stops_its_program() {
    let task = cyclic("main", us(1_000), 0, Entry::Divide);
    let program = Program::new("p").task(Task { budget: Some(Nanoseconds(1)), ..task }, 0);
    let programs = [("p", program, "on_overrun = \"skip\"")];
    let outcome =
        plc("tasks-late-fault", 1_000, 300, &programs).run("tasks-late-fault").lasting("1s").run();
    outcome.assert_shows("program p, task main: division by zero at 0x4000");
    outcome.assert_shows("(tank.st:12:7): the program stops");
}

#[test]
fn a_program_that_always_fails_to_start_fills_neither_the_windows_nor_the_console() {
    let bad = Program::new("bad").init(Entry::Divide);
    let bad = bad.task(cyclic("main", us(1_000), 0, Entry::Nothing), 0);
    let good = Program::new("good")
        .task(cyclic("main", us(1_000), 1, Entry::Work), 1_000)
        .task(cyclic("log", us(1_000_000), 9, Entry::LogTwoLines), 0);
    let programs = [("bad", bad, "on_fault = \"restart\""), ("good", good, "")];
    let outcome =
        plc("tasks-again", 1_000, 300, &programs).run("tasks-again").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    Row::of(&outcome, "good.main").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
    let told = outcome.output.matches("program bad, task init: division by zero").count();
    // 32 at once, and one each 20 ms.
    assert!((100..=32 + 126).contains(&told), "{told}\n{}", outcome.output);
    outcome.assert_shows("faults were not told");
    // No line of a program's text looks like another's.
    outcome.assert_shows("good.log: hi you");
}

#[test]
fn a_program_can_stop_its_partition() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Null), 0);
    let programs = [("p", program, "on_fault = \"stop-partition\"")];
    let outcome = plc("tasks-stop", 1_000, 300, &programs).run("tasks-stop").lasting("1s").run();
    outcome.assert_shows("program p, task main: page fault, read of 0x0 at 0x4000");
    outcome.assert_shows("the partition ends itself, as its file says");
    assert_ne!(outcome.status, 0, "{}", outcome.output);
}
