//! Makes threads that run already of the class SCHED_BATCH: when one of them wakes, it does not preempt what runs.
//!
//!     batch THREAD...

use std::env;
use std::io;

fn main() -> io::Result<()> {
    for thread in env::args().skip(1) {
        let thread = thread.parse().map_err(io::Error::other)?;
        let priority = libc::sched_param { sched_priority: 0 };
        // SAFETY: the kernel reads the live structure.
        let result =
            unsafe { libc::sched_setscheduler(thread, libc::SCHED_BATCH, &raw const priority) };
        if result < 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}
