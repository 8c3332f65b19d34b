//! State that one task uses at a time.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

/// A value that one task uses, such as its function blocks.
///
/// ```ignore
/// static FILTER: Local<Filter> = Local::new(Filter::new());
/// FILTER.with(|filter| filter.step(x));
/// ```
pub struct Local<T> {
    busy: AtomicBool,
    value: UnsafeCell<T>,
}

// SAFETY: `with` lets one user in at a time, whichever task it is.
unsafe impl<T: Send> Sync for Local<T> {}

impl<T> Local<T> {
    /// A value with this initial state.
    pub const fn new(value: T) -> Self {
        Self { busy: AtomicBool::new(false), value: UnsafeCell::new(value) }
    }

    /// Gives the value to `f`.
    ///
    /// # Panics
    /// If it is in use: another task was interrupted while it used it, or `f` asks for it again. A
    /// task that always stops instead of computing with a half-changed value is the aim.
    pub fn with<R>(&self, f: impl FnOnce(&mut T) -> R) -> R {
        assert!(!self.busy.swap(true, Ordering::Acquire), "a Local is used by two tasks at a time");
        // SAFETY: `busy` was false and is true until the reference is gone.
        let result = f(unsafe { &mut *self.value.get() });
        self.busy.store(false, Ordering::Release);
        result
    }
}
