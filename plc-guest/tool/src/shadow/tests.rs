//! A new version beside a running one, for which another one stands in.

use std::time::Duration;

use takt_st::source::Sources;
use takt_st::{build, project, stack};

use super::*;
use takt_points::Search;

const MS: u64 = 1_000_000;
const TIMES: Times = Times { window_ns: MS / 4, frame_ns: 2 * MS };
const LIMIT: Duration = Duration::from_secs(5);

/// A controller each ms and a timer each 4 ms, which both have inputs.
const RUNNING: &str = "
PROGRAM Control
    VAR
        controller : PID;
        measured AT %ID0 : REAL;
        valve AT %QD0 : REAL;
    END_VAR
    controller(SETPOINT := 1.0, MEASURED := measured, PROPORTIONAL := 0.5, INTEGRAL := 2.0, LOW := 0.0, HIGH := 9.0);
    valve := LREAL_TO_REAL(controller.OUTPUT);
END_PROGRAM
PROGRAM Lamp
    VAR
        on AT %IX4.0 : BOOL;
        lamp AT %QX4.0 : BOOL;
        count AT %QW6 : INT;
        delay : TON;
    END_VAR
    delay(IN := on, PT := T#20ms);
    lamp := delay.Q;
    count := count + 1;
END_PROGRAM
CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 1);
    TASK seldom (INTERVAL := T#4ms, PRIORITY := 2);
    PROGRAM control WITH often : Control;
    PROGRAM lamp WITH seldom : Lamp;
END_CONFIGURATION
";

fn compiled(text: &str) -> Vec<u8> {
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    let checked = project::check("p", &mut sources).unwrap();
    let program = checked.program.unwrap_or_else(|| panic!("{:?}", checked.diagnostics));
    stack::with_room(|| build::build(&program).unwrap().image).unwrap()
}

/// A PLC that runs a version: a line each ms.
struct Plc<'a> {
    twin: Twin<'a>,
    cycle: u64,
}

impl<'a> Plc<'a> {
    fn new(image: Image<'a>) -> Self {
        let mut plc = Self { twin: Twin::new(image, LIMIT).unwrap(), cycle: 0 };
        plc.twin.begin(0);
        // The first window has the releases of its first quarter of a millisecond.
        plc.twin.run(&[0; 5], TIMES.window_ns).unwrap();
        plc
    }

    fn line(&mut self) -> Line {
        self.cycle += 1;
        let measured = (self.cycle as f32 / 100.0).sin();
        let mut inputs = measured.to_le_bytes().to_vec();
        inputs.push(u8::from(self.cycle % 64 < 40));
        self.twin.run(&inputs, MS).unwrap();
        let (cycle, time_ns) = (self.cycle, self.cycle * MS);
        Line { cycle, time_ns, unsettled: false, watched: self.twin.watched() }
    }
}

fn comparison(image: &Image<'_>, tolerances: &[&str]) -> Comparison {
    let tolerances: Vec<Tolerance> = tolerances.iter().map(|text| text.parse().unwrap()).collect();
    Comparison::new(Search::run("p", 0, image, "p.*").unwrap(), &tolerances).unwrap()
}

/// Runs both versions for so many cycles, of which `change` may spoil the lines.
fn shadow(
    new: &str,
    cycles: u64,
    tolerances: &[&str],
    change: impl Fn(&mut Line) -> bool,
) -> (Result<Extent, Failed>, Comparison) {
    shadow_of(RUNNING, new, cycles, tolerances, change)
}

