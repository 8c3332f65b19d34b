//! Time as the blocks keep it: whole nanoseconds, as `TIME` and `LTIME` of a program do.

use core::time::Duration;

/// Nanoseconds; longer than 584 years counts as 584 years.
pub(crate) const fn nanoseconds(duration: Duration) -> u64 {
    let nanoseconds = duration.as_nanos();
    if nanoseconds > u64::MAX as u128 { u64::MAX } else { nanoseconds as u64 }
}
