//! `takt run`: from a partition file to a report.
//!
//! Everything that can fail is done before the first guest instruction: memory, machines, images,
//! threads with their reservations. Then all partitions start from one epoch, and from there on
//! nothing is allocated or mapped for a guest.
//!
//! A run has stages. Each is a type that is made of the one before it and consumes it, so nothing can be used before
//! it is there, or after it has been given back:
//!
//! ```text
//!  Held, Begun   what is taken of the host              held.rs      may fail: what was
//!     |                                                              taken by then is
//!  Waiting       machines, images, waiting threads      waiting.rs   given back
//!     |
//!  Running       all threads know the epoch             start.rs
//!     |
//!  Ended         all guests have left; the report       ending.rs
//! ```
//!
//! `Held` outlives the others: devices, CPUs and files go back when no thread can use them any more. A Linux's thread that a program of
//! the host holds up in the kernel ([`vhost`](crate::vhost)) has been told to stop, and uses none of them.

mod ending;
mod epoch;
mod held;
mod options;
mod output;
mod own_process;
mod result;
mod start;
mod this_host;
mod waiting;

use std::time::Duration;

use held::Held;
pub use options::{Options, duration};
use start::Running;
use waiting::Waiting;

use crate::config::{Channel, PartitionFile, live_channels};
use crate::report::Report;
use crate::run_error::RunError;
use crate::sandbox::Kind;
use crate::vcpu::thread::{self, ThreadError};

/// Runs all partitions of `file` until the run is over.
///
/// # Errors
/// See [`RunError`]. A partition that fails is not an error of the run: the report tells of it.
pub fn run(file: &PartitionFile, options: &Options) -> Result<Report, RunError> {
    let queues: Vec<Channel> =
        file.partitions().iter().filter_map(live_channels).flatten().collect();
    let (held, begun) = Held::take(file, &queues, options)?;
    let waiting = Waiting::make(file, options, &held, begun)?;
    waiting.start().and_then(Running::watch)?.tell()
}

/// What starts threads that have no part in the schedule.
fn spawner(
    options: &Options,
) -> impl Fn(&str, Kind, Box<dyn FnOnce() + Send>) -> Result<(), ThreadError> + use<> {
    let mode = options.seccomp;
    move |name, kind, work| thread::detached(name, (kind, mode), work)
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
