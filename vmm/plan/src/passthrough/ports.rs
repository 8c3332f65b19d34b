//! Ranges of I/O ports.

use std::ops::RangeInclusive;

use takt_abi::port::RESERVED;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, quote};
use super::super::raw::{self, Keys};
use super::source::{Bar, PciKeys, check_bar};
use super::{Owned, Taken, hex, platform, take};

/// Ports that a partition may use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortIo {
    /// As the guest sees them.
    pub first: u16,
    /// The last one.
    pub last: u16,
    /// Where they are on the host: the first ports of this register; `None`: where the guest sees
    /// them.
    pub bar: Option<Bar>,
    /// They may be ports on which the host itself runs.
    pub shared_with_host: bool,
}

/// Checks the ranges of a partition.
pub fn check(
    tables: &[Spanned<Keys<raw::PortIo>>],
    partition: &str,
    taken: &mut Taken,
) -> Result<Vec<PortIo>, Diagnostic> {
    let mut seen: Vec<Owned> = Vec::new();
    let mut ranges = Vec::with_capacity(tables.len());
    for table in tables {
        let Keys(raw) = table.get_ref();
        let place = raw.ports.span();
        let (first, last) = check_range(&raw.ports)?;
        let keys = PciKeys {
            pci: &raw.pci,
            bar: &raw.bar,
            unbind: &raw.unbind,
            trusted_dma: &raw.trusted_dma,
            vfio: &raw.vfio,
            header: table.span(),
        };
        let bar = check_bar(&keys, partition, taken)?;
        let range = [first.into(), last.into()];
        let meets = |other: &RangeInclusive<u16>| first <= *other.end() && *other.start() <= last;
        if meets(&RESERVED) {
            let found = "among these ports are some of Takt's own, by which the guest calls it";
            let allowed = format!("ports outside {:#x} to {:#x}", RESERVED.start(), RESERVED.end());
            return Err(Diagnostic::new(place, found, allowed));
        }
        let pci = raw.pci.as_ref().map(|pci| ("pci", pci.span()));
        let shared_with_host = platform::check_shared(raw.shared_with_host.as_ref(), pci)?;
        if bar.is_none() {
            platform::check_ports(range, &place, shared_with_host)?;
        }
        take(&mut seen, range, partition, place.clone(), ["port", "ports"])?;
        if bar.is_none() {
            take(&mut taken.ports, range, partition, place, ["port", "ports"])?;
        }
        ranges.push(PortIo { first, last, bar, shared_with_host });
    }
    Ok(ranges)
}

/// `"0x378"` or `"0x378-0x37a"`.
fn check_range(text: &Spanned<String>) -> Result<(u16, u16), Diagnostic> {
    let port = |text: &str| hex(text).and_then(|n| u16::try_from(n).ok());
    let range = match text.get_ref().split_once('-') {
        None => port(text.get_ref()).map(|one| (one, one)),
        Some((first, last)) => port(first).zip(port(last)),
    };
    let wrong = |found| {
        let allowed = "a port or the first and the last of several, such as \"0x378-0x37a\", up \
                       to 0xffff";
        Diagnostic::new(text.span(), found, allowed)
    };
    match range {
        Some((first, last)) if first <= last => Ok((first, last)),
        Some(_) => Err(wrong(format!("{} ends before it starts", quote(text.get_ref())))),
        None => Err(wrong(format!("{} is not a range of I/O ports", quote(text.get_ref())))),
    }
}
