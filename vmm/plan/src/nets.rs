//! The network interfaces of a Linux: each is one end of a cable whose other end is a tap device of the host.
//!
//! What the host has of devices is seen when the run starts. Here is what must be right of itself: names as
//! the kernel takes them, addresses that stand for one station, and nothing given twice.

use std::net::Ipv4Addr;

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::raw::{self, Keys};

/// Most interfaces of a partition: with the disks they have the pins of the guest's interrupt controller.
pub const NETS_MAX: usize = 2;
/// Longest name of a network device, in bytes: `IFNAMSIZ` of the kernel, less the NUL.
const NAME_MAX: usize = 15;

/// An interface of a Linux.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Net {
    /// The tap device at the host's end.
    pub tap: String,
    /// The guest's Ethernet address.
    pub mac: [u8; 6],
    /// What the host's end is made to be, if Takt makes it.
    pub host: HostEnd,
}

/// The host's end of an interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostEnd {
    /// Switched on, and the rest is the host's.
    Plain,
    /// With an address, and how many bits of it are the network's.
    Address(Ipv4Addr, u8),
    /// A port of this bridge.
    Bridge(String),
}

/// An interface that obeys its own rules, with the places that later rules point at.
#[derive(Debug)]
pub struct CheckedNet {
    pub net: Net,
    tap: Span,
    mac: Span,
}

/// Checks the interfaces of a partition, in the order of the file.
pub fn check(raw: &[Spanned<Keys<raw::Net>>]) -> Result<Vec<CheckedNet>, Diagnostic> {
    if let Some(excess) = raw.get(NETS_MAX) {
        let found = format!("this is network interface {} of {}", NETS_MAX + 1, raw.len());
        let allowed = format!("at most {NETS_MAX} tables [[partition.net]] in a partition");
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    raw.iter().map(check_one).collect()
}

fn check_one(table: &Spanned<Keys<raw::Net>>) -> Result<CheckedNet, Diagnostic> {
    let Keys(raw) = table.get_ref();
    let tap = check_device(&raw.tap)?;
    let mac = check_mac(&raw.mac)?;
    let host = match (&raw.address, &raw.bridge) {
        (Some(_), Some(bridge)) => {
            let found = "a tap device in a bridge has an address of its own";
            let allowed = "`address` or `bridge`: a bridge has the address of all its ports";
            return Err(Diagnostic::new(bridge.span(), found, allowed));
        }
        (Some(address), None) => check_address(address)?,
        (None, Some(bridge)) => HostEnd::Bridge(check_device(bridge)?),
        (None, None) => HostEnd::Plain,
    };
    Ok(CheckedNet { net: Net { tap, mac, host }, tap: raw.tap.span(), mac: raw.mac.span() })
}

/// Refuses a tap device or an Ethernet address that two interfaces of the file have.
pub fn check_all<'a>(nets: impl Iterator<Item = &'a CheckedNet>) -> Result<(), Diagnostic> {
    let mut seen: Vec<&CheckedNet> = Vec::new();
    for net in nets {
        if let Some(other) = seen.iter().find(|other| other.net.tap == net.net.tap) {
            let found = format!("a second interface has the tap device {}", quote(&net.net.tap));
            let allowed = "a tap device of its own for each interface";
            return Err(Diagnostic::new(net.tap.clone(), found, allowed)
                .and(other.tap.clone(), "the other one"));
        }
        if let Some(other) = seen.iter().find(|other| other.net.mac == net.net.mac) {
            let found = "a second interface has this Ethernet address";
            let allowed = "an address of its own for each interface, also across machines";
            return Err(Diagnostic::new(net.mac.clone(), found, allowed)
                .and(other.mac.clone(), "the other one"));
        }
        seen.push(net);
    }
    Ok(())
}

/// A name that the kernel takes as it is: it would put a number in the place of a `%d`.
fn check_device(name: &Spanned<String>) -> Result<String, Diagnostic> {
    let text = name.get_ref();
    let letter = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    let is_good = (1..=NAME_MAX).contains(&text.len())
        && text.chars().all(letter)
        && !text.chars().all(|c| c == '.');
    if is_good {
        return Ok(text.clone());
    }
    let found = format!("{} cannot be the name of a network device", quote(text));
    let allowed = format!("1 to {NAME_MAX} of a-z, A-Z, 0-9, \"_\", \"-\" and \".\"");
    Err(Diagnostic::new(name.span(), found, allowed))
}

fn check_mac(mac: &Spanned<String>) -> Result<[u8; 6], Diagnostic> {
    let text = mac.get_ref();
    let part = |part: &str| {
        let digits = part.len() == 2 && part.bytes().all(|b| b.is_ascii_hexdigit());
        digits.then(|| u8::from_str_radix(part, 16).ok()).flatten()
    };
    let parts: Option<Vec<u8>> = text.split(':').map(part).collect();
    let address = parts.and_then(|parts| <[u8; 6]>::try_from(parts).ok());
    let allowed = "six bytes such as \"02:00:00:00:00:01\", an address of one station; \
                   those that begin with 02 are for local use";
    let found = match address {
        Some([first, ..]) if first & 1 != 0 => {
            format!("{} is the address of a group of stations", quote(text))
        }
        Some([0, 0, 0, 0, 0, 0]) => format!("{} is the address of no station", quote(text)),
        Some(address) => return Ok(address),
        None => format!("{} is not an Ethernet address", quote(text)),
    };
    Err(Diagnostic::new(mac.span(), found, allowed))
}

fn check_address(address: &Spanned<String>) -> Result<HostEnd, Diagnostic> {
    let text = address.get_ref();
    let parts = text.split_once('/').and_then(|(address, bits)| {
        let digits = !bits.is_empty() && bits.bytes().all(|b| b.is_ascii_digit());
        let bits: u8 = digits.then(|| bits.parse().ok()).flatten()?;
        Some((address.parse::<Ipv4Addr>().ok()?, bits))
    });
    let no_host =
        |a: Ipv4Addr| a.is_unspecified() || a.is_loopback() || a.is_multicast() || a.is_broadcast();
    match parts {
        Some((address, bits @ 1..=31)) if !no_host(address) => Ok(HostEnd::Address(address, bits)),
        _ => {
            let found = format!("{} is not the address of a host in its network", quote(text));
            let allowed = "an IPv4 address and the bits of its network, 1 to 31, such as \
                           \"192.168.50.1/24\"";
            Err(Diagnostic::new(address.span(), found, allowed))
        }
    }
}
