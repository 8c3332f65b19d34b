//! Several Linux partitions, and their consoles through the control socket.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use takt_tests::{File, Outcome, System, Value, long, parse, target};

use super::carried::{build_clients, connect, typing_client};

/// Keeps a Linux busy from before its shell on.
const LOAD: &str = "while :; do cat /proc/kallsyms > /dev/null; done &";

/// Two PLCs and two busy Linuxes on one CPU; the console of the second Linux is at the control socket.
struct Plant {
    text: File,
    file: PathBuf,
    socket: PathBuf,
}

impl Plant {
    fn new(name: &str) -> Self {
        build_clients();
        let second = System { name: "second", exec: LOAD, ..System::default() };
        let text = File::new("1ms")
            .lines(&format!("control = \"{name}.sock\""))
            .plc("left", None, "release_guard = \"10us\"")
            .plc("right", None, "release_guard = \"10us\"")
            .linux(LOAD)
            .other_linux(&second)
            .lines(&format!("console = \"control\"\nconsole_log = \"{name}.log\""))
            .schedule("normal")
            .window("left", 0, 150)
            .window("right", 400, 150);
        let socket = target("tests").canonicalize().unwrap().join(format!("{name}.sock"));
        let file = text.save(name);
        Self { text, file, socket }
    }

    fn attach(&self, partition: &str) -> Console {
        Console::attach(&self.socket, partition)
    }
}

/// A client that is attached to a console.
struct Console {
    takt: BufReader<UnixStream>,
    partition: String,
    /// What the console has shown and the test has not looked for yet.
    shown: Vec<u8>,
    /// Bytes that were missed.
    missed: u64,
}

impl Console {
    fn attach(socket: &Path, partition: &str) -> Self {
        let (takt, partition) = (BufReader::new(connect(socket)), partition.to_owned());
        let mut console = Self { takt, partition, shown: Vec::new(), missed: 0 };
        console.ask("attach", "");
        let start = console.answer("attached");
        assert_eq!(start["console"]["terminal"], console.partition != "left", "{start}");
        console
    }

    fn ask(&mut self, request: &str, more: &str) {
        let partition = &self.partition;
        let line = format!(
            "{{\"version\":2,\"request\":{request:?},\"partition\":{partition:?}{more}}}\n"
        );
        self.takt.get_mut().write_all(line.as_bytes()).unwrap();
    }

    /// The next answer of this kind; keeps what the console shows before it.
    fn answer(&mut self, kind: &str) -> Value {
        loop {
            let mut line = String::new();
            let read = self.takt.read_line(&mut line).unwrap();
            assert!(read > 0, "the connection has ended before {kind}");
            let answer = parse(&line);
            let console = &answer["console"];
            self.shown.extend(bytes(console["bytes"].as_str().unwrap_or_default()));
            self.missed += console["missed"].as_u64().unwrap_or(0);
            if answer["answer"] == kind {
                return answer;
            }
            assert_ne!(answer["answer"], "error", "{answer}");
        }
    }

    /// Types all of it.
    fn type_all(&mut self, text: &str) {
        let mut left = text.as_bytes();
        while !left.is_empty() {
            let digits: String = left.iter().map(|byte| format!("{byte:02x}")).collect();
            self.ask("type", &format!(",\"data\":{digits:?}"));
            let taken = self.answer("typed")["taken"].as_u64().unwrap();
            left = &left[taken as usize..];
        }
    }

    /// Waits until the console has shown this, and looks behind it from then on.
    fn until(&mut self, text: &str) {
        loop {
            let found = self.shown.windows(text.len()).position(|w| w == text.as_bytes());
            if let Some(at) = found {
                self.shown.drain(..at + text.len());
                return;
            }
            self.answer("console");
        }
    }
}

fn bytes(digits: &str) -> Vec<u8> {
    let pairs = (0..digits.len() / 2).map(|at| &digits[2 * at..2 * at + 2]);
    pairs.map(|pair| u8::from_str_radix(pair, 16).unwrap()).collect()
}

