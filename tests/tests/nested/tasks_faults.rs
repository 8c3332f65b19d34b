//! Programs that do what programs must not: each stops itself, and the others run on as before.

use takt_program::build::Task;
use takt_program::{Direction, Nanoseconds, ObjectKind};
use takt_test_programs::{Entry, Program, cyclic, freewheeling, us};
use takt_tests::{File, Host, long};

use super::tasks::{Row, assert_on_time, lines, object, plc};

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
    (Entry::Divide, "tank.st:12: division by zero (column 7) at 0x"),
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
    (Entry::ReadFar, "general protection fault"),
    (Entry::ReadBehind, "page fault, read of 0x50004000"),
    (Entry::ExecuteStack, "page fault, execution of 0x600f"),
    (Entry::ExecuteKernel, "page fault, execution of 0x100000"),
    (Entry::OpenInterrupts, "general protection fault"),
    (Entry::ReadPortByte, "general protection fault"),
    (Entry::WriteString, "general protection fault"),
    (Entry::DebugRegister, "general protection fault"),
    (Entry::TaskPriority, "general protection fault"),
    (Entry::PerformanceCounter, "general protection fault"),
    (Entry::Segments, "general protection fault"),
    (Entry::TaskRegister, "general protection fault"),
    (Entry::ForgetPage, "general protection fault"),
    (Entry::ForgetCaches, "general protection fault"),
    (Entry::ClearTaskSwitched, "general protection fault"),
    (Entry::SwapBase, "general protection fault"),
    (Entry::ReturnFromCall, "general protection fault"),
    // QEMU reads the stack for these with the kernel's rights, so that SMAP forbids it.
    (Entry::ReturnToRing0, " fault"),
    (Entry::FarReturn, " fault"),
    (Entry::KernelSegment, "general protection fault"),
    // A debug exception, and on SVM in QEMU an invalid opcode.
    (Entry::DebugInstruction, ""),
    (Entry::FalsePageFault, "general protection fault"),
    (Entry::SaveExtendedState, "invalid opcode"),
    (Entry::Monitor, "invalid opcode"),
    (Entry::CallHypervisor, ""),
];

/// Most programs of a partition, with room for the neighbour.
const AT_ONCE: usize = 15;

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_fault_at_ring_3_stops_its_program_and_no_other() {
    let parts = FAULTS.chunks(AT_ONCE).enumerate().map(|(part, faults)| {
        let neighbour = cyclic("main", us(1_000), 0, Entry::Work);
        let mut programs = vec![("neighbour", Program::new("n").task(neighbour, 100), "")];
        let names = names_of(faults);
        for (name, (entry, _)) in names.iter().zip(faults) {
            // One fault in each window, so that each has its time.
            let task = cyclic("main", us(100_000), 1 + programs.len() as u8, *entry);
            programs.push((name, Program::new("f").task(task, 0), ""));
        }
        let test = format!("tasks-faults-{part}");
        let file = File::new("1ms").plc_with("plc", &lines(&test, &programs));
        let file = file.plc("other", None, "").schedule("normal");
        let file = file.window("plc", 0, 400).window("other", 600, 100);
        (file.save(&test), "2500ms")
    });
    let parts: Vec<_> = parts.collect();
    let outcomes = Host::run_all("tasks-faults", &parts);
    for (faults, outcome) in FAULTS.chunks(AT_ONCE).zip(&outcomes) {
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        for (name, (entry, text)) in names_of(faults).iter().zip(faults) {
            // QEMU 10 lets ring 3 execute `wbinvd`, as if it were no instruction (its table of two-byte opcodes).
            if matches!(entry, Entry::ForgetCaches) && outcome.output.contains(" QEMU 10.") {
                continue;
            }
            let told = format!("program {name}, task main: ");
            let line = outcome.output.lines().find(|line| line.contains(&told));
            let line = line.unwrap_or_else(|| panic!("{entry:?} was not told\n{}", outcome.output));
            assert!(line.contains(text) && line.contains("the program stops"), "{entry:?}: {line}");
        }
        Row::of(outcome, "neighbour.main").assert_in_time(900);
        assert_on_time(outcome, "neighbour.main");
        outcome.assert_kept_its_time("other", outcome.cycles(1_000) - 10);
        outcome.assert_punctual("other");
    }
}

