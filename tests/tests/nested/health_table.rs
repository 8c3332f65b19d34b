//! Every error with every action that a partition file can have for it, in partitions that make the
//! error.
//!
//! The list is that of `takt check`, which tests of its own hold to the code: an error or an action more
//! is a pair more here, and fails the test unless there is a guest that makes it. The one error that no
//! guest can make is named below.

use std::path::PathBuf;

use takt_tests::{File, Host, Outcome, erring_kernel, long, plc_image};

/// Other PLCs than the good one that a file has room for, beside one that ends the run.
const PLCS: usize = 13;
/// How long a file runs that is not ended by an error.
const DURATION: &str = "400ms";
/// When a run is over that an error ends.
const ENDED_NS: u64 = 350_000_000;
/// How far a kernel counts: some milliseconds, or longer than all the others of a file need.
const COUNT: u32 = 2_000_000;
const LONG_COUNT: u32 = 80_000_000;
/// Frame, quarters of it in which all but the one that ends the run have windows, windows and what
/// they are apart, in us.
const FRAME: u64 = 16_000;
const QUARTER: u64 = FRAME / 4;
const WINDOW: u64 = 70;
const APART: u64 = 250;

/// What `takt check` says of an unknown error, or an unknown action.
macro_rules! said {
    ($what:literal) => {
        include_str!(concat!(
            "../../../vmm/plan/tests/partition_files/health/health-",
            $what,
            ".toml"
        ))
    };
}

/// The module `clocks` makes the first, which is the host's as a rule, with every action. The other
/// takes a processor that tells of bus locks, and the lab has none.
const OF_THE_HOST: [&str; 2] = ["clock-fault", "bus-lock"];

/// What the file may have there instead.
fn allowed(said: &'static str) -> Vec<&'static str> {
    let (_, list) = said.split_once("= allowed: ").expect("it says what is allowed");
    // An error's list begins with the kind of partition.
    let list = list.split_once("\": ").map_or(list, |(_, list)| list);
    list.split('"').skip(1).step_by(2).filter(|word| !OF_THE_HOST.contains(word)).collect()
}

/// A row of a table of the health monitor.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Row {
    error: &'static str,
    action: &'static str,
}

impl Row {
    fn of_plcs() -> Vec<Row> {
        Row::all(&allowed(said!("error-that-a-plc-never-has")), &allowed(said!("action-unknown")))
    }

    fn of_linuxes() -> Vec<Row> {
        let errors = allowed(said!("error-that-a-linux-never-has"));
        Row::all(&errors, &allowed(said!("warm-start-of-a-linux")))
    }

    /// All rows of these, so that the first ones have many of both.
    fn all(errors: &[&'static str], actions: &[&'static str]) -> Vec<Row> {
        let of_turn = |turn| {
            let numbered = errors.iter().enumerate();
            numbered.map(move |(number, error)| {
                let action = actions[(number + turn) % actions.len()];
                Row { error, action }
            })
        };
        (0..actions.len()).flat_map(of_turn).collect()
    }

    fn ends_the_run(self) -> bool {
        self.action == SHUT_DOWN
    }

    fn name(self) -> String {
        format!("{}-{}", self.error, self.action)
    }

    /// What makes the error in the place of a Linux.
    fn kernel(self) -> PathBuf {
        let count = if self.ends_the_run() { LONG_COUNT } else { COUNT };
        let kernel = erring_kernel(self.error, count);
        kernel.unwrap_or_else(|| panic!("no kernel makes {}", self.error))
    }
}

/// What a file has of the table.
#[derive(Clone, Default)]
struct Rows {
    plcs: Vec<Row>,
    linux: Option<Row>,
}

impl Rows {
    /// All of them, in as few files as there are rows for a Linux, of which a file has one. At most one
    /// partition of a file ends its run, and comes to that when the others have done what they do.
    fn all() -> Vec<Rows> {
        let (last, first): (Vec<_>, Vec<_>) =
            Row::of_linuxes().into_iter().partition(|row| row.ends_the_run());
        let linuxes = first.into_iter().chain(last);
        let (ending, plcs): (Vec<_>, Vec<_>) =
            Row::of_plcs().into_iter().partition(|row| row.ends_the_run());
        let (mut ending, mut plcs) = (ending.into_iter(), plcs.into_iter());
        let files = linuxes.map(|linux| {
            let mut rows: Vec<Row> = plcs.by_ref().take(PLCS).collect();
            // To start a Linux anew takes longer than the others live.
            if !linux.ends_the_run() && linux.action != "cold-start" {
                rows.extend(ending.next());
            }
            Rows { plcs: rows, linux: Some(linux) }
        });
        let files = files.collect();
        assert!(plcs.next().is_none() && ending.next().is_none(), "not every row has its place");
        files
    }

