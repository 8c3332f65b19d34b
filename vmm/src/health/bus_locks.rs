//! Bus locks: an instruction of a guest's that keeps all processors from memory.
//!
//! A locked access that crosses two cache lines, or goes to uncached memory, is made by locking the bus: for some
//! thousand cycles no other processor gets at memory. A program of a Linux on another CPU can make a PLC's scan longer
//! with it, as often as it likes, and no schedule separates the two. Processors since Intel's Sapphire Rapids leave the
//! guest for each (`Documentation/virt/kvm/api.rst`, `KVM_CAP_X86_BUS_LOCK_EXIT`), which makes them rarer and lets Takt
//! count them.
//!
//! How many are an error says the partition file. A span begins with the first bus lock after the last span is over, so
//! that nothing has to be kept of those before.

use std::time::Instant;

use kvm_bindings::{KVM_BUS_LOCK_DETECTION_EXIT, KVM_CAP_X86_BUS_LOCK_EXIT, kvm_enable_cap};
use kvm_ioctls::{Kvm, VcpuFd, VmFd};
use takt_plan::BusLockLimit;

/// In `kvm_run.flags`: this exit, whatever else it is, comes with a bus lock.
use kvm_bindings::KVM_RUN_X86_BUS_LOCK;

/// Whether KVM can tell of them.
#[must_use]
pub fn are_told(kvm: &Kvm) -> bool {
    let modes = kvm.check_extension_raw(KVM_CAP_X86_BUS_LOCK_EXIT.into());
    modes & KVM_BUS_LOCK_DETECTION_EXIT.cast_signed() != 0
}

/// Makes each an exit; before the machine has a processor.
///
/// # Errors
/// What KVM says.
pub fn tell(vm: &VmFd) -> Result<(), kvm_ioctls::Error> {
    let mut exits = kvm_enable_cap { cap: KVM_CAP_X86_BUS_LOCK_EXIT, ..Default::default() };
    exits.args[0] = KVM_BUS_LOCK_DETECTION_EXIT.into();
    vm.enable_cap(&exits)
}

/// Whether the last exit came with one.
pub fn happened(vcpu: &mut VcpuFd) -> bool {
    u32::from(vcpu.get_kvm_run().flags) & KVM_RUN_X86_BUS_LOCK != 0
}

/// Counts the bus locks of one partition.
#[derive(Debug, Default)]
pub struct BusLocks {
    limit: Option<BusLockLimit>,
    /// When the span began, and how many there have been in it.
    span: Option<(Instant, u32)>,
}

impl BusLocks {
    /// With the limit of the partition file.
    #[must_use]
    pub fn new(limit: Option<BusLockLimit>) -> Self {
        Self { limit, span: None }
    }

    /// Counts one, and tells whether it is one too many.
    pub fn count(&mut self, now: Instant) -> bool {
        let Some(BusLockLimit { at_most, within }) = self.limit else { return true };
        let (start, before) = match self.span {
            Some((start, count)) if now.duration_since(start).as_nanos() < within.0.into() => {
                (start, count)
            }
            _ => (now, 0),
        };
        let count = before.saturating_add(1);
        self.span = Some((start, count));
        count > at_most
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use takt_scheduler::time::Nanos;

    #[test]
    fn without_a_limit_each_is_one_too_many() {
        let now = Instant::now();
        let mut locks = BusLocks::new(None);
        assert!(locks.count(now) && locks.count(now));
    }

    #[test]
    fn as_many_as_are_allowed_are_no_error_in_each_span() {
        let start = Instant::now();
        let limit = BusLockLimit { at_most: 2, within: Nanos::from_millis(10) };
        let mut locks = BusLocks::new(Some(limit));
        let mut at = |ms| locks.count(start + Duration::from_millis(ms));
        assert_eq!([at(0), at(9), at(9), at(9)], [false, false, true, true]);
        // The next span begins with the first one in it.
        assert_eq!([at(15), at(24), at(24), at(25)], [false, false, true, false]);
        // A clock that stands still, or is behind, begins nothing anew.
        assert_eq!([at(24), at(24)], [false, true]);
    }

    #[test]
    fn none_at_all_may_be_allowed() {
        let limit = BusLockLimit { at_most: 0, within: Nanos::from_millis(10) };
        assert!(BusLocks::new(Some(limit)).count(Instant::now()));
    }
}
