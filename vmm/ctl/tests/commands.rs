//! `takt-ctl` as a user or a script meets it, against Takt's own server and a run that is none.

use std::fs;
use std::io::Write;
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use serde_json::Value;
use takt::control::{Door, Operator, Server};
use takt::live::ValueOrder;
use takt_protocol::{
    ChannelStatus, ErrorKind, EventKind, ImageVersion, Load, Mode, PartitionStatus, Range, Refusal,
    ScheduleStatus, State, Status, TraceStart, TracedPartition, TracedWindow, VersionStatus,
};
use takt_record::WindowRecord;
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::time::{Nanos, Ticks, Tsc};

const FILE: &str = r#"
version = 1
[system]
name = "s"
major_frame = "1ms"
control = "takt.sock"
[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "4MiB"
[[schedule]]
name = "normal"
[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#;

#[derive(Default)]
struct FakeRun {
    looks: AtomicU64,
    typed: Arc<Mutex<Vec<u8>>>,
}

fn granted(what: &str, partition: &str) -> Result<String, Refusal> {
    match partition {
        "plc" => Ok(format!("{partition} {what}")),
        _ => Err(Refusal::new(ErrorKind::NoSuchPartition, "there is no partition of this name")),
    }
}

impl Operator for FakeRun {
    fn now(&self) -> Nanos {
        // Each look is a millisecond.
        Nanos::from_millis(self.looks.fetch_add(1, Ordering::SeqCst))
    }

    fn status(&mut self) -> Status {
        let normal = || "normal".to_owned();
        Status {
            takt: "0".into(),
            pid: 1,
            system: "s".into(),
            file: "/s.toml".into(),
            uptime_ns: 1_500_000_000,
            major_frame_ns: 1_000_000,
            schedule: ScheduleStatus {
                names: vec![normal()],
                current: normal(),
                next: normal(),
                last_switch_ns: None,
                windows: Vec::new(),
                windows_left_out: 0,
            },
            partitions: vec![PartitionStatus {
                name: "plc".into(),
                kind: "plc".into(),
                cpu: 0,
                background: false,
                state: State::Stopped,
                start_mode: Mode::Warm,
                end: Some("stopped by an operator".into()),
                restarts: 1,
                cpu_time_ns: 0,
                cpu_share: 0.0,
                illegal_accesses: 0,
                console_dropped: 0,
                releases: None,
                programs: vec![],
                forced: vec![],
            }],
            channels: vec![ChannelStatus {
                name: "orders".into(),
                kind: "queuing".into(),
                source: "linux:orders".into(),
                destinations: vec!["plc:orders".into()],
                depth: Some(8),
                refresh_ns: None,
                contents: None,
                lost: None,
                problem: Some("an end makes an impossible claim: Counter".into()),
            }],
        }
    }

    fn stop(&mut self, partition: &str) -> Result<String, Refusal> {
        granted("stops", partition)
    }

    fn start(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        granted(&format!("start {mode:?}"), partition)
    }

    fn restart(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        granted(&format!("restart {mode:?}"), partition)
    }

    fn switch_schedule(&mut self, name: &str) -> Result<String, Refusal> {
        Ok(format!("schedule {name}"))
    }

    fn watch(
        &mut self,
        _client: u64,
        partition: &str,
        ranges: Vec<Range>,
        _interval: Nanos,
    ) -> Result<u64, Refusal> {
        granted("is watched", partition)?;
        Ok(ranges.len() as u64)
    }

    fn order_values(&mut self, partition: &str, _order: ValueOrder) -> Result<u64, Refusal> {
        granted("is changed", partition)?;
        Ok(1)
    }

    fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>> {
        Some(Ok(format!("change {ticket}")))
    }

    fn load(&mut self, load: Load) -> Result<String, Refusal> {
        let (part, parts) = (load.part, load.parts);
        granted(
            &format!("{} {part} of {parts}: {}", load.program, load.data.len()),
            &load.partition,
        )
    }

    fn commit(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        granted(&format!("commit {program}"), partition)
    }

    fn roll_back(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        granted(&format!("roll back {program}"), partition)
    }

    fn versions(&mut self, partition: &str) -> Result<Vec<VersionStatus>, Refusal> {
        let image = |version: &str| ImageVersion { version: version.into(), hash: "5e".repeat(32) };
        granted("versions", partition).map(|_| {
            vec![VersionStatus {
                program: "tank".into(),
                running: image("1.1.0"),
                other: Some(image("1.0.0")),
                phase: "held".into(),
                reason: None,
                jobs: 100,
                references_gone: 0,
                took_ns: 3120,
                at_ns: 2_000_000_000,
                cycle: 2000,
                carried_pages: 0,
                carrying_ns: 0,
            }]
        })
    }

    fn console(&mut self, partition: &str) -> Result<(usize, bool), Refusal> {
        granted("has a console", partition).map(|_| (0, true))
    }

    fn type_bytes(&mut self, _: &str, bytes: &[u8]) -> Result<usize, Refusal> {
        // Half of it, so that the rest is typed again.
        let taken = bytes.len().div_ceil(2);
        self.typed.lock().unwrap().extend(&bytes[..taken]);
        Ok(taken)
    }

    fn trace(&self) -> TraceStart {
        TraceStart {
            tsc_khz: 1_000_000,
            epoch_tsc: 5_000_000_000,
            since_tsc: 6_000_000_000,
            schedule: "normal".into(),
            schedules: vec!["normal".into(), "night".into()],
            partitions: vec![TracedPartition { name: "plc".into(), cpu: 0 }],
        }
    }
}

fn window(sequence: u64) -> TracedWindow {
    let release = Tsc(6_000_000_000 + 1_000_000 * sequence);
    let record = WindowRecord {
        sequence,
        schedule: ScheduleId(0),
        skipped: 0,
        release,
        end: release.after(Ticks(300_000)),
        due: release.before(Ticks(20_000)),
        woken: release.before(Ticks(10_000)),
        entered: release.before(Ticks(9_000)),
        left: release.after(Ticks(100_000)),
        kicked: None,
        claim: None,
        last_stamp: release,
        exits: 1,
        kernel_exits: 1,
        overrun: false,
        unfinished: false,
        has_tasks: false,
        ended: false,
    };
    TracedWindow::new("plc", "normal", &record, &[])
}

/// A folder with a partition file, and perhaps a Takt.
struct Plant {
    folder: PathBuf,
    end: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
    /// What was typed at the console of its run.
    typed: Arc<Mutex<Vec<u8>>>,
}

impl Plant {
    fn new(name: &str) -> Plant {
        let name = format!("takt-ctl-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("plant.toml"), FILE).unwrap();
        Plant { folder, end: Arc::default(), server: None, typed: Arc::default() }
    }

    fn running(name: &str) -> Plant {
        let mut plant = Plant::new(name);
        let door = Door::open(&plant.folder.join("takt.sock"), None).unwrap();
        let (end, typed) = (plant.end.clone(), plant.typed.clone());
        plant.server = Some(thread::spawn(move || {
            let mut server = Server::new(Some(door), 2);
            server.tell(Nanos(2_000_000_000), EventKind::Ended, Some("plc"), "triple fault");
            server.console(0, "plc", b"# \x1b[1m\xff");
            let mut run = FakeRun { typed, ..FakeRun::default() };
            for sequence in 0.. {
                if end.load(Ordering::SeqCst) {
                    break;
                }
                server.serve(&mut run);
                server.window(|| window(sequence));
                // The tick of this supervisor thread; nothing depends on its length.
                thread::park_timeout(Duration::from_millis(1));
            }
        }));
        plant
    }

    /// Exit status, standard output, standard error of `takt-ctl`.
    fn says(&self, arguments: &[&str]) -> (i32, String, String) {
        self.run(env!("CARGO_BIN_EXE_takt-ctl"), arguments)
    }

    fn run(&self, program: &str, arguments: &[&str]) -> (i32, String, String) {
        let mut command = Command::new(program);
        let command = command.args(arguments).current_dir(&self.folder);
        let Output { status, stdout, stderr } = command.output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (status.code().unwrap(), text(stdout), text(stderr))
    }
}

impl Drop for Plant {
    fn drop(&mut self) {
        self.end.store(true, Ordering::SeqCst);
        if let Some(server) = self.server.take() {
            let _ = server.join();
        }
        let _ = fs::remove_dir_all(&self.folder);
    }
}

#[test]
fn a_console_shows_its_last_bytes_unchanged_and_takes_all_that_is_piped() {
    let plant = Plant::running("console");
    let text: Vec<u8> = (0..10_000_u32).map(|n| (n % 251) as u8).collect();
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt-console"));
    command.args(["plant.toml", "plc"]).current_dir(&plant.folder);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(&text).unwrap();
    let Output { status, stdout, .. } = child.wait_with_output().unwrap();
    assert_eq!((status.code(), stdout), (Some(0), b"# \x1b[1m\xff".to_vec()));
    assert!(*plant.typed.lock().unwrap() == text, "what was typed is not what was piped");
    let console = |place, name| plant.run(env!("CARGO_BIN_EXE_takt-console"), &[place, name]);
    let refused = "takt-console: refused: there is no partition of this name\n";
    assert_eq!(console("takt.sock", "unknown"), (1, String::new(), refused.to_owned()));
    assert_eq!(console("none.sock", "plc").0, 3);
}

#[test]
fn a_reader_that_goes_is_told_nothing() {
    let plant = Plant::running("reader");
    for request in [&["plant.toml", "status"][..], &["plant.toml", "events", "--follow"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt-ctl"));
        let command = command.args(request).current_dir(&plant.folder).stdout(writer);
        let output = command.stderr(Stdio::piped()).output().unwrap();
        assert_eq!((output.status.code(), output.stderr), (Some(141), vec![]), "{request:?}");
    }
}

#[test]
fn a_program_is_changed_in_steps() {
    let plant = Plant::running("change");
    fs::write(plant.folder.join("new.plc"), vec![7; 60_000]).unwrap();
    let good = |out: &str| (0, format!("{out}\n"), String::new());
    // An image that is longer than a line goes in parts, of which the last is answered.
    let load = |partition, file| plant.says(&["plant.toml", "load", partition, "tank", file]);
    assert_eq!(load("plc", "new.plc"), good("plc tank 2 of 3: 10848"));
    let said = plant.says(&["plant.toml", "commit", "plc", "tank"]);
    assert_eq!(said, good("plc commit tank"));
    let said = plant.says(&["plant.toml", "roll-back", "plc", "tank"]);
    assert_eq!(said, good("plc roll back tank"));
    let said = plant.says(&["plant.toml", "versions", "plc"]).1;
    assert!(
        said.contains("tank             runs 1.1.0 (5e5e5e5e), other 1.0.0 (5e5e5e5e), held"),
        "{said}"
    );
    assert!(said.contains("last change at 2.000 s, cycle 2000, in 3120 ns"), "{said}");
    assert_eq!(load("other", "new.plc").0, 1);
    let none = load("plc", "none.plc");
    assert!(none.0 == 2 && none.2.contains("cannot read none.plc"), "{none:?}");
    fs::write(plant.folder.join("empty.plc"), "").unwrap();
    assert_eq!(load("plc", "empty.plc").0, 2);
}

#[test]
fn orders_are_given_by_the_file_or_by_the_socket() {
    let plant = Plant::running("orders");
    let good = |out: &str| (0, format!("{out}\n"), String::new());
    assert_eq!(plant.says(&["plant.toml", "stop", "plc"]), good("plc stops"));
    assert_eq!(plant.says(&["takt.sock", "start", "plc"]), good("plc start Cold"));
    assert_eq!(plant.says(&["takt.sock", "start", "plc", "--warm"]), good("plc start Warm"));
    assert_eq!(plant.says(&["takt.sock", "restart", "plc", "--cold"]), good("plc restart Cold"));
    assert_eq!(plant.says(&["takt.sock", "schedule", "night"]), good("schedule night"));
    let event = "       2.000 s  plc: triple fault";
    assert_eq!(plant.says(&["takt.sock", "events"]), good(event));
    let json = r#"{"version":2,"answer":"done","text":"plc stops"}"#;
    assert_eq!(plant.says(&["--json", "takt.sock", "stop", "plc"]), good(json));
    let refused = "takt-ctl: refused: there is no partition of this name\n";
    let expected = (1, String::new(), refused.to_owned());
    assert_eq!(plant.says(&["takt.sock", "stop", "unknown"]), expected);
}

#[test]
fn the_status_is_a_table() {
    let plant = Plant::running("status");
    let expected = "\
s: up 1.5 s, schedule \"normal\", major frame 1000 us

partition  cpu  state    start  CPU    restarts  releases  lost  late  overruns
plc        0    stopped  warm   0.0 %  1         -         -     -     -

channel  from          to          fill  newest  written  lost
orders   linux:orders  plc:orders  ?     -       ?        -

plc: stopped by an operator
channel orders: an end makes an impossible claim: Counter
";
    assert_eq!(plant.says(&["plant.toml", "status"]), (0, expected.to_owned(), String::new()));
}

#[test]
fn a_trace_is_a_file_for_viewers_or_lines_for_programs() {
    let plant = Plant::running("trace");
    let (status, out, error) = plant.says(&["plant.toml", "trace", "--for", "20ms"]);
    assert_eq!(status, 0, "{error}");
    let events: Vec<Value> = serde_json::from_str(&out).unwrap();
    let releases = events.iter().filter(|e| e["name"] == "release").count();
    assert!(releases > 5, "{releases} of 20");
    assert_eq!(error, format!("takt-ctl: {releases} windows, all that Takt has recorded\n"));

    let (status, out, _) = plant.says(&["--json", "plant.toml", "trace", "--for", "20ms"]);
    assert_eq!(status, 0);
    let lines: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let (first, last) = (lines.first().unwrap(), lines.last().unwrap());
    assert_eq!((&first["answer"], &last["answer"]), (&"trace".into(), &"traced".into()));
    assert_eq!(last["windows"], lines.len() - 2);

    let too_long = "takt-ctl: refused: `duration_ns` must be 1 to 60000000000\n";
    let expected = (1, String::new(), too_long.to_owned());
    assert_eq!(plant.says(&["plant.toml", "trace", "--for", "61s"]), expected);
}

#[test]
fn without_a_takt_the_status_is_3_and_the_message_says_what_to_look_for() {
    let plant = Plant::new("no-takt");
    for place in ["plant.toml", "takt.sock"] {
        let (status, out, error) = plant.says(&[place, "status"]);
        assert_eq!((status, out.as_str()), (3, ""), "{error}");
        assert!(
            error.contains("is it running, and does its file have the key `control`?"),
            "{error}"
        );
    }
    // The status is the same if the message cannot be written.
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let mut ctl = Command::new(env!("CARGO_BIN_EXE_takt-ctl"));
    let ctl = ctl.args(["plant.toml", "status"]).current_dir(&plant.folder).stderr(full);
    assert_eq!(ctl.status().unwrap().code(), Some(3));
    drop(UnixListener::bind(plant.folder.join("takt.sock")).unwrap());
    let top = env!("CARGO_BIN_EXE_takt-top");
    let (status, _, error) = plant.run(top, &["plant.toml", "--watch", "tank.level"]);
    assert_eq!(status, 2);
    assert!(error.contains("no value is named `tank.level`"), "{error}");
    let (status, _, error) = plant.run(top, &["takt.sock", "--watch", "tank.level"]);
    assert_eq!(status, 2);
    assert!(error.contains("--watch takes the partition file"), "{error}");
    let (status, _, error) = plant.run(top, &["plant.toml"]);
    assert_eq!(status, 3);
    assert!(error.starts_with("takt-top: no Takt at "), "{error}");
    assert!(error.contains("it has ended without removing its socket"), "{error}");
}

#[test]
fn whatever_else_listens_there_is_no_takt() {
    let plant = Plant::new("other");
    let listener = UnixListener::bind(plant.folder.join("takt.sock")).unwrap();
    let server = thread::spawn(move || {
        for answer in [
            &b"HTTP/1.1 400 Bad Request\r\n"[..],
            b"",
            b"{\"version\":9,\"answer\":\"done\",\"text\":\"\"}\n",
        ] {
            use std::io::{Read, Write};
            let (mut stream, _) = listener.accept().unwrap();
            let _ = stream.read(&mut [0; 100]);
            stream.write_all(answer).unwrap();
        }
    });
    for part in ["no Takt of this version", "the connection has ended", "version 9 instead of 2"] {
        let (status, _, error) = plant.says(&["takt.sock", "status"]);
        assert_eq!(status, 3);
        assert!(error.contains(part), "{error}");
    }
    server.join().unwrap();
}

#[test]
fn wrong_usage_and_a_file_without_a_socket_give_status_2() {
    let plant = Plant::new("usage");
    for arguments in [
        &[][..],
        &["plant.toml"],
        &["plant.toml", "fly"],
        &["plant.toml", "restart", "plc"],
        &["plant.toml", "top"],
        &["plant.toml", "trace", "--for", "soon"],
        &["plant.toml", "restart", "plc", "--cold", "--warm"],
        &["missing.toml", "status"],
    ] {
        let (status, out, error) = plant.says(arguments);
        assert_eq!((status, out.as_str()), (2, ""), "{arguments:?}");
        assert!(!error.is_empty(), "{arguments:?}");
    }
    fs::write(plant.folder.join("plant.toml"), FILE.replace("control = \"takt.sock\"", ""))
        .unwrap();
    let (status, _, error) = plant.says(&["plant.toml", "status"]);
    assert_eq!(status, 2);
    assert!(error.contains("has no `control` in [system]"), "{error}");
    assert_eq!(plant.says(&["--help"]).0, 0);
}

#[test]
fn who_follows_sees_what_comes_until_takt_ends() {
    let mut plant = Plant::running("follow");
    let child = Command::new(env!("CARGO_BIN_EXE_takt-ctl"))
        .args(["takt.sock", "events", "--follow"])
        .current_dir(&plant.folder)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut child = child;
    let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    std::io::BufRead::read_line(&mut out, &mut line).unwrap();
    assert!(line.contains("triple fault"), "{line}");
    plant.end.store(true, Ordering::SeqCst);
    plant.server.take().unwrap().join().unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("the connection has ended"), "{error}");
}
