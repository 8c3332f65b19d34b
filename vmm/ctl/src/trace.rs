//! A trace of the windows from now on, as a file for a viewer of time lines.
//!
//! Takt tells of each window, and this program draws it, with the code that `takt run --trace` uses.
//! So Takt neither opens a file for a client nor waits for a disk. Windows that it could not get rid
//! of are missing in the picture, and are said to be.

use std::io::{BufWriter, Write};
use std::time::Duration;

use takt_figures::trace::Trace;
use takt_protocol::{Answer, Request, TraceStart, TracedWindow};
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Tsc};

use takt_client::{ClientError, Connection, PATIENCE};

/// What a trace has of the windows of its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Those that are in it.
    pub windows: u64,
    /// Those that are missing.
    pub dropped: u64,
}

/// Writes a trace of this length; or, for a program that draws by itself, the answers as they come.
///
/// # Errors
/// If Takt refuses or goes, if it says what cannot be, or if `out` fails.
pub fn record(
    takt: &mut Connection,
    length: Nanos,
    json: bool,
    out: impl Write,
) -> Result<Extent, ClientError> {
    // Without windows nothing comes until the end.
    takt.wait_for(Duration::from_nanos(length.0) + PATIENCE)?;
    takt.send(&Request::Trace(length))?;
    let mut out = BufWriter::new(out);
    if json {
        loop {
            let (line, answer) = takt.receive()?;
            out.write_all(line.as_bytes()).map_err(ClientError::Output)?;
            if let Some(extent) = end(answer)? {
                out.flush().map_err(ClientError::Output)?;
                return Ok(extent);
            }
        }
    }
    let Answer::Trace { trace: start } = takt.receive()?.1.granted()? else {
        return Err(strange("a trace does not begin with its start"));
    };
    let mut trace = begin(&start, &mut out).ok_or_else(|| strange("the clock has no speed"))?;
    loop {
        match takt.receive()?.1.granted()? {
            Answer::Window { window } => {
                add(&mut trace, &start, &window).ok_or_else(|| strange("an impossible window"))?;
            }
            Answer::Switch { at_tsc, schedule } => {
                let schedule = start.schedule(&schedule);
                let schedule = schedule.ok_or_else(|| strange("an unknown schedule"))?;
                trace.switch(Tsc(at_tsc), schedule);
            }
            answer => {
                if let Some(extent) = end(answer)? {
                    trace.finish().map_err(ClientError::Output)?;
                    return Ok(extent);
                }
            }
        }
    }
}

fn begin<W: Write>(start: &TraceStart, out: W) -> Option<Trace<W>> {
    let cpu = |cpu: u64| Some(Cpu(usize::try_from(cpu).ok()?));
    let partitions = start.partitions.iter().map(|p| Some((p.name.as_str(), cpu(p.cpu)?)));
    let partitions = partitions.collect::<Option<Vec<_>>>()?;
    let schedules: Vec<&str> = start.schedules.iter().map(String::as_str).collect();
    let (since, schedule) = (Tsc(start.since_tsc), start.schedule(&start.schedule)?);
    Some(Trace::since(out, start.base()?, &partitions, &schedules, since, schedule))
}

fn add<W: Write>(trace: &mut Trace<W>, start: &TraceStart, told: &TracedWindow) -> Option<()> {
    let (partition, window, detours) = told.record(start)?;
    trace.add(partition, &window, &detours);
    Some(())
}

/// The end, if this answer is it.
fn end(answer: Answer) -> Result<Option<Extent>, ClientError> {
    Ok(match answer.granted()? {
        Answer::Traced { windows, dropped } => Some(Extent { windows, dropped }),
        _ => None,
    })
}

fn strange(what: &str) -> ClientError {
    ClientError::NotUnderstood(what.to_owned())
}
