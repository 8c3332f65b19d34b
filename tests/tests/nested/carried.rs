//! The control socket of a Takt in an emulated machine, as the user has it outside of the machine.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use takt_tests::{BUSY, File, Outcome, Value, parse, plc_image, root, save_bytes, target};

use super::st;

/// A program whose values agree after each job.
const PROGRAM: &str = "
PROGRAM Main
    VAR
        n : DINT;
        twice : DINT;
        setpoint : REAL := 1.5;
        seen : REAL;
    END_VAR
    n := n + 1;
    twice := 2 * n;
    seen := setpoint;
END_PROGRAM

CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 3);
    PROGRAM main WITH often : Main;
END_CONFIGURATION
";

/// A run that goes on until the client releases what it has forced.
struct Plant {
    name: &'static str,
    file: PathBuf,
    socket: PathBuf,
    text: File,
}

impl Plant {
    fn new(name: &'static str) -> Self {
        Self::beside(name, |file| file.linux(BUSY))
    }

    fn beside(name: &'static str, others: impl Fn(File) -> File) -> Self {
        build_clients();
        let image = save_bytes(&format!("{name}.plc"), &st::image("p", "main.st", PROGRAM));
        let program = format!(
            "image = {:?}\nmemory = \"32MiB\"\n[[partition.program]]\nimage = {image:?}\nname = \"p\"\n\
             allow_force = true\n",
            plc_image("kernel")
        );
        let text =
            File::new("1ms").lines(&format!("control = \"{name}.sock\"")).plc_with("plc", &program);
        let text = others(text).schedule("normal").window("plc", 0, 300);
        let socket = target("tests").canonicalize().unwrap().join(format!("{name}.sock"));
        let file = text.save(name);
        Self { name, file, socket, text }
    }

    fn run(&self) -> Outcome {
        self.text.run(self.name).until("p.main.setpoint is forced no longer").run()
    }

    fn connect(&self) -> UnixStream {
        connect(&self.socket)
    }
}

/// A connection, as soon as there is the socket.
pub(super) fn connect(socket: &Path) -> UnixStream {
    for _ in 0..20_000 {
        if let Ok(stream) = UnixStream::connect(socket) {
            return stream;
        }
        thread::sleep(Duration::from_millis(20));
    }
    panic!("there is no {}", socket.display());
}

/// Builds the user's programs. Before a run begins: it would go on all the while.
pub(super) fn build_clients() {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--quiet"]);
        let clients = ["takt-plc", "takt-ctl", "takt-console", "takt-shell"];
        cargo.args(clients.map(|name| ["--bin", name]).concat());
        assert!(cargo.current_dir(root()).status().expect("cargo starts").success());
    });
}

/// What one of the user's programs prints.
pub(super) fn client(program: &str, arguments: &[&str]) -> String {
    typing_client(program, arguments, b"")
}

