//! What of the windows one client is told.
//!
//! Windows come as fast as frames are short, and a client reads as fast as it likes. What does not
//! fit into a bounded backlog is not kept for later but counted: a gap in a picture does no harm if
//! it is known, and one client's gap is not another's. A trace has an end from its beginning, so
//! that a client that is never heard of again does not cost for ever.

use takt_scheduler::time::Nanos;

use super::protocol::{Answer, TracedWindow};

/// A trace that a client has asked for.
#[derive(Debug)]
pub(super) struct Tracing {
    until: Nanos,
    told: u64,
    dropped: u64,
    /// Those of `dropped` that the client does not know of.
    gap: u64,
}

impl Tracing {
    /// Up to this time since the epoch.
    pub fn new(until: Nanos) -> Tracing {
        Tracing { until, told: 0, dropped: 0, gap: 0 }
    }

    /// A window for which there is room.
    pub fn tell(&mut self, window: TracedWindow) -> Answer {
        self.told += 1;
        let dropped_before = std::mem::take(&mut self.gap);
        Answer::Window { window: TracedWindow { dropped_before, ..window } }
    }

    /// A window for which there is none.
    pub fn drop_one(&mut self) {
        self.dropped += 1;
        self.gap += 1;
    }

    /// The end, once it has come.
    pub fn end(&self, now: Nanos) -> Option<Answer> {
        let Tracing { until, told: windows, dropped, .. } = *self;
        (now >= until).then_some(Answer::Traced { windows, dropped })
    }
}
