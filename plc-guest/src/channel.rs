//! The partition's ports: ends of channels, by the names that the partition file gives them.
//!
//! A port is opened once, usually before the first scan, and then used from it. No call blocks, and
//! each is bounded, whatever the other end does (see the channel crate). What ARINC 653 makes a
//! return code is one here too.
//!
//! No call leaves the guest either, but for one: if the partition file gives the channel a doorbell,
//! each message that is written or sent rings it, so that a Linux can wait for it. That is one VM
//! exit, which ends in the host's kernel.

use core::ptr::NonNull;
use core::sync::atomic::{AtomicU64, Ordering};

use takt_abi::{PORTS_MAX, Port, PortTable, direction, memory, port_kind};
pub use takt_channel::ReturnCode;
use takt_channel::{
    Geometry, LengthError, OwnPages, PeerPages, Policy, QueuingDestination, QueuingSource,
    SamplingDestination, SamplingSource, SendError, SourceStatus, Ticks, Tsc,
};

use crate::{pages, port};

/// A port that sends the newest value.
#[derive(Debug)]
pub struct Output {
    source: SamplingSource<OwnPages<'static>>,
    doorbell: Doorbell,
}

impl Output {
    /// Replaces the message, and rings. `stamp` is now.
    ///
    /// # Errors
    /// [`LengthError`]; the message before stays.
    pub fn write(&mut self, bytes: &[u8], stamp: Tsc) -> Result<(), LengthError> {
        self.source.write(bytes, stamp)?;
        self.doorbell.ring();
        Ok(())
    }
}

/// A port that reads the newest value.
pub type Input = SamplingDestination<PeerPages<'static>>;
/// A port that sends messages.
#[derive(Debug)]
pub struct Sender {
    source: QueuingSource<OwnPages<'static>, PeerPages<'static>>,
    doorbell: Doorbell,
}

impl Sender {
    /// Sends a message, and rings. `stamp` is now.
    ///
    /// # Errors
    /// [`SendError`]; then no peer is woken, since there is nothing new.
    pub fn send(&mut self, bytes: &[u8], stamp: Tsc) -> Result<(), SendError> {
        self.source.send(bytes, stamp)?;
        self.doorbell.ring();
        Ok(())
    }

    /// What is known of the port, after a look at the destination.
    pub fn status(&mut self) -> SourceStatus {
        self.source.status()
    }
}

/// A port that receives messages.
pub type Receiver = QueuingDestination<PeerPages<'static>, OwnPages<'static>>;

/// What a source rings: the number of its port, if it has a doorbell.
#[derive(Clone, Copy, Debug)]
struct Doorbell(Option<u32>);

impl Doorbell {
    const fn of(taken: &Taken) -> Self {
        Self(if taken.port.doorbell == 0 { None } else { Some(taken.number) })
    }

    fn ring(self) {
        if let Some(number) = self.0 {
            port::write(takt_abi::port::DOORBELL, number);
        }
    }
}

/// A port that was handed out.
struct Taken {
    /// Its place in the table.
    number: u32,
    port: &'static Port,
}

/// Ports that have been opened, one bit each.
static OPENED: AtomicU64 = AtomicU64::new(0);
const _: () = assert!(PORTS_MAX <= 64);

/// The ends of channels that the partition file gives this partition.
#[must_use]
pub fn ports() -> &'static [Port] {
    // SAFETY: the host provides the page as read-only memory at this address and fills it before
    // the guest starts, never again; every bit pattern is a valid `PortTable`.
    let table = unsafe { &*(memory::PORT_TABLE as *const PortTable) };
    table.ports.get(..table.count as usize).unwrap_or(&[])
}

/// Opens the source of a sampling channel.
///
/// # Errors
/// `InvalidConfig` if there is no such port or it differs from what is asked for; `NoAction` if it
/// is open already.
pub fn output(name: &str, maximum: u32) -> Result<Output, ReturnCode> {
    let taken = take(name, port_kind::SAMPLING, direction::SOURCE, maximum)?;
    let geometry = Geometry::sampling(maximum).map_err(|_| ReturnCode::InvalidConfig)?;
    let source = SamplingSource::open(own(taken.port)?, &geometry).map_err(|error| error.code())?;
    Ok(Output { source, doorbell: Doorbell::of(&taken) })
}

