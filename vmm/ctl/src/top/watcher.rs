//! What fetches the values of the page.
//!
//! It has a connection of its own. Takt tells a client unasked that its watch has ended, and on a connection that asks for other
//! things such a line would be taken for the refusal of one of them. While another page is shown there is no watch: what it
//! looks at is part of the budget that all clients share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use takt_client::{ClientError, Connection};
use takt_points::{Error, Plc, Point, ranges, texts};
use takt_protocol::{Answer, Request, Status};
use takt_scheduler::time::Nanos;

use super::view::Watched;

/// Watches what the user has named.
pub struct Watcher {
    file: PathBuf,
    names: Vec<String>,
    plcs: Vec<(Plc, Vec<Point>)>,
    takt: Option<Connection>,
    interval: Nanos,
}

impl Watcher {
    /// For these names and patterns of the partition file, each of which must mean a value. A line comes once in `period` at most.
    pub fn new(file: &Path, names: &[String], period: Duration) -> Result<Self, ClientError> {
        let interval = Nanos(u64::try_from(period.as_nanos()).unwrap_or(u64::MAX));
        let (file, names) = (file.to_owned(), names.to_vec());
        let mut watcher = Self { file, names, plcs: Vec::new(), takt: None, interval };
        watcher.read().map_err(usage)?;
        Ok(watcher)
    }

    /// The points of each partition, without values.
    pub fn watched(&self) -> Vec<Watched> {
        let watched = |(plc, points): &(Plc, Vec<Point>)| Watched {
            partition: plc.name().to_owned(),
            points: points.clone(),
            latest: None,
        };
        self.plcs.iter().map(watched).collect()
    }

    /// Takes the names from the file and its images as they are now.
    fn read(&mut self) -> Result<(), Error> {
        let plcs = Plc::all(&self.file, None)?;
        let mut found: Vec<(Plc, Vec<Point>)> =
            plcs.iter().map(|plc| (plc.clone(), Vec::new())).collect();
        for name in &self.names {
            let mut any = false;
            for (plc, points) in &mut found {
                let more = plc.search(name)?;
                any |= !more.is_empty();
                points.extend(more);
            }
            if !any {
                return Err(Plc::unknown(name, &plcs));
            }
        }
        found.retain(|(_, points)| !points.is_empty());
        self.plcs = found;
        Ok(())
    }

    /// Takes the latest line of each partition. After an error the next call begins anew.
    pub fn update(&mut self, socket: &Path, watched: &mut Vec<Watched>) -> Result<(), ClientError> {
        if self.plcs.is_empty() {
            return Ok(());
        }
        let mut takt = match self.takt.take() {
            Some(takt) => takt,
            None => self.begin(socket, watched)?,
        };
        // All lines that came before the answer have been sent by now, so this never waits for a PLC.
        takt.send(&Request::Ping)?;
        loop {
            match takt.receive()?.1 {
                Answer::Done { .. } => break,
                Answer::Error(refusal) => return Err(refusal.into()),
                Answer::Values { values } => {
                    let Some(watched) =
                        watched.iter_mut().find(|w| w.partition == values.partition)
                    else {
                        continue;
                    };
                    let texts = texts(&watched.points, &values).map_err(usage)?;
                    watched.latest = Some((values, texts));
                }
                _ => {}
            }
        }
        self.takt = Some(takt);
        Ok(())
    }

    /// Watches no longer.
    pub fn rest(&mut self) {
        self.takt = None;
    }

    fn begin(
        &mut self,
        socket: &Path,
        watched: &mut Vec<Watched>,
    ) -> Result<Connection, ClientError> {
        let mut takt = Connection::open(socket)?;
        // It may be another Takt, whose PLCs have not told of any value yet.
        watched.iter_mut().for_each(|watched| watched.latest = None);
        takt.send(&Request::Status)?;
        let status = match takt.receive()?.1.granted()? {
            Answer::Status { status } => status,
            _ => return Err(strange()),
        };
        if let Err(error) = self.fits(&status, socket) {
            // Another version may run, and its image may lie in the file's place by now.
            self.read().map_err(usage)?;
            *watched = self.watched();
            self.fits(&status, socket).map_err(|_| usage(error))?;
        }
        for (plc, points) in &self.plcs {
            takt.send(&Request::Watch {
                partition: plc.name().to_owned(),
                ranges: ranges(points),
                interval: self.interval,
            })?;
            loop {
                match takt.receive()?.1.granted()? {
                    Answer::Watching { .. } => break,
                    // Of the partition before.
                    Answer::Values { .. } => {}
                    _ => return Err(strange()),
                }
            }
        }
        Ok(takt)
    }

    /// Whether the names are those of what runs.
    fn fits(&self, status: &Status, socket: &Path) -> Result<(), Error> {
        for (plc, _) in &self.plcs {
            let running = status.partitions.iter().find(|p| p.name == plc.name());
            let running = running.ok_or_else(|| {
                Error::Input(format!(
                    "the Takt that answers there runs no partition {}",
                    plc.name()
                ))
            })?;
            if plc.compare(running, socket)?.is_none() {
                return Err(Error::Silent("the PLC's kernel has not told of its programs yet"));
            }
        }
        Ok(())
    }
}

fn usage(error: Error) -> ClientError {
    match error {
        Error::Client(error) => error,
        other => ClientError::Usage(other.to_string()),
    }
}

fn strange() -> ClientError {
    ClientError::NotUnderstood("an answer to another question".to_owned())
}
