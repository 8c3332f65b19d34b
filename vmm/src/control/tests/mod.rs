//! The control socket, with real sockets and a run that only remembers what it was asked.

mod channels;
mod consoles;
mod documentation;
mod hostile;
mod orders;
mod protocol;
mod rights;
mod server;
mod tracing;

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use takt_scheduler::time::Nanos;

use super::door::Door;
use super::protocol::{
    Answer, ChannelStatus, Contents, ErrorKind, ForcedStatus, ImageVersion, Load, Message, Mode,
    PartitionStatus, ProgramState, ProgramStatus, Range, Refusal, ReleaseStatus, ScheduleStatus,
    State, Status, TaskState, TaskStatus, TraceStart, TracedPartition, VERSION, VersionStatus,
    WindowStatus,
};
use super::{Operator, Server};
use crate::live::ValueOrder;
use crate::report::Summary;

/// A folder of its own, gone at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Folder {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let number = COUNT.fetch_add(1, Ordering::SeqCst);
        let name = format!("takt-control-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn socket(&self) -> PathBuf {
        self.0.join("takt.sock")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Bytes for which a console of the run has room at a time.
const ROOM: usize = 5;

/// A run that grants everything but what concerns the partition "linux".
#[derive(Default)]
struct FakeRun {
    asked: Vec<String>,
    /// What was typed and taken.
    typed: Vec<u8>,
    /// The last change that has been carried out.
    answered: u64,
    now: Nanos,
}

impl FakeRun {
    fn order(&mut self, what: String, partition: &str) -> Result<String, Refusal> {
        if partition == "linux" {
            return Err(Refusal::new(ErrorKind::Unsupported, "not in this version"));
        }
        self.asked.push(what.clone());
        Ok(what)
    }
}

impl Operator for FakeRun {
    fn now(&self) -> Nanos {
        self.now
    }

    fn status(&mut self) -> Status {
        status()
    }

    fn stop(&mut self, partition: &str) -> Result<String, Refusal> {
        self.order(format!("stop {partition}"), partition)
    }

    fn start(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        self.order(format!("start {partition} {mode:?}"), partition)
    }

    fn restart(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        self.order(format!("restart {partition} {mode:?}"), partition)
    }

    fn switch_schedule(&mut self, name: &str) -> Result<String, Refusal> {
        self.order(format!("schedule {name}"), "")
    }

    fn watch(
        &mut self,
        client: u64,
        partition: &str,
        ranges: Vec<Range>,
        _interval: Nanos,
    ) -> Result<u64, Refusal> {
        self.order(format!("watch {client} {ranges:?}"), partition)?;
        Ok(ranges.iter().map(|range| u64::from(range.bytes)).sum())
    }

    fn order_values(&mut self, partition: &str, order: ValueOrder) -> Result<u64, Refusal> {
        self.order(format!("{order:?}"), partition)?;
        Ok(self.asked.len() as u64)
    }

    fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>> {
        let answered = self.answered >= ticket;
        answered.then(|| Ok(format!("ticket {ticket}")))
    }

    fn load(&mut self, load: Load) -> Result<String, Refusal> {
        let Load { program, part, parts, data, .. } = load;
        self.order(format!("load {program} {part}/{parts} {data:?}"), &load.partition)
    }

    fn commit(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        self.order(format!("commit {partition} {program}"), partition)
    }

    fn roll_back(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        self.order(format!("roll back {partition} {program}"), partition)
    }

    fn versions(&mut self, partition: &str) -> Result<Vec<VersionStatus>, Refusal> {
        self.order(format!("versions {partition}"), partition).map(|_| vec![versions()])
    }

    fn console(&mut self, partition: &str) -> Result<(usize, bool), Refusal> {
        let place = ["plc", "linux"].iter().position(|name| *name == partition);
        place.map(|place| (place, place == 1)).ok_or_else(|| {
            Refusal::new(ErrorKind::NoSuchPartition, "there is no partition of this name")
        })
    }

    fn type_bytes(&mut self, _: &str, bytes: &[u8]) -> Result<usize, Refusal> {
        self.typed.extend(bytes.iter().take(ROOM));
        Ok(bytes.len().min(ROOM))
    }

    fn trace(&self) -> TraceStart {
        trace_start()
    }
}

/// The versions of a program whose new version is on trial.
fn versions() -> VersionStatus {
    let image = |version: &str, digits: &str| ImageVersion {
        version: version.into(),
        hash: digits.repeat(32),
    };
    VersionStatus {
        program: "tank".into(),
        running: image("1.3.0", "7a"),
        other: Some(image("1.2.0", "5e")),
        phase: "trial".into(),
        reason: None,
        jobs: 12,
        references_gone: 0,
        took_ns: 3120,
        at_ns: 10_000_462_118,
        cycle: 10_000,
        carried_pages: 0,
        carrying_ns: 0,
    }
}

/// A server, and the run behind it.
struct Served {
    server: Server,
    run: FakeRun,
    folder: Folder,
}

impl Served {
    fn new() -> Served {
        Served::behind(|socket| Door::open(socket, None).unwrap())
    }

    /// With the door that this makes.
    fn behind(door: impl FnOnce(&Path) -> Door) -> Served {
        let folder = Folder::new();
        let server = Server::new(Some(door(&folder.socket())), 2);
        Served { server, run: FakeRun::default(), folder }
    }

    fn client(&self) -> Client {
        let stream = UnixStream::connect(self.folder.socket()).unwrap();
        // Nothing here ever waits for a time; without an answer the test fails instead of hanging.
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        Client(BufReader::new(stream))
    }

    fn serve(&mut self) {
        self.server.serve(&mut self.run);
    }
}

struct Client(BufReader<UnixStream>);

impl Client {
    fn send(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).unwrap();
    }

    /// The next line; `None` at the end.
    fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        match self.0.read_line(&mut line) {
            Ok(0) => None,
            Ok(_) => Some(line),
            // Takt has closed a connection on which something was left unread.
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => None,
            Err(error) => panic!("{error}"),
        }
    }

    fn answer(&mut self) -> Answer {
        let line = self.line().unwrap();
        let message: Message = serde_json::from_str(&line).unwrap();
        assert_eq!(message.version, VERSION);
        message.answer
    }

    fn error(&mut self) -> ErrorKind {
        match self.answer() {
            Answer::Error(refusal) => refusal.error,
            other => panic!("{other:?}"),
        }
    }
}

