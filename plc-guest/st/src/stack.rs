//! Room on the stack for walking trees.
//!
//! All stages walk trees by recursion. How deep they go is bounded (see [`limits`]), but a thread of a caller may have
//! less stack than that takes.

use crate::limits;

/// Does this on a thread that has enough stack for any stage of the compiler.
///
/// # Errors
///
/// If the system has no room for a thread.
pub fn with_room<T: Send>(work: impl FnOnce() -> T + Send) -> std::io::Result<T> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(limits::STACK);
        let working = thread.spawn_scoped(scope, work)?;
        // A panic goes on where it would have gone without the thread.
        Ok(working.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}
