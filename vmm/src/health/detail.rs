//! What is known of an error that a guest survives.
//!
//! These are written by the thread of a vCPU into a ring, so they are values of fixed size. What a
//! guest says in them is shown escaped, and believed in nothing.

use std::fmt;

use kvm_ioctls::VcpuExit;
use takt_abi::memory::ERROR_TEXT_BYTES;
use takt_scheduler::time::Nanos;

use super::Fault;

/// What is known of an error that a guest survives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// An access that nothing answers.
    Access(Access),
    /// The window of this release was over before the guest was done.
    Overrun(u64),
    /// So many releases passed without a scan, the last of them with this number.
    Lost(u64, u64),
    /// The guest's thread has entered no window for this long.
    Absent(Nanos),
    /// The guest reports an error with this code and text.
    Application(u32, Text),
    /// The host's time-stamp counter has turned bad.
    Clock(ClockFault),
    /// The bus was locked once too often, by this instruction or the one before it. `None` if KVM does
    /// not tell.
    BusLock(Option<u64>),
}

/// How the host's time-stamp counter has turned bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockFault {
    /// The kernel has taken this clock source in its place.
    Source(Text),
    /// It differs from the kernel's clock by more than that can be steered.
    Rate {
        /// How many ns the kernel's clock has gone ahead of it since the last look.
        clock_ahead_ns: i64,
    },
    /// That of a guest is not the host's any more.
    Offset {
        /// How many ns it is ahead.
        guest_ahead_ns: i64,
    },
}

impl fmt::Display for ClockFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ClockFault::Source(name) => {
                write!(f, "the kernel's clock source is \"{name}\" and no longer the TSC")
            }
            ClockFault::Rate { clock_ahead_ns } => {
                let ms = *clock_ahead_ns as f64 / 1e6;
                write!(f, "the TSC and the kernel's clock differ by {ms:.3} ms within a look")
            }
            ClockFault::Offset { guest_ahead_ns } => {
                let ms = *guest_ahead_ns as f64 / 1e6;
                write!(f, "the guest's TSC is {ms:.3} ms ahead of the host's")
            }
        }
    }
}

impl Detail {
    /// Which error it is.
    #[must_use]
    pub const fn fault(&self) -> Fault {
        match self {
            Detail::Access(_) => Fault::IllegalRequest,
            Detail::Overrun(_) | Detail::Lost(..) | Detail::Absent(_) => Fault::DeadlineMissed,
            Detail::Application(..) => Fault::ApplicationError,
            Detail::Clock(_) => Fault::ClockFault,
            Detail::BusLock(_) => Fault::BusLock,
        }
    }
}

impl fmt::Display for Detail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Detail::Access(access) => access.fmt(f),
            Detail::Overrun(release) => {
                write!(f, "the window of release {release} ended before the guest was done")
            }
            Detail::Lost(1, last) => write!(f, "release {last} passed without a scan"),
            Detail::Lost(count, last) => {
                write!(f, "{count} releases up to {last} passed without a scan")
            }
            Detail::Absent(time) => write!(f, "no window was entered for {time}"),
            Detail::Application(code, text) => write!(f, "code {code}: {text}"),
            Detail::Clock(fault) => fault.fmt(f),
            Detail::BusLock(None) => f.write_str("all processors were kept from memory"),
            Detail::BusLock(Some(rip)) => {
                write!(f, "all processors were kept from memory, rip {rip:#x}")
            }
        }
    }
}

/// An access that nothing answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// Where.
    pub target: Target,
    /// How many bytes; for a string instruction, of all its accesses.
    pub bytes: usize,
    /// True for a write.
    pub write: bool,
    /// The instruction; behind a write to memory, the one after it. `None` if KVM does not tell.
    pub rip: Option<u64>,
}

/// Where an access went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// An I/O port.
    Port(u16),
    /// A guest-physical address.
    Memory(u64),
}

impl Access {
    /// The access that an exit is about, if it is about one.
    #[must_use]
    pub fn of(exit: &VcpuExit<'_>) -> Option<Access> {
        let (target, bytes, write) = match exit {
            VcpuExit::IoIn(port, data) => (Target::Port(*port), data.len(), false),
            VcpuExit::IoOut(port, data) => (Target::Port(*port), data.len(), true),
            VcpuExit::MmioRead(address, data) => (Target::Memory(*address), data.len(), false),
            VcpuExit::MmioWrite(address, data) => (Target::Memory(*address), data.len(), true),
            _ => return None,
        };
        Some(Access { target, bytes, write, rip: None })
    }
}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let direction = if self.write { "write" } else { "read" };
        let s = if self.bytes == 1 { "" } else { "s" };
        write!(f, "{direction} of {} byte{s} at ", self.bytes)?;
        match self.target {
            Target::Port(port) => write!(f, "port {port:#x}")?,
            Target::Memory(address) => write!(f, "{address:#x}")?,
        }
        match self.rip {
            Some(rip) => write!(f, ", rip {rip:#x}"),
            None => Ok(()),
        }
    }
}

/// A guest's own words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Text([u8; ERROR_TEXT_BYTES]);

impl Text {
    /// Words that end at the first zero byte.
    #[must_use]
    pub const fn new(bytes: [u8; ERROR_TEXT_BYTES]) -> Text {
        Text(bytes)
    }
}

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = self.0.split(|byte| *byte == 0).next().unwrap_or(&[]);
        words.escape_ascii().fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_access_is_told_with_all_that_finds_it() {
        let mut data = [0; 4];
        let access = Access::of(&VcpuExit::IoIn(0x60, &mut data)).unwrap();
        let access = Access { rip: Some(0x10_0040), ..access };
        assert_eq!(access.to_string(), "read of 4 bytes at port 0x60, rip 0x100040");
        let access = Access::of(&VcpuExit::MmioWrite(0xc000_0018, &[1])).unwrap();
        assert_eq!(access.to_string(), "write of 1 byte at 0xc0000018");
        assert_eq!(Access::of(&VcpuExit::Hlt), None);
    }

    #[test]
    fn a_guests_words_end_at_a_zero_and_are_harmless() {
        let mut bytes = [b'x'; ERROR_TEXT_BYTES];
        assert_eq!(Text::new(bytes).to_string().len(), ERROR_TEXT_BYTES);
        bytes[..6].copy_from_slice(b"\x1b[2J\xff\0");
        assert_eq!(Detail::Application(7, Text::new(bytes)).to_string(), "code 7: \\x1b[2J\\xff");
        assert_eq!(Text::new([0; ERROR_TEXT_BYTES]).to_string(), "");
    }

    #[test]
    fn lost_releases_are_counted() {
        assert_eq!(Detail::Lost(1, 7).to_string(), "release 7 passed without a scan");
        assert_eq!(Detail::Lost(3, 7).to_string(), "3 releases up to 7 passed without a scan");
        let absent = Detail::Absent(Nanos::from_millis(1_020));
        assert_eq!(absent.to_string(), "no window was entered for 1020ms");
    }
}
