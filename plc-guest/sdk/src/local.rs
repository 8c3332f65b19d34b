//! State that one task uses at a time.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU64, Ordering};

use crate::job;

/// A value that one task uses, such as its function blocks.
///
/// ```ignore
/// static FILTER: Local<Filter> = Local::new(Filter::new());
/// FILTER.with(|filter| filter.step(x));
/// ```
///
/// No point has it, so a program with one is not changed while it runs.
///
/// A job that ends in the middle, because its budget or its deadline is over and the program's rows say `skip`, leaves
/// the value as it is then, and the next job of the task goes on with it.
pub struct Local<T> {
    /// The job that uses it, or [`FREE`].
    user: AtomicU64,
    value: UnsafeCell<T>,
}

const FREE: u64 = 0;

// SAFETY: `with` lets one user in at a time, whichever task it is.
unsafe impl<T: Send> Sync for Local<T> {}

impl<T> Local<T> {
    /// A value with this initial state.
    pub const fn new(value: T) -> Self {
        Self { user: AtomicU64::new(FREE), value: UnsafeCell::new(value) }
    }

    /// Gives the value to `f`.
    ///
    /// # Panics
    /// If it is in use: another task was interrupted while it used it, or `f` asks for it again. A
    /// task that always stops instead of computing with a half-changed value is the aim.
    pub fn with<R>(&self, f: impl FnOnce(&mut T) -> R) -> R {
        let own = job::running();
        let user = self.user.load(Ordering::Acquire);
        let free = user == FREE || (user != own && job::is_abandoned(user, own));
        // Another task may have come in between.
        let taken = free
            && self.user.compare_exchange(user, own, Ordering::Acquire, Ordering::Relaxed).is_ok();
        assert!(taken, "a Local is used by two tasks at a time, or twice by one");
        // SAFETY: no other user has it, nor will until the reference is gone: each looks at `user` first, and finds this job.
        // A job that was abandoned does not run again, so it uses its reference no more.
        let result = f(unsafe { &mut *self.value.get() });
        self.user.store(FREE, Ordering::Release);
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::pretend;

    #[test]
    fn the_next_job_of_a_task_takes_over_from_one_that_was_abandoned() {
        let local = Local::new(0);
        pretend(1, &[(1, 5), (2, 3)]);
        let abandoned = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            local.with(|value| {
                *value = 7;
                // The job goes no further.
                std::panic::resume_unwind(Box::new(()));
            })
        }));
        assert!(abandoned.is_err());
        pretend(1, &[(1, 6), (2, 3)]);
        assert_eq!(local.with(|value| *value), 7);
        assert_eq!(local.with(|value| *value), 7);
    }

    #[test]
    #[should_panic(expected = "used by two tasks at a time")]
    fn a_task_that_interrupts_the_user_is_refused() {
        let local = Local::new(0);
        pretend(1, &[(1, 5), (2, 3)]);
        local.with(|_| {
            pretend(2, &[(1, 5), (2, 3)]);
            local.with(|_| ());
        });
    }

    #[test]
    #[should_panic(expected = "twice by one")]
    fn the_user_itself_is_refused() {
        let local = Local::new(0);
        pretend(0, &[(0, 0)]);
        local.with(|_| local.with(|_| ()));
    }
}
