//! A partition that does not come to what must follow: its guest does not leave, or does not start again.
//!
//! The supervisor waits for no thread. So a thread that the host's kernel keeps, in a call for a device or for storage that is
//! gone, would be noticed by nothing: the health monitor learns of an end only from the thread itself.

use std::mem;

use takt_scheduler::time::Nanos;

/// What does not come within this time is told.
const PATIENCE: Nanos = Nanos::from_millis(1_000);

/// What a partition is to come to, and for how long.
#[derive(Debug, Default)]
pub struct Delay {
    /// What is told of it.
    awaited: Option<&'static str>,
    since: Nanos,
    told: bool,
}

impl Delay {
    /// Takes note of what is awaited now. Gives it back once, when it has taken too long.
    pub fn look(&mut self, awaited: Option<&'static str>, now: Nanos) -> Option<&'static str> {
        if self.awaited != awaited {
            *self = Self { awaited, since: now, told: false };
        }
        let early = now.less(self.since) < PATIENCE;
        awaited.filter(|_| !early && !mem::replace(&mut self.told, true))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_come_is_told_once_each_time() {
        let mut delay = Delay::default();
        let mut look = |awaited, ms| delay.look(awaited, Nanos::from_millis(ms));
        assert_eq!(look(None, 5_000), None);
        assert_eq!(look(Some("leave"), 5_020), None);
        assert_eq!(look(Some("leave"), 6_000), None);
        assert_eq!(look(Some("leave"), 6_020), Some("leave"));
        assert_eq!(look(Some("leave"), 60_000), None);
        // What follows has a time of its own.
        assert_eq!(look(Some("start"), 60_020), None);
        assert_eq!(look(Some("start"), 61_020), Some("start"));
        assert_eq!(look(None, 61_040), None);
        assert_eq!(look(Some("start"), 61_060), None);
        assert_eq!(look(None, 62_060), None, "it has come in time");
        assert_eq!(look(Some("start"), 62_080), None);
        assert_eq!(look(Some("start"), 63_080), Some("start"));
    }
}
