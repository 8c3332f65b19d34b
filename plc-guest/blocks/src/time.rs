//! Time as the blocks keep it: whole nanoseconds, as `TIME` and `LTIME` of a program do.

use core::time::Duration;

/// Nanoseconds; longer than 584 years counts as 584 years.
pub(crate) fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
