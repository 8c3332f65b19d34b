//! A PLC while it runs, for the commands that look at it: which one the user means, and what can go wrong.
//!
//! Names, connection and lines of values are `takt-points`, which `takt top` uses as well.

pub mod interrupt;
pub mod output;
pub mod plot;
pub mod recording;
pub mod trigger;
pub mod written;

use std::path::PathBuf;
use std::time::Duration;

use takt_client::ClientError;
use takt_points::{Connected, Error, Plc};
use takt_protocol::Values;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::Nanos;

use crate::Failure;
use crate::shadow::Times;
use crate::status;

/// Exit status: what was given is bad, Takt refuses, or none answers.
impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let status = match error {
            ClientError::File(_)
            | ClientError::NoControl(_)
            | ClientError::Usage(_)
            | ClientError::Image { .. }
            | ClientError::Output(_)
            | ClientError::Terminal(_) => status::BAD_INPUT,
            ClientError::Refused(_) => status::REFUSED,
            ClientError::NoTakt { .. } | ClientError::Lost(_) | ClientError::NotUnderstood(_) => {
                status::NO_TAKT
            }
        };
        Self { status, message: error.to_string() }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Client(error) => error.into(),
            Error::Input(message) => Self::input(message),
            Error::Silent(message) => Self { status: status::NO_TAKT, message: message.to_owned() },
        }
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

impl Which {
    /// Where the command has other arguments.
    pub fn new(file: PathBuf, partition: Option<String>, control: Option<PathBuf>) -> Self {
        Self { file, partition, control }
    }

    /// Reads the file.
    pub fn load(self) -> Result<Plc, Failure> {
        Ok(Plc::one(&self.file, self.partition.as_deref(), self.control.as_deref())?)
    }
}

/// How much later than its cycle a line may come.
const BEHIND: Duration = Duration::from_secs(5);

/// The next values for a command that ends so long after the last ones. `None` if no more come, which is told. Without
/// such a time it waits for as long as it takes.
pub fn values(
    connected: &mut Connected<'_>,
    left: Option<Nanos>,
) -> Result<Option<Values>, Failure> {
    let Some(left) = left else { return Ok(Some(connected.values()?)) };
    let time = Duration::from_nanos(left.0).saturating_add(BEHIND);
    let values = connected.values_within(time)?;
    if values.is_none() {
        tell!(
            "takt plc: no values have come for {} s, so this ends without the rest: the PLC has stopped, or has no windows, or \
             none that leaves time for it",
            time.as_secs()
        );
    }
    Ok(values)
}

/// Times of a partition's windows. They may differ from window to window: the shortest counts.
pub fn times(plc: &Plc) -> Times {
    let schedules = plc.file().schedules();
    let windows = schedules.tables().iter().flat_map(|t| t.windows_of(PartitionId(plc.place())));
    let shortest = windows.map(|window| window.duration.0).min();
    Times { window_ns: shortest.unwrap_or_default(), frame_ns: schedules.frame().0 }
}
