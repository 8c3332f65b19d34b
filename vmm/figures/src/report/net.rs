//! What a report tells of a network interface of a Linux, and of its sockets.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A network interface.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Net {
    /// The tap device at the host's end.
    pub tap: String,
    /// What the host has sent to the guest; `None` if the tap device was gone at the end of the run.
    pub to_guest: Option<Traffic>,
    /// What the guest has sent.
    pub from_guest: Option<Traffic>,
    /// How often the guest's driver handed over queues that are not in its memory.
    pub refused_queues: u64,
}

/// Packets in one direction, as the host's kernel has counted them since the tap device was made. A packet
/// may be longer than the network's are: it is cut where it leaves the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Traffic {
    /// Packets that got through.
    pub packets: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Packets for which there was no room.
    pub dropped: u64,
}

/// The way to a Linux that needs no network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vsock {
    /// The number by which the host reaches it.
    pub cid: u32,
    /// How often the guest's driver handed over queues that are not in its memory.
    pub refused_queues: u64,
}

impl fmt::Display for Net {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tap, to_guest, from_guest, refused_queues } = self;
        match (to_guest, from_guest) {
            (Some(to), Some(from)) => write!(f, "{tap}: to it {to}; from it {from}")?,
            _ => write!(f, "{tap}: the tap device is gone, and its counts with it")?,
        }
        refused(f, *refused_queues)
    }
}

impl fmt::Display for Vsock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CID {}", self.cid)?;
        refused(f, self.refused_queues)
    }
}

fn refused(f: &mut fmt::Formatter<'_>, queues: u64) -> fmt::Result {
    match queues {
        0 => Ok(()),
        count => write!(f, "; {count} times its driver's queues could not be used"),
    }
}

impl fmt::Display for Traffic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { packets, bytes, dropped } = self;
        write!(f, "{packets} packets, {bytes} bytes, {dropped} dropped")
    }
}