/// What one of the user's programs prints to which this is typed.
pub(super) fn typing_client(program: &str, arguments: &[&str], typed: &[u8]) -> String {
    build_clients();
    let path = root().join("target/x86_64-unknown-linux-gnu/debug").join(program);
    let mut command = Command::new(path);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    // Closed at once, as a pipe that has no more to say.
    child.stdin.take().expect("stdin is a pipe").write_all(typed).expect("the program reads");
    let output = child.wait_with_output().expect("the program ends");
    let (out, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{program} {arguments:?}: {out}{errors}");
    out.into_owned()
}

/// Watches, forces and releases by the programs that users have.
fn operate(file: &Path) {
    let file = file.to_str().unwrap();
    let status = parse(&client("takt-ctl", &["--json", file, "status"]));
    assert_eq!(status["status"]["partitions"][0]["programs"][0]["name"], "p", "{status:#}");

    let points = client("takt-plc", &["points", file, "p.main.*"]);
    assert_eq!(points.lines().count(), 4, "{points}");
    let forced = client("takt-plc", &["force", file, "p.main.setpoint", "2.25"]);
    assert!(forced.contains("p.main.setpoint"), "{forced}");
    let watch = ["watch", file, "p.main.*", "--every", "0ms", "--lines", "30", "--json"];
    let lines: Vec<Value> = client("takt-plc", &watch).lines().map(parse).collect();
    let mut last = 0;
    for line in &lines {
        let value = |name: &str| {
            let text = line["values"][format!("p.main.{name}")].as_str().unwrap_or_default();
            text.parse::<f64>().unwrap_or_else(|_| panic!("{name} in {line}"))
        };
        assert_eq!(value("n") * 2.0, value("twice"), "a line of two cycles: {line}");
        assert_eq!((value("setpoint"), value("seen")), (2.25, 2.25), "{line}");
        // What is not told is counted.
        let (cycle, missed) = (line["cycle"].as_u64().unwrap(), line["missed"].as_u64().unwrap());
        assert!(last == 0 || cycle > last + missed, "{cycle} after {last}: {line}");
        last = cycle;
    }
    assert_eq!(lines.len(), 30);
    record(file);
    interrupt_a_recording(file);
    client("takt-plc", &["release", file, "p.main.setpoint"]);
}

/// Records around a trigger, as a table, as counters and as a picture.
fn record(file: &str) {
    let out = |kind: &str| Path::new(file).with_extension(format!("record.{kind}"));
    for kind in ["csv", "json", "svg"] {
        let (path, points) = (out(kind), "p.main.n,p.main.twice");
        let options = ["--trigger", "p.main.seen = 2.25", "--pre", "10ms", "--for", "100ms"];
        let record =
            [&["record", file, "--points", points, "--out", path.to_str().unwrap()], &options[..]];
        client("takt-plc", &record.concat());
    }
    let table = std::fs::read_to_string(out("csv")).unwrap();
    let mut rows = table.lines();
    assert_eq!(rows.next(), Some("cycle,release_ns,gap,unsettled,p.main.n,p.main.twice"));
    let (mut count, mut last) = (0, None);
    for row in rows {
        let row: Vec<u64> = row.split(',').map(|field| field.parse().unwrap()).collect();
        let [cycle, _, gap, _, n, twice] = row[..] else { panic!("{row:?}") };
        assert_eq!(n * 2, twice, "a row of two cycles: {row:?}");
        assert!(last.is_none_or(|last| cycle == last + gap + 1), "{row:?} after {last:?}");
        (count, last) = (count + 1, Some(cycle));
    }
    assert!((2..=101).contains(&count), "{count} rows");
    let curves = std::fs::read_to_string(out("svg")).unwrap();
    for part in ["<svg", "p.main.n", "p.main.twice", "cycles, ", "<polyline"] {
        assert!(curves.contains(part), "no {part} in {curves}");
    }
    let picture = parse(&std::fs::read_to_string(out("json")).unwrap());
    let of = |name: &str| {
        let events = picture.as_array().unwrap().iter();
        events.filter(|event| event["name"] == name && event["ph"] == "C").count()
    };
    assert!(of("p.main.n") >= 2 && of("p.main.n") == of("p.main.twice"), "{picture:#}");
}

/// Ctrl-C ends a recording whose trigger has not come, and its file has an end.
fn interrupt_a_recording(file: &str) {
    let out = Path::new(file).with_extension("interrupted.json");
    let _ = std::fs::remove_file(&out);
    let mut command = Command::new(root().join("target/x86_64-unknown-linux-gnu/debug/takt-plc"));
    let options = ["--trigger", "p.main.n < 0", "--for", "100s", "--out", out.to_str().unwrap()];
    command.args(["record", file, "--points", "p.main.n"]).args(options).stderr(Stdio::piped());
    // A shell that starts these tests in the background has it ignored, and all that they start would inherit that.
    let hear = || {
        // SAFETY: touches no memory, and may be called between fork and exec.
        unsafe { libc::signal(libc::SIGINT, libc::SIG_DFL) };
        Ok(())
    };
    // SAFETY: `hear` makes one system call.
    unsafe { command.pre_exec(hear) };
    let child = command.spawn().expect("takt-plc starts");
    for _ in 0..20_000 {
        if out.exists() {
            break;
        }
        thread::sleep(Duration::from_millis(20));
    }
    // SAFETY: takes numbers only, and the child has not been waited for.
    unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGINT) };
    let output = child.wait_with_output().expect("takt-plc ends");
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{told}");
    assert!(told.contains("the trigger has not come") && told.contains("interrupted: "), "{told}");
    assert!(parse(&std::fs::read_to_string(&out).unwrap()).is_array());
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn the_socket_is_there_outside_and_no_client_of_it_moves_a_release() {
    let plant = Plant::new("carried");
    let over = AtomicBool::new(false);
    let (outcome, unread) = thread::scope(|scope| {
        let run = scope.spawn(|| plant.run());
        // One asks for more than it ever reads; one sends what is no request, as fast as it can.
        let mut stalled = plant.connect();
        stalled
            .write_all(b"{\"version\":2,\"request\":\"trace\",\"duration_ns\":60000000000}\n")
            .unwrap();
        let flood = scope.spawn(|| {
            let mut stream = plant.connect();
            stream.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
            while !over.load(Ordering::Relaxed) {
                if stream.write_all(&[b'x'; 4096]).is_err() {
                    stream = UnixStream::connect(&plant.socket).unwrap_or(stream);
                }
            }
        });
        operate(&plant.file);
        over.store(true, Ordering::Relaxed);
        flood.join().unwrap();
        let outcome = run.join().unwrap();
        let mut line = String::new();
        BufReader::new(stalled).read_line(&mut line).unwrap();
        (outcome, line)
    });
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows(&format!("control socket {}", plant.socket.display()));
    let operator = &outcome.partition("plc")["operator"];
    assert_eq!((&operator["forced"], &operator["at_the_end"]), (&1.into(), &Value::Array(vec![])));
    assert!(unread.contains("\"answer\":\"trace\""), "{unread}");
    assert!(!plant.socket.exists(), "it goes with the run");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn the_socket_is_there_outside_of_bochs_too() {
    let plant = Plant::beside("carried-vmx", |file| file);
    let outcome = thread::scope(|scope| {
        let run = plant.text.run(plant.name).in_lane("vmx").lasting("12s");
        let run = scope.spawn(move || run.run());
        drop(plant.connect());
        operate(&plant.file);
        run.join().unwrap()
    });
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("emulated by Bochs 3.");
    outcome.assert_shows("p.main.setpoint is forced no longer");
    assert_eq!(outcome.partition("plc")["operator"]["forced"], 1);
    assert!(!plant.socket.exists(), "it goes with the run");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_run_whose_socket_another_program_has_does_not_start() {
    let plant = Plant::new("carried-twice");
    let _ = std::fs::remove_file(&plant.socket);
    let other = std::os::unix::net::UnixListener::bind(&plant.socket).unwrap();
    let outcome = plant.text.run(plant.name).lasting("10ms").run();
    assert_eq!(outcome.status, 2, "{}", outcome.output);
    outcome.assert_shows("another program listens there");
    drop(other);
    std::fs::remove_file(&plant.socket).unwrap();
}