fn shadow_of(
    running: &str,
    new: &str,
    cycles: u64,
    tolerances: &[&str],
    change: impl Fn(&mut Line) -> bool,
) -> (Result<Extent, Failed>, Comparison) {
    let (running, new) = (compiled(running), compiled(new));
    let images = [&running, &new].map(|bytes| Image::verify(bytes).unwrap());
    let [running, new] = images;
    let between = Change::between(&running, &new);
    assert!(between.refusals.is_empty(), "{:?}", between.refusals);
    let mut versions = Versions::new([running, new], &between, TIMES, LIMIT).unwrap();
    let mut comparison = comparison(&running, tolerances);
    let mut plc = Plc::new(running);
    for _ in 0..cycles {
        let mut line = plc.line();
        if !change(&mut line) {
            continue;
        }
        match versions.take(line) {
            Ok(outputs) => outputs.iter().for_each(|both| comparison.take(both)),
            Err(failed) => return (Err(failed), comparison),
        }
    }
    (Ok(versions.extent), comparison)
}

fn output<'c>(comparison: &'c Comparison, name: &str) -> &'c Output {
    let found = comparison.outputs.iter().find(|output| output.point.name == name);
    found.unwrap_or_else(|| panic!("no {name}: {comparison:?}"))
}

#[test]
fn the_same_code_differs_in_nothing_from_whatever_state_it_begins() {
    let (extent, comparison) = shadow(RUNNING, 300, &[], |_| true);
    let whole = Extent { cycles: 299, begun: 1, longest: 299, stretch: 299, ..Extent::default() };
    assert_eq!(extent.unwrap(), whole);
    assert!(comparison.is_within());
    assert!(comparison.outputs.iter().all(|output| output.largest.is_none()), "{comparison:?}");
    assert_eq!(comparison.outputs.len(), 3);
}

#[test]
fn another_integrator_is_told_by_output_cycle_and_difference() {
    // With a variable in front of all, so that the state has to be carried over.
    let new = RUNNING
        .replace("VAR\n        controller", "VAR\n        fresh : LINT := 3;\n        controller")
        .replace("INTEGRAL := 2.0", "INTEGRAL := 4.0")
        .replace("valve :=", "fresh := fresh + 1;\n    valve :=");
    let (extent, comparison) = shadow(&new, 500, &["0.01", "p.lamp.*=0"], |_| true);
    let extent = extent.unwrap();
    assert_eq!((extent.cycles, extent.strayed), (499, 0), "{extent:?}");
    let valve = output(&comparison, "p.Control.valve");
    let (largest, at) = valve.largest.unwrap();
    // Twice the integral of 1 - sin(t / 100 ms) over half a second, which is 0.43, less the old one's.
    assert!(largest > 0.5 && largest < 1.5, "{valve:?}");
    let first = valve.first_out.unwrap();
    assert!(first > 2 && first < 20 && at > first, "{valve:?}");
    assert_eq!(valve.cycles_out, 501 - first, "once out it stays out: {valve:?}");
    for name in ["p.Lamp.lamp", "p.Lamp.count"] {
        assert_eq!(output(&comparison, name).largest, None);
    }
    assert!(!comparison.is_within());
    let (_, wide) = shadow(&new, 500, &["p.control.VALVE=2"], |_| true);
    assert!(wide.is_within() && output(&wide, "p.Control.valve").largest == Some((largest, at)));
}

#[test]
fn an_output_that_stands_still_at_a_limit_is_told() {
    let new = RUNNING.replace("HIGH := 9.0", "HIGH := 0.7");
    let (_, comparison) = shadow(&new, 500, &[], |_| true);
    let valve = output(&comparison, "p.Control.valve");
    // It gets to its limit in cycle 311.
    assert!((150..200).contains(&valve.still), "{valve:?}");
    // A number that moves as the running version's does, and an output that is no number.
    assert_eq!(["p.Lamp.count", "p.Lamp.lamp"].map(|name| output(&comparison, name).still), [0, 0]);
    // A gap ends a stretch.
    let (_, parts) = shadow(&new, 500, &[], |line| line.cycle % 100 != 0);
    assert!((50..100).contains(&output(&parts, "p.Control.valve").still), "{parts:?}");
}

