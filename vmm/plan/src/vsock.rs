//! The number by which programs of the host reach a Linux without a network.
//!
//! The kernel has one such number (CID) for each guest. 0 to 2 mean the hypervisor, this machine and the host, and the
//! largest one means any. Whether another guest of the host has it is seen when the run starts.

use std::fmt;
use std::ops::RangeInclusive;

use toml::Spanned;

use super::diagnostic::Diagnostic;
use super::partition::Checked;

/// The numbers that a guest can have.
const CIDS: RangeInclusive<u32> = 3..=u32::MAX - 1;

/// A guest's number among the sockets of its host, its context identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cid(pub u32);

impl fmt::Display for Cid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CID {}", self.0)
    }
}

/// Reads the key.
pub fn check(number: &Spanned<i64>) -> Result<Cid, Diagnostic> {
    let cid = u32::try_from(*number.get_ref()).ok().filter(|cid| CIDS.contains(cid));
    cid.map(Cid).ok_or_else(|| {
        let found = format!("{} is not the number of a guest (CID)", number.get_ref());
        let allowed = format!("{} to {}", CIDS.start(), CIDS.end());
        Diagnostic::new(number.span(), found, allowed)
    })
}

/// Refuses a number that two partitions have.
pub fn check_all(partitions: &[Checked]) -> Result<(), Diagnostic> {
    let with = || partitions.iter().filter_map(|p| Some((p.partition.vsock?, p.vsock.clone()?)));
    for (count, (cid, place)) in with().enumerate() {
        if let Some((_, other)) = with().take(count).find(|(other, _)| *other == cid) {
            let found = format!("a second partition has {cid}");
            return Err(Diagnostic::new(place, found, "a number of its own for each partition")
                .and(other, "the other one"));
        }
    }
    Ok(())
}