/// Both PLCs as if there were no consoles, and both Linuxes with their parts of what was left.
fn assert_unmoved(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for plc in ["left", "right"] {
        outcome.assert_kept_its_time(plc, outcome.cycles(1_000) - 10);
        outcome.assert_punctual(plc);
    }
    let parts = ["linux", "second"].map(|linux| outcome.received(linux));
    assert!(parts.iter().all(|part| (0.3..0.7).contains(part)), "{parts:?}");
    // Two programs cannot have more than all, and what Takt and its carrier need is little.
    assert!((0.8..=1.0).contains(&parts.iter().sum()), "{parts:?}");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn consoles_are_attached_and_detached_under_load_and_no_release_moves() {
    let plant = Plant::new("consoles");
    let log = plant.file.with_extension("log");
    fs::write(&log, "before\n").unwrap();
    let outcome = thread::scope(|scope| {
        let run = plant.text.run("consoles").until("the end is 7").given_up_after(3_000);
        let run = scope.spawn(move || run.run());
        let mut second = plant.attach("second");
        second.until("linux# ");
        second.type_all("echo here is $((40 + 2))\n");
        second.until("here is 42");
        // What was there before a client came is what it finds.
        for round in 1..=if long() { 1_000 } else { 20 } {
            let mut again = plant.attach("second");
            if round % 10 == 0 {
                again.type_all(&format!("echo round $((8000 + {round}))\n"));
                again.until(&format!("round {}", 8000 + round));
            }
        }
        let mut plc = plant.attach("left");
        plc.until("\n");
        let file = plant.file.to_str().unwrap();
        typing_client("takt-console", &[file, "second"], b"echo typed $((6 * 7))\n");
        second.until("typed 42");
        assert_eq!(second.missed, 0, "a client that reads has missed something");
        // The other Linux shares nothing with it but the processor.
        let mut first = plant.attach("linux");
        first.until("linux# ");
        first.type_all("echo the end is $((3 + 4))\n");
        run.join().unwrap()
    });
    outcome.assert_shows("second: its console: takt console");
    assert!(!outcome.output.contains("here is 42"), "the hidden console is on the terminal");
    // All of it is in the file, behind what was there.
    let kept = String::from_utf8_lossy(&fs::read(&log).unwrap()).into_owned();
    let places = ["before", "Linux version ", "here is 42", "round 8020", "typed 42"];
    let places = places.map(|text| kept.find(text).unwrap_or_else(|| panic!("no {text}: {kept}")));
    assert!(places.is_sorted() && places[0] == 0, "{places:?}");
    assert_unmoved(&outcome);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn hostile_clients_of_a_console_move_no_release_and_hold_up_no_guest() {
    let plant = Plant::new("consoles-hostile");
    let over = AtomicBool::new(false);
    let (outcome, flood) = thread::scope(|scope| {
        let run = plant.text.run("consoles-hostile").until("the end is 7").given_up_after(3_000);
        let run = scope.spawn(move || run.run());
        let mut second = plant.attach("second");
        second.until("linux# ");
        // One is attached and never reads.
        let silent = plant.attach("second");
        // One types what no program reads, as fast as it can.
        let typist = scope.spawn(|| {
            let mut typist = plant.attach("linux");
            let (mut typed, digits) = (0_u64, "23".repeat(4_000));
            let stream = typist.takt.get_mut().try_clone().unwrap();
            stream.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
            while !over.load(Ordering::Relaxed) {
                typist.ask("type", &format!(",\"data\":{digits:?}"));
                typed += typist.answer("typed")["taken"].as_u64().unwrap();
            }
            typed
        });
        // A guest that prints without end, and is still to be typed at.
        let lines = if long() { 8_000 } else { 400 };
        second.type_all(&format!(
            "yes 0123456789abcdef0123456789abcdef | head -n {lines}; echo done $((1 + 1))\n"
        ));
        second.until("done 2");
        over.store(true, Ordering::Relaxed);
        let typed = typist.join().unwrap();
        let mut first = plant.attach("linux");
        // The terminal of the guest throws away what it has when it gets this key.
        first.type_all("\x03");
        first.until("^C");
        first.until("linux# ");
        first.type_all("echo the end is $((3 + 4))\n");
        let outcome = run.join().unwrap();
        drop(silent);
        (outcome, typed)
    });
    assert!(flood > 4_096, "{flood} bytes typed");
    assert_unmoved(&outcome);
}