/// Opens a destination of a sampling channel.
///
/// # Errors
/// As [`output`].
pub fn input(name: &str, maximum: u32) -> Result<Input, ReturnCode> {
    let Taken { port, .. } = take(name, port_kind::SAMPLING, direction::DESTINATION, maximum)?;
    let geometry = Geometry::sampling(maximum).map_err(|_| ReturnCode::InvalidConfig)?;
    let khz = u128::from(pages::information().tsc_khz);
    let refresh = Ticks((u128::from(port.refresh_ns) * khz / 1_000_000) as u64);
    SamplingDestination::open(peer(port)?, &geometry, refresh).map_err(|error| error.code())
}

/// Opens the source of a queuing channel.
///
/// # Errors
/// As [`output`].
pub fn sender(name: &str, maximum: u32) -> Result<Sender, ReturnCode> {
    let taken = take(name, port_kind::QUEUING, direction::SOURCE, maximum)?;
    let (own, peer) = (own(taken.port)?, peer(taken.port)?);
    let source =
        QueuingSource::open(own, peer, &queuing(taken.port)?).map_err(|error| error.code())?;
    Ok(Sender { source, doorbell: Doorbell::of(&taken) })
}

/// Opens the destination of a queuing channel.
///
/// # Errors
/// As [`output`].
pub fn receiver(name: &str, maximum: u32) -> Result<Receiver, ReturnCode> {
    let Taken { port, .. } = take(name, port_kind::QUEUING, direction::DESTINATION, maximum)?;
    let (peer, own) = (peer(port)?, own(port)?);
    QueuingDestination::open(peer, own, &queuing(port)?).map_err(|error| error.code())
}

/// The port of that name, if it is what is asked for and was not taken yet.
fn take(name: &str, kind: u32, direction: u32, maximum: u32) -> Result<Taken, ReturnCode> {
    let found = (0..).zip(ports()).find(|(_, port)| is_named(port, name));
    let (number, port) = found.ok_or(ReturnCode::InvalidConfig)?;
    if (port.kind, port.direction, port.maximum) != (kind, direction, maximum) {
        return Err(ReturnCode::InvalidConfig);
    }
    let bit = 1 << number;
    match OPENED.fetch_or(bit, Ordering::Relaxed) & bit {
        0 => Ok(Taken { number, port }),
        _ => Err(ReturnCode::NoAction),
    }
}

fn is_named(port: &Port, name: &str) -> bool {
    let end = port.name.iter().position(|&byte| byte == 0).unwrap_or(port.name.len());
    &port.name[..end] == name.as_bytes()
}

fn queuing(port: &Port) -> Result<Geometry, ReturnCode> {
    let policy =
        if port.policy == Policy::Overwrite as u32 { Policy::Overwrite } else { Policy::Refuse };
    Geometry::queuing(port.maximum, port.depth, policy).map_err(|_| ReturnCode::InvalidConfig)
}

fn own(port: &Port) -> Result<OwnPages<'static>, ReturnCode> {
    let (start, bytes) = region(port.own, port.own_pages)?;
    // SAFETY: the host provides these pages as memory for as long as the guest runs, `boot` has
    // mapped them writable, and `take` hands each port out once, so nothing else in the guest
    // writes them.
    unsafe { OwnPages::new(start, bytes) }.map_err(|_| ReturnCode::InvalidConfig)
}

fn peer(port: &Port) -> Result<PeerPages<'static>, ReturnCode> {
    let (start, bytes) = region(port.peer, port.peer_pages)?;
    // SAFETY: as in `own`, but for reading; that the other end writes them meanwhile is what the
    // type is for.
    unsafe { PeerPages::new(start, bytes) }.map_err(|_| ReturnCode::InvalidConfig)
}

/// A region of the channel area: the part of it that `boot` has mapped.
fn region(start: u64, pages: u32) -> Result<(NonNull<u8>, usize), ReturnCode> {
    let bytes = u64::from(pages) * memory::PAGE;
    let inside = start >= memory::CHANNELS
        && start.is_multiple_of(memory::PAGE)
        && start.checked_add(bytes).is_some_and(|end| end <= memory::CHANNELS_END);
    match NonNull::new(start as *mut u8) {
        Some(start) if inside => Ok((start, bytes as usize)),
        _ => Err(ReturnCode::InvalidConfig),
    }
}