/// The one that `docs/control.md` shows.
fn status() -> Status {
    Status {
        takt: "0.1.0".into(),
        pid: 4711,
        system: "plc-and-linux".into(),
        file: "/srv/plant/plc-and-linux.toml".into(),
        uptime_ns: 10_000_000_000,
        major_frame_ns: 1_000_000,
        schedule: ScheduleStatus {
            names: vec!["normal".into()],
            current: "normal".into(),
            next: "normal".into(),
            last_switch_ns: None,
            windows: vec![WindowStatus {
                partition: "plc".into(),
                offset_ns: 0,
                duration_ns: 300_000,
            }],
            windows_left_out: 0,
        },
        partitions: vec![
            PartitionStatus {
                name: "plc".into(),
                kind: "plc".into(),
                cpu: 0,
                background: false,
                state: State::Running,
                start_mode: Mode::Cold,
                end: None,
                restarts: 0,
                cpu_time_ns: 230_000_000,
                cpu_share: 0.023,
                illegal_accesses: 0,
                console_dropped: 0,
                releases: Some(ReleaseStatus {
                    happened: 9990,
                    start_up_windows: 1,
                    lost: 0,
                    unrecorded: 0,
                    late: 0,
                    overruns: 0,
                    unfinished_windows: 0,
                    latency_sum_ns: 19_980,
                    release_latency_ns: Some(Summary { min: 0, p50: 2, p99: 4, p999: 4, max: 4 }),
                    execution_ns: None,
                    wake_up_latency_ns: None,
                }),
                programs: vec![ProgramStatus {
                    name: "tank".into(),
                    state: Some(ProgramState::Running),
                    image: Some("5e".repeat(32)),
                    tasks: vec![TaskStatus {
                        name: "main".into(),
                        state: TaskState::Waiting,
                        jobs: 9989,
                        missed: 0,
                        overruns: 0,
                        skipped: 0,
                        execution_min_ns: Some(310),
                        execution_max_ns: 402,
                        execution_sum_ns: 3_310_000,
                        response_max_ns: 460,
                        start_max_ns: 4,
                        slack_min_ns: Some(999_540),
                        switches: 9989,
                    }],
                }],
                forced: vec![ForcedStatus {
                    name: "tank.valve".into(),
                    text: "55.5".into(),
                    point: [0, 3, 0, 4, 255],
                    value: 1_113_456_640,
                    since_ns: 7_000_000_000,
                }],
            },
            PartitionStatus {
                name: "linux".into(),
                kind: "linux".into(),
                cpu: 0,
                background: true,
                state: State::Stopped,
                start_mode: Mode::Cold,
                end: Some("stopped by an operator".into()),
                restarts: 0,
                cpu_time_ns: 1_710_000_000,
                cpu_share: 0.171,
                illegal_accesses: 0,
                console_dropped: 0,
                releases: None,
                programs: vec![],
                forced: vec![],
            },
        ],
        channels: vec![
            ChannelStatus {
                name: "level".into(),
                kind: "sampling".into(),
                source: "plc:level".into(),
                destinations: vec!["linux:level".into(), "host:level".into()],
                depth: None,
                refresh_ns: Some(20_000_000),
                contents: Some(Contents {
                    written: 9990,
                    waiting: None,
                    overwritten: None,
                    age_ns: Some(700_000),
                    valid: Some(true),
                }),
                lost: Some(0),
                problem: None,
            },
            ChannelStatus {
                name: "orders".into(),
                kind: "queuing".into(),
                source: "linux:orders".into(),
                destinations: vec!["plc:orders".into()],
                depth: Some(8),
                refresh_ns: None,
                contents: Some(Contents {
                    written: 12,
                    waiting: Some(2),
                    overwritten: Some(0),
                    age_ns: Some(3_100_000_000),
                    valid: None,
                }),
                lost: None,
                problem: None,
            },
            ChannelStatus {
                name: "log".into(),
                kind: "queuing".into(),
                source: "linux:log".into(),
                destinations: vec!["plc:log".into()],
                depth: Some(64),
                refresh_ns: None,
                contents: None,
                lost: None,
                problem: Some("an end makes an impossible claim: Counter".into()),
            },
        ],
    }
}

/// What a trace begins with there.
fn trace_start() -> TraceStart {
    let partition = |name: &str| TracedPartition { name: name.into(), cpu: 0 };
    TraceStart {
        tsc_khz: 1_000_000,
        epoch_tsc: 50_000_000_000,
        since_tsc: 60_000_000_000,
        schedule: "normal".into(),
        schedules: vec!["normal".into()],
        partitions: vec![partition("plc"), partition("linux")],
    }
}
