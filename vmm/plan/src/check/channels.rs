//! Who may send to whom. It is the same under every schedule, and so is shown once.

use std::os::unix::ffi::OsStrExt;

use super::line;
use crate::{ChannelKind, End, HostPort, Owner, PartitionFile};

/// The channels, in the order of the file; nothing if there are none. Each end has a line to
/// itself: two of them at their longest do not fit one.
pub fn list(out: &mut String, file: &PartitionFile) {
    if file.channels().is_empty() {
        return;
    }
    out.push_str("\nchannels\n");
    for channel in file.channels() {
        let (kind, rest) = match channel.kind {
            ChannelKind::Sampling { refresh } => ("sampling", format!("refresh {refresh}")),
            ChannelKind::Queuing { depth, when_full } => {
                ("queuing", format!("depth {depth}, {when_full} when full"))
            }
        };
        let (name, bytes) = (&channel.name, channel.message_bytes);
        line(out, &format!("  {name}: {kind}, up to {bytes} bytes, {rest}"));
        let doorbell = if channel.doorbell.is_some() { ", with a doorbell" } else { "" };
        line(out, &format!("    {}{doorbell}", end(file, &channel.source)));
        for destination in &channel.destinations {
            line(out, &format!("      -> {}", end(file, destination)));
        }
        if let Some(port) = &channel.host {
            let what = match port {
                HostPort::Socket(_) => "socket",
                HostPort::File(_) => "file",
            };
            let path = port.path().as_os_str().as_bytes().escape_ascii();
            line(out, &format!("    host {what} {path}"));
        }
    }
}

fn end(file: &PartitionFile, end: &End) -> String {
    let owner = match end.owner {
        Owner::Partition(id) => file.partitions()[id.0].name(),
        Owner::Host => "host",
    };
    format!("{owner}:{}", end.port)
}
