//! Inputs and outputs of programs: what comes from the file's places, what goes there, and when.

use std::fs;

use takt_program::Elementary::{Bool, Byte, Lword};
use takt_program::build::Task;
use takt_test_programs::{Entry, Program, cyclic, us};
use takt_tests::{File, Outcome, long, save_bytes, target};

use crate::devices::PRINTER;

/// The lines of a PLC with these programs, connections and further lines.
fn plc(test: &str, programs: &[(&str, Program)], more: &str) -> String {
    let tables = programs.iter().map(|(name, program)| {
        let image = save_bytes(&format!("{test}-{name}.plc"), &program.image());
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n")
    });
    format!("memory = \"16MiB\"\n{}{more}", tables.collect::<String>())
}

/// Such a PLC alone, with windows of 100 us each 250 us.
fn alone(test: &str, programs: &[(&str, Program)], more: &str) -> File {
    let file = File::new("250us").plc_with("plc", &plc(test, programs, more));
    file.schedule("normal").window("plc", 0, 100)
}

/// A column of the last figures of a task; the first is the number of its complete jobs.
fn figure(outcome: &Outcome, task: &str, column: usize) -> u64 {
    let rows = outcome.output.lines().filter_map(|line| line.trim().strip_prefix("[plc] "));
    let row = rows.rev().find(|row| row.split_whitespace().next() == Some(task));
    let row = row.unwrap_or_else(|| panic!("no figures of {task}\n{}", outcome.output));
    row.split_whitespace().nth(column).and_then(|figure| figure.parse().ok()).unwrap_or(0)
}

fn jobs(outcome: &Outcome, task: &str) -> u64 {
    figure(outcome, task, 1)
}

