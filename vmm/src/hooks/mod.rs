//! What only tests of whole machines ask of Takt: a start that fails, a panic, a wake-up that comes late.
//!
//! The cargo feature `test-hooks` decides. Without it, as users build Takt, [`Hooks`] has no options and does
//! nothing, so that no word on a command line can make a running plant fail. `tests/tests/binary.rs` looks for the
//! names of the hooks in both builds. The rest of Takt is the same with and without the feature: it calls the
//! hooks at the same places.

#[cfg(not(feature = "test-hooks"))]
mod absent;
#[cfg(feature = "test-hooks")]
mod forbidden_call;
#[cfg(feature = "test-hooks")]
mod present;

#[cfg(not(feature = "test-hooks"))]
pub use absent::{Hooks, LateWakeUp, Steps, clock_may_be_steered};
#[cfg(feature = "test-hooks")]
pub use present::{Hooks, LateWakeUp, Steps, clock_may_be_steered};