    fn file(&self, number: usize) -> PathBuf {
        let limit = "restarts = { at_most = 1, within = \"60s\" }";
        let image = plc_image("errors");
        let mut file = File::new(&format!("{FRAME}us")).plc("good", None, "");
        for row in &self.plcs {
            file = file.plc(&row.name(), Some(image.clone()), limit);
        }
        if let Some(row) = self.linux {
            let kernel = row.kernel();
            file = file.lines(&format!(
                "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
                 memory = \"64MiB\"\nkernel = {kernel:?}\n{limit}"
            ));
            if row.error == "partition-silent" {
                file = file.lines("watchdog = \"1s\"");
            }
        }
        let ends =
            self.plcs.iter().map(|row| format!("{:?}", format!("{}:{}", row.name(), row.error)));
        let ends: Vec<String> = ends.collect();
        if !ends.is_empty() {
            // Each PLC's port has the name of its error.
            file = file.lines(&format!(
                "[[channel]]\nname = \"names\"\nkind = \"sampling\"\nmessage_bytes = 1\n\
                 source = \"good:out\"\ndestinations = [{}]\nrefresh_period = \"1s\"",
                ends.join(", ")
            ));
        }
        for row in &self.plcs {
            file = file.health(&row.name(), row.error, row.action);
        }
        if let Some(row) = self.linux {
            file = file.health("linux", row.error, row.action);
        }
        file = file.schedule("normal");
        for quarter in 0..4 {
            file = file.window("good", quarter * QUARTER, WINDOW);
            for (place, row) in (1..).zip(&self.plcs) {
                if quarter == 0 || !row.ends_the_run() {
                    file = file.window(&row.name(), quarter * QUARTER + place * APART, WINDOW);
                }
            }
        }
        file.save(&format!("health-table-{number}"))
    }

    fn assert_came_true(&self, outcome: &Outcome) {
        for row in &self.plcs {
            row.assert_came_true(outcome, &row.name(), survived_by_plc(row.error));
            row.assert_started(outcome);
        }
        if let Some(row) = self.linux {
            row.assert_came_true(outcome, "linux", survived_by_linux(row.error));
        }
        // A file without the one lasts its time.
        let rows = || self.plcs.iter().chain(&self.linux);
        let duration = outcome.report["duration_ns"].as_u64().unwrap_or(0);
        let ended = rows().any(|row| row.ends_the_run());
        assert_eq!(duration < ENDED_NS, ended, "{duration} ns\n{}", outcome.output);
        assert!(!ended || outcome.status == 4, "status {}\n{}", outcome.status, outcome.output);
        outcome.assert_kept_its_time("good", duration / 1_000 / QUARTER - 2);
    }
}

const SHUT_DOWN: &str = "shut-down";
const IDLE: &str = "idle";

/// Errors after which the guest can go on.
fn survived_by_plc(error: &str) -> bool {
    ["deadline-missed", "application-error", "illegal-request"].contains(&error)
}

fn survived_by_linux(error: &str) -> bool {
    error == "illegal-request"
}

impl Row {
    /// What follows, from the first event to the last: the action, and why it is not the table's.
    fn events(self, survived: bool) -> Vec<(&'static str, &'static str)> {
        let action = (self.action, "");
        match self.action {
            "ignore" if survived => Vec::new(),
            // A window ends too early, and the next release passes while the guest comes to its end.
            "log" if self.error == "deadline-missed" => vec![action; 2],
            "log" if survived => vec![action],
            "ignore" | "log" => vec![(IDLE, ": it cannot go on")],
            IDLE | SHUT_DOWN => vec![action],
            "cold-start" | "warm-start" => {
                vec![action, (IDLE, ": started again 1 time within 60s")]
            }
            other => panic!("this test does not say what follows from {other}"),
        }
    }

