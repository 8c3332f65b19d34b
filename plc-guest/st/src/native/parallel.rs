//! Routines are compiled by as many threads as there are processors: code generation takes most of the time of a build.
//!
//! Each routine is compiled by itself, and the results are put back into the order of the routines, so the image does
//! not depend on which thread was faster.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use super::NativeError;
use crate::limits;

/// More threads than this bring nothing: what is left is done by one.
const THREADS: usize = 16;
/// Fewer routines than this for a thread are not worth one.
const ROUTINES: usize = 16;

/// Calls `work` for each index below `count`, and gives the results in their order, or the error of the least index
/// that has one. Each thread has a state of its own.
pub fn map<S, T: Send>(
    count: usize,
    state: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, usize) -> Result<T, NativeError> + Sync,
) -> Result<Vec<T>, NativeError> {
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let threads = processors.min(THREADS).min(count / ROUTINES).max(1);
    let next = AtomicUsize::new(0);
    let share = || {
        let (mut state, mut done) = (state(), Vec::new());
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return done;
            }
            done.push((index, work(&mut state, index)));
        }
    };
    if threads == 1 {
        return share().into_iter().map(|(_, result)| result).collect();
    }
    let mut all = thread::scope(|scope| {
        let start = || thread::Builder::new().stack_size(limits::STACK).spawn_scoped(scope, share);
        let running: Vec<_> = (0..threads).map(|_| start()).collect();
        let mut all = Vec::with_capacity(count);
        for thread in running {
            let thread = thread.map_err(NativeError::Thread)?;
            // A panic goes on where it would have gone without the thread.
            all.extend(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        Ok(all)
    })?;
    all.sort_unstable_by_key(|(index, _)| *index);
    all.into_iter().map(|(_, result)| result).collect()
}