/// Names of programs that have these faults.
fn names_of(faults: &[(Entry, &str)]) -> Vec<String> {
    (0..faults.len()).map(|number| format!("fault-{number}")).collect()
}

#[test]
fn a_fault_is_told_with_file_line_and_column() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Divide), 0);
    let outcome = plc("tasks-place", 1_000, 300, &[("p", program, "")])
        .run("tasks-place")
        .lasting("1s")
        .run();
    outcome.assert_shows("program p, task main: tank.st:12: division by zero (column 7) at 0x4000");
    outcome.assert_shows(": the program stops");
}

#[test]
fn hostile_calls_get_errors_and_flags_do_no_harm() {
    let bad = Program::new("bad")
        .task(cyclic("calls", us(1_000), 10, Entry::BadCalls), 0)
        .task(cyclic("flags", us(1_000), 11, Entry::Flags), 0)
        .task(cyclic("hypervisor", us(1_000), 12, Entry::CallHypervisorOfAmd), 0);
    let good = Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Nothing), 0);
    let programs = [("bad", bad, ""), ("good", good, "")];
    let outcome =
        plc("tasks-calls", 1_000, 400, &programs).run("tasks-calls").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    Row::of(&outcome, "bad.calls").assert_in_time(900);
    Row::of(&outcome, "bad.flags").assert_in_time(900);
    Row::of(&outcome, "bad.hypervisor").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
}

#[test]
fn a_fault_of_a_job_that_has_used_up_its_budget_stops_its_program() {
    let task = cyclic("main", us(1_000), 0, Entry::Divide);
    let program = Program::new("p").task(Task { budget: Some(Nanoseconds(1)), ..task }, 0);
    let programs = [("p", program, "on_overrun = \"skip\"")];
    let outcome =
        plc("tasks-late-fault", 1_000, 300, &programs).run("tasks-late-fault").lasting("1s").run();
    outcome.assert_shows("program p, task main: tank.st:12: division by zero (column 7) at 0x4000");
    outcome.assert_shows(": the program stops");
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
    let told =
        outcome.output.matches("program bad, task init: tank.st:12: division by zero").count();
    // 32 at once, and one each 20 ms.
    assert!((100..=32 + 126).contains(&told), "{told}\n{}", outcome.output);
    outcome.assert_shows("faults were not told");
    // No line of a program's text looks like another's.
    outcome.assert_shows("good.log: hi   you");
}

#[test]
fn a_program_whose_start_never_ends_keeps_no_other_from_starting_anew() {
    // A semaphore does not raise it: the tasks that may want that one are not released before it has ended.
    let semaphore = ObjectKind::Semaphore { ceiling: 0 };
    others_start_anew("tasks-endless-start", semaphore, Entry::EndlessHolder);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_program_whose_start_waits_again_and_again_keeps_no_other_from_starting_anew() {
    others_start_anew("tasks-waiting-start", ObjectKind::Flags, Entry::EndlessWaiter);
}

#[test]
fn a_freewheeling_job_that_never_ends_keeps_no_other_from_starting_anew() {
    let endless = Program::new("endless").task(freewheeling("main", 0, Entry::Endless), 0);
    others_start_beside("tasks-endless-freewheeling", endless);
}

/// Fails unless programs start anew beside one whose start, which has an object, does not end.
fn others_start_anew(name: &str, kind: ObjectKind, start: Entry) {
    let endless = Program::new("endless").object(object("object", kind)).init(start);
    others_start_beside(name, endless.task(cyclic("main", us(1_000), 0, Entry::Nothing), 0));
}

/// Fails unless programs start anew beside this one. They have an initialisation, as all programs in Structured Text do.
fn others_start_beside(name: &str, endless: Program) {
    let failing = Program::new("failing")
        .init(Entry::Nothing)
        .task(cyclic("main", us(100_000), 5, Entry::Divide), 0);
    let good = Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Work), 1_000);
    let programs = [
        ("endless", endless, ""),
        ("failing", failing, "on_fault = \"restart\""),
        ("good", good, ""),
    ];
    let outcome = plc(name, 1_000, 300, &programs).run(name).lasting("1500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops itself"), "{}", outcome.output);
    let started = outcome.output.matches("task main: tank.st:12: division by zero").count();
    assert!(started > 10, "{started}\n{}", outcome.output);
    Row::of(&outcome, "good.main").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
}

