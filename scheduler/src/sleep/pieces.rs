//! How a sleep is divided, and where the wake-ups between its pieces come.
//!
//! A wake-up within a window of another partition would take time from that one, or wait until it ends. So it comes
//! before such a window or behind it, if the thread is no lazy one and trusts the clock.

use crate::quiet::WAKE_UP;
use crate::time::{Nanos, Tsc};

use super::{
    CLOSE, LAZY, OFF_A_RELEASE, PIECE_MIN, SHORT, SHORTER, SURE, Sleeper, Steering, WHOLE,
};

impl Sleeper {
    /// How long to sleep first, if not to the end.
    pub(super) fn piece(&self, now: Tsc, instant: Tsc, remaining: Nanos) -> Option<Nanos> {
        let trusted = self.distrust == 0;
        let short = if trusted || self.lazy { SHORT } else { SHORTER };
        let whole = match (trusted, self.steering) {
            _ if self.surely => SURE,
            (true, Steering::Impossible) => WHOLE,
            (true, Steering::Possible) if self.lazy => LAZY,
            _ if self.lazy && self.woken_for == Some(instant) => LAZY,
            _ => short,
        };
        if remaining <= whole {
            return None;
        }
        // What is left must be worth a piece of its own.
        let leave = Nanos(remaining.0.div_ceil(9)).max(Nanos(short.0 / 2));
        let wanted = remaining.less(leave);
        let Some(rest) = &self.rest else { return Some(wanted) };
        let at = now.after(self.frequency.ticks(wanted));
        let useful = |place: Option<Tsc>, most_left: Nanos| {
            let piece = self.frequency.nanos(place.filter(|place| *place > now)?.since(now));
            (piece >= PIECE_MIN && remaining.less(piece) <= most_left).then_some(piece)
        };
        let near = remaining <= LAZY && !self.surely;
        let patient = trusted && near;
        // Only here: a longer sleep would have more pieces by this, for which its budget has no room.
        let clear = if patient { useful(rest.before(at, rest.followed), CLOSE) } else { None };
        let place = clear.or_else(|| match (patient, self.lazy && near) {
            // A sleep that is short enough for a last piece is not divided at the price of a second interrupt.
            (true, _) if remaining <= CLOSE => None,
            // It wakes once.
            (false, true) => useful(rest.before(at, WAKE_UP), leave.max(SHORT)),
            _ => useful(rest.before(at, WAKE_UP), remaining),
        });
        if place.is_some() {
            return place;
        }
        if self.lazy {
            return Some(self.off_the_release(now, wanted));
        }
        // The window enforcer looks within such a window, and tells of a step (`crate::close`).
        let behind =
            rest.after(at).filter(|behind| behind.after(self.frequency.ticks(WAKE_UP)) < instant);
        match (trusted, behind) {
            (true, Some(behind)) => Some(self.frequency.nanos(behind.since(now))),
            (true, None) if patient => None,
            _ => Some(wanted),
        }
    }

    /// How long to sleep first within a window, so that the wake-up does not delay its release.
    fn off_the_release(&self, now: Tsc, piece: Nanos) -> Nanos {
        let Some(release) = self.release.filter(|release| *release > now) else { return piece };
        let until = self.nanos_to(release, now);
        let meets = piece.plus(OFF_A_RELEASE) > until && piece < until.plus(OFF_A_RELEASE);
        if meets { until.less(OFF_A_RELEASE) } else { piece }
    }
}
