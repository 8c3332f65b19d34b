//! What an end has seen of the other one: the account that the health monitor can look at.

/// Events at one end since it was opened. They stop at the largest number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Starts of the other end that were noticed; several between two looks count once.
    pub peer_starts: u64,
    /// Values read from the other end that cannot be true.
    pub hostile: u64,
    /// Reads given up because the source wrote too fast, or pretended to.
    pub unstable: u64,
    /// Messages that the source overwrote before this destination took them.
    pub lost: u64,
}

/// Adds one without overflow.
pub(crate) fn count(counter: &mut u64) {
    *counter = counter.saturating_add(1);
}

/// Notices that the other end has started again.
///
/// Nothing depends on it for safety: the positions in the regions say by themselves what is void
/// after a restart. It is there to be told.
#[derive(Debug)]
pub(crate) struct EpochWatch {
    last: u64,
}

impl EpochWatch {
    pub(crate) fn new(epoch: u64) -> Self {
        EpochWatch { last: epoch }
    }

    pub(crate) fn look(&mut self, epoch: u64, counters: &mut Counters) {
        if epoch != self.last {
            self.last = epoch;
            count(&mut counters.peer_starts);
        }
    }

    pub(crate) fn last(&self) -> u64 {
        self.last
    }
}