#[test]
fn a_task_over_its_budget_in_each_job_tells_how_many_lines_are_left_out() {
    let task = cyclic("main", us(1_000), 0, Entry::Work);
    let program = Program::new("p").task(Task { budget: Some(Nanoseconds(1_000)), ..task }, 5_000);
    let programs = [("p", program, "on_overrun = \"skip\"")];
    let file = plc("tasks-over-budget", 1_000, 300, &programs);
    let outcome = file.run("tasks-over-budget").lasting("500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("program p, task main: ");
    // One line each 20 ms, and a job each millisecond.
    outcome.assert_shows("program p: 19 missed limits were not told");
}

#[test]
fn deadlines_that_end_at_a_release_cost_the_most_urgent_task_nothing() {
    // The first one takes 50 ms, and the others wait for it. Their deadlines are found at a window's start, and each has a line.
    let names = ["a", "b", "c", "d", "e", "f", "g", "h"];
    let late = |n: u8| {
        let task = cyclic(names[usize::from(n)], us(600_000), 10 + n, Entry::Work);
        Task { deadline: Some(Nanoseconds(40_000_000)), ..task }
    };
    let work = |n| if n == 0 { 7_500_000 } else { 100 };
    let lesser = (0..8).fold(Program::new("lesser"), |program, n| program.task(late(n), work(n)));
    let good = Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Work), 1_000);
    let programs = [("lesser", lesser, "on_deadline = \"log\""), ("good", good, "")];
    let outcome = plc("tasks-late", 1_000, 300, &programs).run("tasks-late").lasting("2s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for name in names {
        let line = "was not complete at its deadline: it goes on";
        outcome.assert_shows(&format!("program lesser, task {name}: {line}"));
    }
    Row::of(&outcome, "good.main").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
}

#[test]
fn a_deadline_is_told_although_the_late_job_has_all_of_each_window() {
    let endless = Program::new("p").task(cyclic("main", us(10_000), 0, Entry::Endless), 0);
    let programs = [("p", endless, "on_deadline = \"log\"")];
    let outcome =
        plc("tasks-never-idle", 1_000, 300, &programs).run("tasks-never-idle").lasting("1s").run();
    let line = "was not complete at its deadline: it goes on";
    outcome.assert_shows(&format!("program p, task main: {line}"));
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

#[test]
fn an_endless_job_without_a_budget_is_stopped_at_its_deadline_and_costs_its_betters_nothing() {
    let endless = Program::new("e").task(cyclic("main", us(100_000), 5, Entry::Endless), 0);
    let good = Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Work), 1_000);
    let programs = [("endless", endless, "on_deadline = \"stop\""), ("good", good, "")];
    let file = plc("tasks-endless", 1_000, 300, &programs);
    let outcome = file.run("tasks-endless").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows(
        "program endless, task main: was not complete at its deadline: the program stops",
    );
    Row::of(&outcome, "good.main").assert_in_time(900);
    assert_on_time(&outcome, "good.main");
}

