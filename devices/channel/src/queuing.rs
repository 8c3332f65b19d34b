//! The queuing channel: every message in order, from one source to one destination.
//!
//! Two regions, one for each direction. The source counts the messages that it has written, the
//! destination those that it has taken; both count up only and are validated by the other end
//! whenever they are used. The difference is the number of waiting messages.
//!
//! The policy decides who yields when that difference reaches the depth. With
//! [`Policy::Refuse`](crate::Policy) the source does: it looks at the destination's counter and
//! returns `Full`. With [`Policy::Overwrite`](crate::Policy) the source goes on, and the
//! destination finds that the source has got further ahead than the depth: it skips what is lost
//! and says so once.
//!
//! Messages are not told again after a restart of the source, nor after one of the destination:
//! opening either end empties the queue. Where processes follow each other at an end, each attaches to
//! it instead, and the queue goes on.

pub(crate) mod destination;
pub(crate) mod source;