    /// Fails unless the partition's events, its lines on the console and its end are those of the row.
    fn assert_came_true(self, outcome: &Outcome, partition: &str, survived: bool) {
        let (error, events) = (self.error, self.events(survived));
        let context = || format!("{} of {partition}\n{}", self.name(), outcome.output);
        let of = &outcome.partition(partition);
        let list = of["events"]["list"].as_array().map_or(&[][..], Vec::as_slice);
        let seen: Vec<_> = list.iter().map(|event| (&event["error"], &event["action"])).collect();
        let expected: Vec<_> = events.iter().map(|(action, _)| (error, *action)).collect();
        assert_eq!(seen.len(), expected.len(), "{list:#?} for {}", context());
        assert!(
            seen.iter().zip(&expected).all(|(seen, e)| seen.0 == e.0 && seen.1 == e.1),
            "{}",
            context()
        );
        let numbers: Vec<_> = list.iter().map(|event| event["sequence"].as_u64()).collect();
        let in_order: Vec<_> = (1..).take(list.len()).map(Some).collect();
        assert_eq!(numbers, in_order, "{}", context());
        assert!(list.is_sorted_by_key(|event| event["at_ns"].as_u64()), "{}", context());

        // Nothing else was wrong with it, and what is ignored is counted.
        let totals = of["events"]["totals"].as_object();
        let errors: Vec<_> = totals.into_iter().flatten().map(|(error, _)| error).collect();
        assert_eq!(errors, [error], "{}", context());
        let total = outcome.number(partition, &format!("events.totals.{error}"));
        let ignored = survived && self.action == "ignore";
        assert!(total == list.len() as u64 || ignored && total > 0, "{total} of {}", context());

        let begin = format!("[takt] {partition}: {error}: ");
        let lines = lines_with(outcome, &[&begin]);
        assert_eq!(lines.len(), list.len(), "{}", context());
        for ((line, event), (action, reason)) in lines.iter().zip(list).zip(&events) {
            let detail = event["detail"].as_str().unwrap_or("");
            assert_eq!(*line, format!("{begin}{detail} -> {action}{reason}"), "{}", context());
        }

        let restarts = events.iter().filter(|(action, _)| action.ends_with("-start")).count();
        assert_eq!(outcome.number(partition, "restarts"), restarts as u64, "{}", context());
        let last = list.last().map(|event| &event["detail"]);
        let goes_on = survived && ["ignore", "log"].contains(&self.action);
        let stopped = "stopped by takt".into();
        assert_eq!(&of["end"], last.filter(|_| !goes_on).unwrap_or(&stopped), "{}", context());
    }

    /// Fails unless each start of a PLC came when it should, and the guest was told how.
    fn assert_started(self, outcome: &Outcome) {
        let name = self.name();
        let mut steps = vec!["cold start, condition 0, retained 0"];
        for (action, _) in self.events(survived_by_plc(self.error)) {
            steps.push(action);
            match self.action {
                "cold-start" if action != IDLE => {
                    steps.push("cold start, condition 3, retained 0");
                }
                "warm-start" if action != IDLE => {
                    steps.push("warm start, condition 3, retained 1");
                }
                _ => {}
            }
        }
        let said = [format!("[takt] {name}: "), format!("[{name}] ")];
        let lines = lines_with(outcome, &[&said[0], &said[1]]);
        assert_eq!(lines.len(), steps.len(), "{lines:#?} for {steps:?}\n{}", outcome.output);
        for (line, step) in lines.iter().zip(steps) {
            assert!(line.contains(step), "{line} is not {step}\n{}", outcome.output);
        }
    }
}

/// The lines of the console that begin in one of these ways.
fn lines_with<'a>(outcome: &'a Outcome, begins: &[&str]) -> Vec<&'a str> {
    let lines = outcome.output.lines().map(str::trim_end);
    lines.filter(|line| begins.iter().any(|begin| line.starts_with(begin))).collect()
}

#[test]
fn what_follows_from_each_error_is_what_its_row_says() {
    let all = Rows::all();
    // All of them are written, whichever run: an error that no guest here makes is found at once.
    let files: Vec<PathBuf> = (0..).zip(&all).map(|(number, rows)| rows.file(number)).collect();
    let count = if long() { all.len() } else { 1 };
    let (all, files) = (&all[..count], &files[..count]);
    let host = Host::new().with_file(&plc_image("errors"));
    let kernels = all.iter().filter_map(|rows| rows.linux).map(Row::kernel);
    let host = kernels.fold(host, |host, kernel| host.with_file(&kernel));
    let outcomes = host.run_each("health-table", DURATION, files);
    for (rows, outcome) in all.iter().zip(&outcomes) {
        rows.assert_came_true(outcome);
    }
}
