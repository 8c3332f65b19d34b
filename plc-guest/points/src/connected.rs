//! A PLC that runs, through a connection to its Takt.

use std::io::ErrorKind;
use std::os::fd::RawFd;
use std::path::Path;
use std::time::Duration;

use takt_client::{ClientError, Connection};
use takt_protocol::{Answer, PartitionStatus, Request, Values};

use crate::{Error, Plc};

/// A PLC that runs.
pub struct Connected<'a> {
    plc: &'a Plc,
    takt: Connection,
}

impl<'a> Connected<'a> {
    pub(crate) fn new(plc: &'a Plc, takt: Connection) -> Self {
        Self { plc, takt }
    }

    pub(crate) fn compare(&mut self, socket: &Path) -> Result<(), Error> {
        // The kernel tells of its programs half a second after its start at the latest.
        for _ in 0..ATTEMPTS {
            let partition = self.status()?;
            if self.plc.compare(&partition, socket)?.is_some() {
                return Ok(());
            }
        }
        Err(Error::Silent(
            "the PLC's kernel does not tell of its programs: it does not run, or no window leaves it time",
        ))
    }

    fn status(&mut self) -> Result<PartitionStatus, Error> {
        let Answer::Status { status } = self.ask(&Request::Status)? else {
            return Err(strange());
        };
        let name = self.plc.name();
        status.partitions.into_iter().find(|p| p.name == name).ok_or_else(|| {
            Error::Input(format!("the Takt that answers there runs no partition {name}"))
        })
    }

    /// Sends a request; its answer, if it is granted.
    ///
    /// # Errors
    /// If it is not, or the connection is lost.
    pub fn ask(&mut self, request: &Request) -> Result<Answer, Error> {
        self.takt.send(request)?;
        let answer = self.takt.receive()?.1;
        answer.granted().map_err(|refusal| ClientError::from(refusal).into())
    }

    /// Waits for the next values.
    ///
    /// # Errors
    /// If the watch has ended, or the connection is lost.
    pub fn values(&mut self) -> Result<Values, Error> {
        self.takt.wait_for_ever()?;
        self.next_values()
    }

    /// The same for at most this time; `None` if nothing comes. What follows then may be the rest of a line.
    ///
    /// # Errors
    /// If the watch has ended, or the connection is lost.
    pub fn values_within(&mut self, time: Duration) -> Result<Option<Values>, Error> {
        self.takt.wait_for(time)?;
        match self.next_values() {
            Err(Error::Client(ClientError::Lost(error))) if error.kind() == ErrorKind::TimedOut => {
                Ok(None)
            }
            other => other.map(Some),
        }
    }

    fn next_values(&mut self) -> Result<Values, Error> {
        match self.takt.receive()?.1 {
            Answer::Values { values } => Ok(values),
            Answer::Error(refusal) => Err(ClientError::from(refusal).into()),
            _ => Err(strange()),
        }
    }

    /// The number of the connection's descriptor, as long as it is open.
    #[must_use]
    pub fn descriptor(&self) -> RawFd {
        self.takt.descriptor()
    }

    /// The name of the partition, for requests.
    #[must_use]
    pub fn name(&self) -> String {
        self.plc.name().to_owned()
    }
}

/// Requests for the status until the kernel has told of its programs: Takt answers one in 20 ms.
const ATTEMPTS: u32 = 100;

fn strange() -> Error {
    ClientError::NotUnderstood("an answer to another question".to_owned()).into()
}