#[test]
fn a_change_that_takes_a_second_state_is_tried_too() {
    let program = |fields: &str| {
        RUNNING
            .replace(
                "PROGRAM Control",
                &format!("TYPE Pair : STRUCT {fields} END_STRUCT; END_TYPE\nPROGRAM Control"),
            )
            .replace(
                "VAR\n        controller",
                "VAR\n        pairs : ARRAY[1..300] OF Pair;\n        controller",
            )
            .replace("valve :=", "pairs[7].n := pairs[7].n + 1;\n    valve :=")
    };
    let (old, new) = (program("n : DINT; x : LREAL;"), program("y : LINT; x : LREAL; n : DINT;"));
    assert!(old != RUNNING && old.contains("pairs[7].n := ") && old.contains("pairs : ARRAY"));
    let (extent, comparison) = shadow_of(&old, &new, 300, &[], |_| true);
    assert_eq!(extent.unwrap().cycles, 299);
    assert!(comparison.is_within());
}

#[test]
fn behind_a_gap_the_new_version_begins_with_the_state_of_the_running_one() {
    let new = RUNNING.replace("INTEGRAL := 2.0", "INTEGRAL := 4.0");
    let spoil = |line: &mut Line| {
        line.unsettled = (60..62).contains(&line.cycle);
        !(200..=249).contains(&line.cycle)
    };
    let (extent, comparison) = shadow(&new, 300, &["1e9"], spoil);
    let extent = extent.unwrap();
    assert_eq!((extent.missing, extent.begun, extent.longest), (52, 3, 137), "{extent:?}");
    assert_eq!((extent.cycles, extent.strayed), (58 + 137 + 50, 0), "{extent:?}");
    let (_, whole) = shadow(&new, 300, &["1e9"], |_| true);
    let largest = |of: &Comparison| output(of, "p.Control.valve").largest.unwrap().0;
    assert!(largest(&comparison) < largest(&whole));
}

#[test]
fn what_the_running_version_did_not_do_by_itself_is_told() {
    // An operator wrote the counter between two cycles.
    let write = |line: &mut Line| {
        if line.cycle == 100 {
            line.watched.outputs[6] ^= 0x40;
        }
        true
    };
    let (extent, _) = shadow(RUNNING, 200, &[], write);
    let extent = extent.unwrap();
    assert_eq!((extent.first_strayed, extent.strayed), (Some(100), 2), "{extent:?}");
}

#[test]
fn a_new_version_that_fails_is_told_with_its_place_and_lines_that_lie_are_gaps() {
    let new = RUNNING.replace("count := count + 1;", "count := count + 1 + 0 * (1 / (count - 9));");
    let (failed, _) = shadow(&new, 200, &[], |_| true);
    let Err(Failed::Program(fault)) = failed else { panic!("it goes on") };
    assert!(fault.to_string().contains("main.st:20: division by zero"), "{fault}");
    for lie in [0, u64::MAX, 1 << 40] {
        let lying = |line: &mut Line| {
            if line.cycle == 50 {
                line.time_ns = lie;
            }
            true
        };
        let (extent, _) = shadow(RUNNING, 100, &[], lying);
        assert_eq!(extent.unwrap().cycles, 97);
    }
}

#[test]
fn tolerances_have_a_number_and_mean_an_output() {
    for wrong in ["", "a", "x=", "x=-1", "NaN", "=x"] {
        assert!(wrong.parse::<Tolerance>().is_err(), "{wrong}");
    }
    let image = compiled(RUNNING);
    let image = Image::verify(&image).unwrap();
    let points = Search::run("p", 0, &image, "p.*").unwrap();
    let named = "p.Control.controller.OUTPUT=1".parse().unwrap();
    let wrong = Comparison::new(points, &[named]).unwrap_err();
    assert_eq!(wrong, "p.Control.controller.OUTPUT");
    let both = comparison(&image, &["1", "p.lamp.c*=2", "p.lamp.count=3"]);
    let all = ["p.Control.valve", "p.Lamp.lamp", "p.Lamp.count"];
    assert_eq!(all.map(|name| output(&both, name).tolerance), [1.0, 1.0, 3.0]);
}