fn assert_good(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops itself"), "{}", outcome.output);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0, "{}", outcome.output);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn an_input_comes_from_a_linux_and_an_output_goes_there() {
    let program = Program::new("copy")
        .task(cyclic("main", us(1_000), 0, Entry::CopyInputs), 0)
        .input("order", Lword, 0)
        .input("fresh", Bool, 8)
        .output("seen", Lword, 0, 0)
        .output("valid", Bool, 8, 0);
    let connections = "[[partition.io]]\npoint = \"order\"\nchannel = \"order\"\nbyte = 2\n\
        [[partition.io]]\npoint = \"fresh\"\nchannel = \"order\"\nvalid = true\n\
        [[partition.io]]\npoint = \"seen\"\nchannel = \"seen\"\nbyte = 0\n\
        [[partition.io]]\npoint = \"valid\"\nchannel = \"seen\"\nbyte = 9\nbit = 4\n";
    let channel = |name: &str, bytes: u32, source: &str, destination: &str| {
        format!(
            "[[channel]]\nname = {name:?}\nkind = \"sampling\"\nmessage_bytes = {bytes}\n\
             refresh_period = \"500ms\"\nsource = {source:?}\ndestinations = [{destination:?}]\n"
        )
    };
    let exec = "shows() { until takt-port read seen --hex | grep -q $1; do sleep 0.1; done; echo shown $1; }; \
        shows 00000000000000000000; \
        takt-port write order --hex eeee; takt-port write order --hex eeee1122334455667788ffff; \
        shows 11223344556677880010; shows 11223344556677880000; echo all shown";
    let outcome = File::new("1ms")
        .plc_with("plc", &plc("io-linux", &[("copy", program)], connections))
        .linux(exec)
        .lines(&channel("orders", 12, "linux:order", "plc:order"))
        .lines(&channel("answers", 10, "plc:seen", "linux:seen"))
        .schedule("normal")
        .window("plc", 0, 300)
        .run("io-linux")
        .lasting("90s")
        .until("\nall shown")
        .run();
    assert_good(&outcome);
    outcome.assert_shows("all shown");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

/// A ramp that goes on by 250,000 from one release of the urgent task to the next.
const RAMP: &str = "[[partition.io]]\nprogram = \"p\"\npoint = \"now\"\n\
    simulate = { shape = \"ramp\", low = 1, high = 1000000000001, period = \"1000s\" }\n";

#[test]
fn a_job_sees_one_instant_although_more_urgent_ones_preempt_it() {
    let program = Program::new("p")
        .task(cyclic("urgent", us(250), 0, Entry::NewInput), 0)
        .task(cyclic("lesser", us(20_000), 5, Entry::SameInput), 200_000)
        .input("now", Lword, 0)
        .output("urgent", Lword, 0, 0)
        .output("lesser", Lword, 8, 1);
    let (duration, seconds) = if long() { ("30s", 30) } else { ("3s", 3) };
    let outcome =
        alone("io-instant", &[("p", program)], RAMP).run("io-instant").lasting(duration).run();
    assert_good(&outcome);
    assert!(jobs(&outcome, "p.urgent") > 2_333 * seconds);
    assert!(jobs(&outcome, "p.lesser") > 30 * seconds);
    // It took several windows.
    assert!(outcome.number("plc", "unfinished_windows") > 333 * seconds, "{}", outcome.output);
    outcome.assert_punctual("plc");
}

#[test]
fn two_programs_share_points_and_see_complete_jobs_only() {
    let source = Program::new("source")
        .task(cyclic("main", us(10_000), 9, Entry::TwoOutputs), 100_000)
        .output("one", Lword, 0, 0)
        .output("two", Lword, 8, 0);
    let sink = Program::new("sink")
        .task(cyclic("main", us(250), 0, Entry::TwoInputs), 100)
        .input("one", Lword, 0)
        .input("two", Lword, 8);
    let connect = |point: &str| {
        format!(
            "[[partition.io]]\nprogram = \"sink\"\npoint = {point:?}\noutput = {point:?}\n\
             output_of = \"source\"\n"
        )
    };
    let more = connect("one") + &connect("two");
    let programs = [("source", source), ("sink", sink)];
    let outcome = alone("io-shared", &programs, &more).run("io-shared").lasting("2s").run();
    assert_good(&outcome);
    outcome.assert_shows("sink.main: more");
    assert!(jobs(&outcome, "source.main") > 100, "{}", outcome.output);
}

#[test]
fn outputs_of_a_program_that_has_failed_are_zero_or_held() {
    let failing = Program::new("failing")
        .task(cyclic("main", us(1_000), 0, Entry::FaultingOutputs), 100)
        .output("held", Lword, 0, 0)
        .output("zeroed", Lword, 8, 0);
    let watch = || {
        let program =
            Program::new("watch").task(cyclic("main", us(1_000), 1, Entry::RiseAndFall), 0);
        program.input("value", Lword, 0)
    };
    let channel = |name: &str| {
        format!(
            "[[channel]]\nname = {name:?}\nkind = \"sampling\"\nmessage_bytes = 8\n\
             refresh_period = \"1s\"\nsource = \"plc:{name}\"\ndestinations = [\"other:{name}\"]\n"
        )
    };
    let table = |program: &str, point: &str, channel: &str, more: &str| {
        format!(
            "[[partition.io]]\nprogram = {program:?}\npoint = {point:?}\nchannel = {channel:?}\n\
             byte = 0\n{more}\n"
        )
    };
    let outputs = table("failing", "held", "held", "on_stop = \"hold\"")
        + &table("failing", "zeroed", "zeroed", "");
    let inputs = table("held", "value", "held", "") + &table("zeroed", "value", "zeroed", "");
    let watching = [("held", watch()), ("zeroed", watch())];
    let outcome = File::new("1ms")
        .plc_with("plc", &plc("io-stop", &[("failing", failing)], &outputs))
        .plc_with("other", &plc("io-watch", &watching, &inputs))
        .lines(&channel("held"))
        .lines(&channel("zeroed"))
        .schedule("normal")
        .window("plc", 0, 200)
        .window("other", 300, 200)
        .run("io-stop")
        .lasting("1500ms")
        .run();
    assert_good(&outcome);
    outcome.assert_shows("program failing, task main: invalid opcode");
    assert_eq!(outcome.output.matches("zeroed.main: fell").count(), 1, "{}", outcome.output);
    outcome.assert_shows("held.main: rose");
    assert!(!outcome.output.contains("held.main: fell"), "{}", outcome.output);
}

#[test]
fn outputs_reach_registers_and_safe_values_come_last() {
    let printed = target("tests").join("io-printer.printed");
    let _ = fs::remove_file(&printed);
    let program = Program::new("print")
        .task(cyclic("main", us(1_000), 0, Entry::Print), 0)
        .output("data", Byte, 0, 0)
        .output("control", Byte, 1, 0);
    let connections = "[[partition.io]]\npoint = \"data\"\nport = \"0x378\"\n\
        [[partition.io]]\npoint = \"control\"\nport = \"0x37a\"\n";
    let more = format!("{connections}{PRINTER}");
    let outcome = File::new("1ms")
        .plc_with("plc", &plc("io-printer", &[("print", program)], &more))
        .schedule("normal")
        .window("plc", 0, 300)
        .run("io-printer")
        .lasting("2s")
        .with("--device")
        .with(&format!("parallel={}", printed.display()))
        .run();
    assert_good(&outcome);
    let printed = fs::read(printed).expect("QEMU has written the file");
    let (last, values) = printed.split_last().expect("something was printed");
    assert_eq!(*last, 0xa5);
    let odd = values.iter().enumerate().find(|(at, byte)| **byte != *at as u8);
    assert_eq!(odd, None, "of {}", values.len());
    let releases = outcome.number("plc", "releases");
    assert!((releases / 2).abs_diff(values.len() as u64) <= 5, "{releases} and {}", values.len());
}

/// A program with so many outputs at I/O ports, each of which is an exit of some 4 us, and what connects them.
fn with_port_outputs(task: Task, parameter: u64, outputs: u32) -> (Program, String) {
    let name = |number: u32| format!("out{number}");
    let program = (0..outputs)
        .fold(Program::new("many").task(task, parameter), |program, number| {
            program.output(&name(number), Byte, number, 0)
        });
    let connections = (0..outputs).map(|number| {
        format!(
            "[[partition.io]]\nprogram = \"many\"\npoint = {:?}\nport = \"{:#x}\"\n",
            name(number),
            0x5000 + number
        )
    });
    let ports = "[[partition.port_io]]\nports = \"0x5000-0x50ff\"\n";
    (program, connections.collect::<String>() + ports)
}

/// Beside a task of another program that is released with each window.
fn beside_an_urgent_task(test: &str, many: Program, on_deadline: &str, more: &str) -> Outcome {
    let urgent = Program::new("urgent").task(cyclic("main", us(1_000), 0, Entry::Work), 1_000);
    let table = |name: &str, program: &Program| {
        let image = save_bytes(&format!("{test}-{name}.plc"), &program.image());
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n")
    };
    let programs = table("many", &many) + on_deadline + &table("urgent", &urgent);
    let file = File::new("1ms").plc_with("plc", &format!("memory = \"16MiB\"\n{programs}{more}"));
    let outcome = file.schedule("normal").window("plc", 0, 300).run(test).lasting("2s").run();
    assert_good(&outcome);
    // The longest time from a release to the first instruction, in ns.
    let start = figure(&outcome, "urgent.main", 8);
    assert!((1..10_000).contains(&start), "{start} ns\n{}", outcome.output);
    outcome
}

#[test]
fn outputs_that_do_not_fit_into_a_window_make_no_release_late() {
    // 60 exits are some 240 us. They begin 150 us before the window's end, after 150 us of work.
    let task = Task { deadline: Some(us(9_000)), ..cyclic("main", us(10_000), 5, Entry::Work) };
    let (many, more) = with_port_outputs(task, 65_000, 60);
    let outcome = beside_an_urgent_task("io-long-outputs", many, "on_deadline = \"log\"\n", &more);
    assert!(jobs(&outcome, "many.main") > 90, "{}", outcome.output);
    assert!(!outcome.output.contains("was not complete"), "{}", outcome.output);
    // All of them were written, in two windows each time.
    assert!(outcome.number("plc", "unfinished_windows") > 190, "{}", outcome.output);
}

#[test]
fn outputs_that_are_stopped_at_a_release_do_not_make_it_late() {
    // The deadline is between two windows, so it is found at the start of the next one.
    let task = cyclic("main", us(1_000_000), 5, Entry::Endless);
    let task = Task { deadline: Some(us(400_500)), ..task };
    let (many, more) = with_port_outputs(task, 0, 40);
    let outcome = beside_an_urgent_task("io-late-stop", many, "on_deadline = \"stop\"\n", &more);
    let told = "program many, task main: was not complete at its deadline: the program stops";
    outcome.assert_shows(told);
}
