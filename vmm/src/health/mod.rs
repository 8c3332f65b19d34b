//! The health monitor: what is done about a partition's errors.
//!
//! A guest must not decide what its own failure means, and neither should the code that happens to
//! see it first. So whatever goes wrong becomes one of a few errors with ARINC 653's names
//! ([`Fault`]), and a table of the partition file, one row for each partition and error, says what
//! follows ([`Table`]). The rest of Takt only reports and obeys.
//!
//! ```text
//!  vCPU thread                                       supervisor thread
//!  error, guest can go on ---> Reporter --ring--->   Watch: line, report
//!     the table has worse than `log`: the guest ends
//!  guest ends --------------------------------->     Watch, by Monitor: which action
//!                                                    Life: what follows
//! ```
//!
//! An error that the guest survives costs its thread a count and an entry in a ring; the thread does not
//! wait and does not print. Whether a partition is started again is decided where there is
//! time for it, and only there: `Monitor` knows how often that has happened already.

pub mod bus_locks;
mod detail;
mod mapping;
mod monitor;
mod reporter;
mod watch;

pub use detail::{Access, ClockFault, Detail, Target, Text};
pub use reporter::{Answer, Counts, Occurrence, Reporter};
pub use takt_plan::health::{ACTIONS, Action, FAULTS, Fault, Limit, Table};
pub use watch::Watch;
