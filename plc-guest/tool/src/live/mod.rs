//! A PLC while it runs: its values by name, through the control socket of its Takt.
//!
//! Takt knows no names. They are those of the images that the partition file names; so before anything is asked, the
//! hashes of these images are compared with those of the images that run.

pub mod output;
pub mod plot;
pub mod points;
pub mod recording;
pub mod trigger;

use std::path::{Path, PathBuf};

use takt_client::{ClientError, Connection};
use takt_plan::{Partition, PartitionFile};
use takt_program::Image;
use takt_protocol::{Answer, Request, Values};
use takt_scheduler::table::PartitionId;

use crate::Failure;
use crate::commands::hex;
use crate::shadow::Times;
use crate::status;
use points::{Point, Search};

/// Exit status: Takt refuses, or none answers.
impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let status = match error {
            ClientError::File(_) | ClientError::NoControl(_) => status::BAD_INPUT,
            ClientError::Refused(_) => status::REFUSED,
            _ => status::NO_TAKT,
        };
        Self { status, message: error.to_string() }
    }
}

/// Which PLC.
#[derive(clap::Args)]
pub struct Which {
    /// The partition file that Takt runs.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The partition; not needed if only one has programs.
    #[arg(long, value_name = "NAME")]
    partition: Option<String>,
    /// The control socket, if it is not that of the file.
    #[arg(long, value_name = "SOCKET")]
    control: Option<PathBuf>,
}

/// A PLC of a partition file.
pub struct Plc {
    file: PartitionFile,
    place: usize,
    control: Option<PathBuf>,
}

impl Which {
    /// Where the command has other arguments.
    pub fn new(file: PathBuf, partition: Option<String>, control: Option<PathBuf>) -> Self {
        Self { file, partition, control }
    }

    /// Reads the file.
    pub fn load(self) -> Result<Plc, Failure> {
        let file = takt_plan::load(&self.file, None).map_err(Failure::input)?;
        let has = |(_, p): &(usize, &Partition)| !p.programs().is_empty();
        let with: Vec<(usize, &Partition)> =
            file.partitions().iter().enumerate().filter(has).collect();
        let names: Vec<&str> = with.iter().map(|(_, p)| p.name()).collect();
        let found = match &self.partition {
            Some(name) => with.iter().find(|(_, p)| p.name() == name),
            None if with.len() == 1 => with.first(),
            None => None,
        };
        let Some((place, _)) = found else {
            return Err(Failure::input(match names[..] {
                [] => format!("no partition of {} has programs", self.file.display()),
                _ => format!("say which with --partition: {}", names.join(", ")),
            }));
        };
        Ok(Plc { place: *place, file, control: self.control })
    }
}

impl Plc {
    /// The partition.
    pub fn partition(&self) -> &Partition {
        &self.file.partitions()[self.place]
    }

    /// Times of the partition's windows. They may differ from window to window: the shortest counts.
    pub fn times(&self) -> Times {
        let schedules = self.file.schedules();
        let windows = schedules.tables().iter().flat_map(|t| t.windows_of(PartitionId(self.place)));
        let shortest = windows.map(|window| window.duration.0).min();
        Times { window_ns: shortest.unwrap_or_default(), frame_ns: schedules.frame().0 }
    }

    /// The points that these names and patterns mean, in their order. Each must mean one at least.
    pub fn points(&self, names: &[String]) -> Result<Vec<Point>, Failure> {
        let programs = self.partition().programs();
        let mut all = Vec::new();
        for name in names {
            let before = all.len();
            for (place, program) in (0..).zip(programs) {
                let Some(image) = program.image() else { continue };
                let found =
                    Search::run(&program.name, place, &image, name).map_err(Failure::input)?;
                all.extend(found);
            }
            if all.len() == before {
                let programs: Vec<&str> = programs.iter().map(|p| p.name.as_str()).collect();
                let text = format!(
                    "no value is named `{name}`: a name is PROGRAM.VARIABLE, the programs are {}; \
                     `takt plc points` lists all",
                    programs.join(", ")
                );
                return Err(Failure::input(text));
            }
        }
        Ok(all)
    }

