//! What the channels of a file add up to in each partition: its ports, and the memory behind them.
//!
//! A partition sees its channels in an area of guest memory of a fixed size, beside a page with
//! the table of its ports. Both are of a fixed size so that a guest finds them at addresses which
//! no partition file moves; so a file can ask for more than there is, and is told so here. A Linux
//! is told where its channels are, but a bound has to be somewhere, and one for all is simpler.

use takt_abi::PORTS_MAX;
use takt_abi::live::RESERVED_PORTS;
use takt_abi::memory::{CHANNELS, CHANNELS_END, PAGE};
use toml::Spanned;

use super::channels::{Channel, ChannelKind, Owner};
use super::diagnostic::{Diagnostic, Span, quote};
use super::live::live_pages;
use super::partition::Checked;
use super::raw;
use super::units::Bytes;

/// Pages of channels that a partition can see.
pub const CHANNEL_AREA_PAGES: u64 = 500;
const _: () = assert!(CHANNELS + CHANNEL_AREA_PAGES * PAGE <= CHANNELS_END);

/// Guest memory that a channel takes in each of its partitions, in bytes, a multiple of the page
/// size: the region that the source writes, and for a queue also the page in which its destination
/// acknowledges. Each partition sees both, since one that writes the one has to read the other.
#[must_use]
pub fn region_bytes(kind: ChannelKind, message_bytes: u32) -> u64 {
    let pages = |bytes: usize| (bytes as u64).next_multiple_of(PAGE);
    match kind.geometry(message_bytes) {
        Ok(geometry) => pages(geometry.source_bytes()) + pages(geometry.destination_bytes()),
        Err(_) => u64::MAX,
    }
}

/// The ports of all partitions, as far as the channels have been read.
pub struct Ports<'a> {
    partitions: &'a [Checked],
    /// By partition.
    ports: Vec<Vec<Port>>,
    /// Those of the host, which are limited by the number of channels only.
    host: Vec<Port>,
}

/// What is kept of an end of a channel.
struct Port {
    name: String,
    place: Span,
    channel: String,
    pages: u64,
    message_bytes: Span,
}

impl<'a> Ports<'a> {
    /// No ports yet.
    pub fn of(partitions: &'a [Checked]) -> Ports<'a> {
        Ports {
            partitions,
            ports: partitions.iter().map(|_| Vec::new()).collect(),
            host: Vec::new(),
        }
    }

    /// Gives each partition at an end of `channel` its port.
    pub fn add(&mut self, channel: &Channel, raw: &raw::Channel) -> Result<(), Diagnostic> {
        let pages = region_bytes(channel.kind, channel.message_bytes) / PAGE;
        for (end, text) in channel.ends(raw) {
            let port = Port {
                name: end.port.clone(),
                place: text.span(),
                channel: channel.name.clone(),
                pages,
                message_bytes: raw.message_bytes.span(),
            };
            let Owner::Partition(id) = end.owner else {
                check_unique(&port, &self.host, "the host")?;
                self.host.push(port);
                continue;
            };
            let ports = &mut self.ports[id.0];
            let owner = &self.partitions[id.0];
            let name = format!("partition {}", quote(&owner.partition.name));
            check_unique(&port, ports, &name)?;
            ports.push(port);
            check_number(text, ports, owner)?;
            check_area(text, ports, owner)?;
        }
        Ok(())
    }
}

fn check_unique(port: &Port, others: &[Port], owner: &str) -> Result<(), Diagnostic> {
    let Some(other) = others.iter().find(|other| other.name == port.name) else { return Ok(()) };
    let found = format!(
        "port {} of {owner} is an end of channel {} too",
        quote(&port.name),
        quote(&other.channel)
    );
    let allowed = "a port of its own for each channel";
    Err(Diagnostic::new(port.place.clone(), found, allowed)
        .and(other.place.clone(), "the other end"))
}

fn check_number(text: &Spanned<String>, ports: &[Port], owner: &Checked) -> Result<(), Diagnostic> {
    let (most, whose) = match owner.programs.is_empty() {
        true => (PORTS_MAX, "a partition"),
        false => (PORTS_MAX - RESERVED_PORTS, "a partition with programs"),
    };
    if ports.len() <= most {
        return Ok(());
    }
    let name = quote(&owner.partition.name);
    let found = format!("this is port {} of partition {name}", ports.len());
    let allowed = format!("at most {most} ports in {whose}");
    Err(Diagnostic::new(text.span(), found, allowed).and(owner.name.clone(), "the partition"))
}

/// Points at the largest channel as well: that of which most can be saved.
fn check_area(text: &Spanned<String>, ports: &[Port], owner: &Checked) -> Result<(), Diagnostic> {
    let pages: u64 = ports.iter().map(|port| port.pages).sum();
    let largest = ports.iter().max_by_key(|port| port.pages);
    let (most, whose) = match owner.programs.is_empty() {
        true => (CHANNEL_AREA_PAGES, "a partition"),
        false => (CHANNEL_AREA_PAGES - live_pages(), "a partition with programs"),
    };
    let Some(largest) = largest.filter(|_| pages > most) else { return Ok(()) };
    let found = format!(
        "with this end the channels of partition {} need {pages} pages of {}",
        quote(&owner.partition.name),
        Bytes(PAGE)
    );
    let allowed = format!(
        "at most {most} pages in {whose}; a sampling channel has room for 4 \
         messages, and a queuing one for 3 more than its depth"
    );
    let label = format!("{} of them for channel {}", largest.pages, quote(&largest.channel));
    Err(Diagnostic::new(text.span(), found, allowed).and(largest.message_bytes.clone(), label))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::WhenFull;
    use takt_scheduler::time::Nanos;

    const SAMPLING: ChannelKind = ChannelKind::Sampling { refresh: Nanos(1) };

    fn queuing(depth: u32) -> ChannelKind {
        ChannelKind::Queuing { depth, when_full: WhenFull::Refuse }
    }

    #[test]
    fn a_sampling_channel_takes_four_slots_in_whole_pages() {
        // 128 + 4 * 64 bytes.
        assert_eq!(region_bytes(SAMPLING, 1), PAGE);
        // 128 + 4 * 960 bytes are 3968, and the next cache line makes them 4224.
        assert_eq!(region_bytes(SAMPLING, 936), PAGE);
        assert_eq!(region_bytes(SAMPLING, 937), 2 * PAGE);
        // 128 + 4 * 65600 bytes.
        assert_eq!(region_bytes(SAMPLING, 65_536), 65 * PAGE);
    }

    #[test]
    fn a_queue_takes_three_slots_more_than_its_depth_and_a_page() {
        assert_eq!(region_bytes(queuing(1), 1), 2 * PAGE);
        // 128 + 11 * 1024 bytes.
        assert_eq!(region_bytes(queuing(8), 1000), 4 * PAGE);
        // The largest of all: 128 + 1027 * 65600 bytes.
        assert_eq!(region_bytes(queuing(1024), 65_536), (16_449 + 1) * PAGE);
    }
}