/// Two partitions with the same random programs, each of which reads what the other one writes.
#[test]
fn random_calls_from_ring_3_break_nothing() {
    const CALLS: u64 = 100;
    let random = || {
        let own = |name: &str, kind| object(name, kind);
        (0..4).fold(
            Program::new("random")
                .port("in", Direction::In)
                .port("out", Direction::Out)
                .object(own("a", ObjectKind::Queue { message_bytes: 8, depth: 2 }))
                .object(own("b", ObjectKind::Semaphore { ceiling: 6 }))
                .object(own("c", ObjectKind::Mailbox { bytes: 16 }))
                .object(own("d", ObjectKind::Flags)),
            |program, number: u8| {
                let task = cyclic(&format!("t{number}"), us(4_000), 5 + number, Entry::RandomCalls);
                program.task(task, CALLS)
            },
        )
    };
    let good = || Program::new("good").task(cyclic("main", us(1_000), 0, Entry::Work), 1_000);
    // A wait that nothing ends is cut off with its job.
    let more = "on_deadline = \"skip\"";
    let lines = |name: &str| {
        lines(&format!("tasks-random-{name}"), &[("random", random(), more), ("good", good(), "")])
    };
    let channel = |from: &str, to: &str| {
        format!(
            "[[channel]]\nname = \"of-{from}\"\nkind = \"queuing\"\nmessage_bytes = 8\ndepth = 4\n\
             source = \"{from}:out\"\ndestinations = [\"{to}:in\"]"
        )
    };
    let file = File::new("1ms")
        .plc_with("plc", &lines("plc"))
        .plc_with("other", &lines("other"))
        .lines(&channel("plc", "other"))
        .lines(&channel("other", "plc"))
        .schedule("normal")
        .window("plc", 0, 300)
        .window("other", 500, 300);
    let (duration, jobs, calls) =
        if long() { ("60s", 59_000, 1_000_000) } else { ("4s", 2_900, 100_000) };
    let outcome = file.run("tasks-random").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("the program"), "a program was stopped\n{}", outcome.output);
    let made =
        (0..4).map(|task| Row::of(&outcome, &format!("random.t{task}")).number("jobs") * CALLS);
    assert!(made.sum::<u64>() > calls, "{}", outcome.output);
    Row::of(&outcome, "good.main").assert_in_time(jobs);
    for partition in ["plc", "other"] {
        outcome.assert_punctual(partition);
        assert_eq!(outcome.number(partition, "lost"), 0, "{}", outcome.output);
    }
}

/// QEMU's processor has neither alignment checks nor exceptions of SSE, and returns to other rings in its own way; that of
/// Bochs does as it should.
#[test]
fn what_the_processor_of_qemu_does_not_check_stops_its_program_in_bochs() {
    let faults = [
        ("alignment", Entry::AlignmentCheck, "alignment check"),
        ("sse", Entry::SseDivide, "SIMD floating point"),
        ("reserved", Entry::ReservedState, "general protection fault"),
        ("interrupt", Entry::ReturnToRing0, "general protection fault"),
        ("far", Entry::FarReturn, "general protection fault"),
    ];
    let neighbour = Program::new("n").task(cyclic("main", us(1_000), 0, Entry::Work), 100);
    let mut programs = vec![("neighbour", neighbour, "")];
    for (name, entry, _) in faults {
        let task = cyclic("main", us(100_000), programs.len() as u8, entry);
        programs.push((name, Program::new("f").task(task, 0), ""));
    }
    let file = plc("tasks-vmx", 1_000, 400, &programs);
    let outcome = file.run("tasks-vmx").in_lane("vmx").lasting("1200ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for (name, _, text) in faults {
        outcome.assert_shows(&format!("program {name}, task main: {text}"));
    }
    Row::of(&outcome, "neighbour.main").assert_in_time(900);
    assert_on_time(&outcome, "neighbour.main");
}
