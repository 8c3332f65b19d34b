//! The two queues between Takt and a PLC with programs, through which it is asked and ordered while it runs.
//!
//! They are channels like those of the file, but for their names, which no file can write, and for their ends in
//! Takt, which lead to the control socket. They have the last places in the partition's port table, and their
//! memory is a part of the area for channels.

use takt_abi::live::{ANSWERS, MESSAGE_BYTES, ORDERS, ORDERS_DEPTH};
use takt_abi::memory::PAGE;

use super::Partition;
use super::channels::{Channel, ChannelKind, End, Owner, WhenFull};
use super::ports::region_bytes;

/// Answers that can wait: in 20 ms, in which Takt looks at them once, a PLC with windows at the shortest
/// spacing can send more, and then counts those that had no room.
const ANSWERS_DEPTH: u32 = 256;

const ORDERS_KIND: ChannelKind =
    ChannelKind::Queuing { depth: ORDERS_DEPTH, when_full: WhenFull::Refuse };
const ANSWERS_KIND: ChannelKind =
    ChannelKind::Queuing { depth: ANSWERS_DEPTH, when_full: WhenFull::Refuse };

/// The orders to a partition and its answers; `None` if it has no programs.
#[must_use]
pub fn live_channels(partition: &Partition) -> Option<[Channel; 2]> {
    partition.programs().first()?;
    let end = |owner, port: &str| End { owner, port: port.to_owned() };
    let channel = |name: &str, kind, source, destination| Channel {
        name: format!("{name} of {}", partition.name()),
        kind,
        message_bytes: MESSAGE_BYTES as u32,
        source: end(source, name),
        destinations: vec![end(destination, name)],
        doorbell: None,
        host: None,
    };
    let guest = Owner::Partition(partition.id());
    Some([
        channel(ORDERS, ORDERS_KIND, Owner::Host, guest),
        channel(ANSWERS, ANSWERS_KIND, guest, Owner::Host),
    ])
}

/// Pages of the area for channels that both take.
pub fn live_pages() -> u64 {
    let bytes = [ORDERS_KIND, ANSWERS_KIND].map(|kind| region_bytes(kind, MESSAGE_BYTES as u32));
    bytes.into_iter().sum::<u64>() / PAGE
}