    /// Connects to the Takt that runs it, and compares what runs with the images of the file.
    pub fn connect(&self) -> Result<Connected<'_>, Failure> {
        let socket = self.socket()?;
        let mut connected = self.reach()?;
        connected.compare(&socket)?;
        Ok(connected)
    }

    /// Connects for what does not depend on the images of the file.
    pub fn reach(&self) -> Result<Connected<'_>, Failure> {
        Ok(Connected { plc: self, takt: Connection::open(&self.socket()?)? })
    }

    fn socket(&self) -> Result<PathBuf, Failure> {
        match &self.control {
            Some(socket) => Ok(socket.clone()),
            None => Ok(takt_client::given(&self.file)?),
        }
    }
}

/// A PLC that runs.
pub struct Connected<'a> {
    plc: &'a Plc,
    takt: Connection,
}

impl Connected<'_> {
    fn compare(&mut self, socket: &Path) -> Result<(), Failure> {
        // The kernel tells of its programs half a second after its start at the latest.
        for _ in 0..ATTEMPTS {
            let partition = self.status()?;
            if partition.programs.iter().any(|program| program.image.is_none()) {
                continue;
            }
            let ours = self.plc.partition().programs();
            let same = |running: &takt_protocol::ProgramStatus,
                        (name, image): (&str, Image<'_>)| {
                running.name == name && running.image.as_ref() == Some(&hex(&image.hash()))
            };
            let images = ours.iter().filter_map(|p| Some((p.name.as_str(), p.image()?)));
            let differs = partition.programs.iter().zip(images).find(|(r, o)| !same(r, *o));
            if partition.programs.len() != ours.len() || differs.is_some() {
                let name = differs.map_or("a program", |(running, _)| &running.name);
                return Err(Failure::input(format!(
                    "the image of {name} in the file is not the one that runs behind {}, so its names would mean \
                     other places: use the partition file and the images that Takt was started with, or start \
                     the new ones",
                    socket.display()
                )));
            }
            return Ok(());
        }
        let message = "the PLC's kernel does not tell of its programs: it does not run, or no window leaves it time";
        Err(Failure { status: status::NO_TAKT, message: message.to_owned() })
    }

    fn status(&mut self) -> Result<takt_protocol::PartitionStatus, Failure> {
        let Answer::Status { status } = self.ask(&Request::Status)? else {
            return Err(strange());
        };
        let name = self.plc.partition().name();
        status.partitions.into_iter().find(|p| p.name == name).ok_or_else(|| {
            Failure::input(format!("the Takt that answers there runs no partition {name}"))
        })
    }

    /// Sends a request; its answer, if it is granted.
    pub fn ask(&mut self, request: &Request) -> Result<Answer, Failure> {
        self.takt.send(request)?;
        let answer = self.takt.receive()?.1;
        answer.granted().map_err(|refusal| ClientError::from(refusal).into())
    }

    /// Waits for the next values.
    pub fn values(&mut self) -> Result<Values, Failure> {
        self.takt.wait_for_ever()?;
        match self.takt.receive()?.1 {
            Answer::Values { values } => Ok(values),
            Answer::Error(refusal) => Err(ClientError::from(refusal).into()),
            _ => Err(strange()),
        }
    }

    /// The name of the partition, for requests.
    pub fn name(&self) -> String {
        self.plc.partition().name().to_owned()
    }
}

/// Requests for the status until the kernel has told of its programs: Takt answers one in 20 ms.
const ATTEMPTS: u32 = 100;

fn strange() -> Failure {
    ClientError::NotUnderstood("an answer to another question".to_owned()).into()
}

/// Of a line of values that is not as long as it must be.
pub fn not_asked_for() -> Failure {
    let message = "the values that came are not those that were asked for".to_owned();
    Failure { status: status::NO_TAKT, message }
}

/// The bytes of each point in a line of values.
pub fn cut<'v>(points: &[Point], bytes: &'v [u8]) -> Option<Vec<&'v [u8]>> {
    let mut rest = bytes;
    let mut all = Vec::with_capacity(points.len());
    for point in points {
        let (value, more) = rest.split_at_checked(point.range.bytes.into())?;
        all.push(value);
        rest = more;
    }
    rest.is_empty().then_some(all)
}

/// Bytes from their hexadecimal digits.
pub fn bytes(digits: &str) -> Option<Vec<u8>> {
    let pairs = digits.as_bytes().as_chunks::<2>();
    if !pairs.1.is_empty() {
        return None;
    }
    let byte = |pair: &[u8; 2]| {
        let digit = |c: u8| char::from(c).to_digit(16);
        Some((digit(pair[0])? << 4 | digit(pair[1])?) as u8)
    };
    pairs.0.iter().map(byte).collect()
}
