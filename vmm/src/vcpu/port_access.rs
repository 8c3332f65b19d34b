//! An access to I/O ports, exactly as the guest made it.
//!
//! kvm-ioctls tells port and bytes of such an exit and drops the width, so that four bytes may be
//! one access or four of a string instruction. To a device that is a difference. So for ports that
//! are passed through the exit is read from the shared page once more.

use std::slice;

use kvm_bindings::{KVM_EXIT_IO, KVM_EXIT_IO_IN, KVM_EXIT_IO_OUT, kvm_run};
use kvm_ioctls::VcpuFd;

/// Bytes of one access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    One = 1,
    /// 16 bits.
    Two = 2,
    /// 32 bits.
    Four = 4,
}

impl Width {
    /// `None` for what is no width of an access.
    #[must_use]
    pub const fn of(bytes: u8) -> Option<Width> {
        match bytes {
            1 => Some(Width::One),
            2 => Some(Width::Two),
            4 => Some(Width::Four),
            _ => None,
        }
    }

    /// How many bytes.
    #[must_use]
    pub const fn bytes(self) -> usize {
        self as usize
    }
}

/// Which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The guest reads.
    In,
    /// The guest writes.
    Out,
}

/// One access, or several to the same port by one string instruction.
#[derive(Debug, PartialEq, Eq)]
pub struct PortAccess<'a> {
    /// The first port.
    pub port: u16,
    /// Of each access.
    pub width: Width,
    /// Of all of them.
    pub direction: Direction,
    /// The bytes of all of them, one after the other: what is written, or room for what is read.
    pub data: &'a mut [u8],
}

impl PortAccess<'_> {
    /// The access for which the vCPU has left its guest; `None` if it has for another reason.
    pub fn of(vcpu: &mut VcpuFd) -> Option<PortAccess<'_>> {
        let run = vcpu.get_kvm_run();
        if run.exit_reason != KVM_EXIT_IO {
            return None;
        }
        // SAFETY: all members of the union are plain integers, and this is the one that the
        // kernel has filled in for this exit.
        let io = unsafe { run.__bindgen_anon_1.io };
        let direction = match u32::from(io.direction) {
            KVM_EXIT_IO_IN => Direction::In,
            KVM_EXIT_IO_OUT => Direction::Out,
            _ => return None,
        };
        let width = Width::of(io.size)?;
        let bytes = width.bytes() * io.count as usize;
        let start = (&raw mut *run).cast::<u8>();
        let data_offset = usize::try_from(io.data_offset).ok()?;
        debug_assert!(data_offset >= size_of::<kvm_run>());
        // SAFETY: the kernel promises `count` times `size` bytes at this offset of the vCPU's
        // mapping (Documentation/virt/kvm/api.rst, KVM_EXIT_IO), which lives as long as `vcpu`,
        // and does not touch them until the next KVM_RUN, for which `vcpu` is needed.
        let data = unsafe { slice::from_raw_parts_mut(start.add(data_offset), bytes) };
        Some(PortAccess { port: io.port, width, direction, data })
    }
}
