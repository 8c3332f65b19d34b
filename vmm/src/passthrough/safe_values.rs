//! Safe values: what the outputs of a partition are set to when their owner has ended.
//!
//! The thread that ran the guest writes them, at the moment at which the guest has left for the
//! last time: it has the privilege for the ports already, it is a deadline thread, and no other
//! load of the host can hold it up. The supervisor thread would be the obvious place, and would come
//! whenever Linux lets it.
//!
//! All ends of a run come through there, since every thread is let go and joined at its end,
//! whatever went wrong. What does not is a panic, or a system call that a thread may not make: both
//! end the process, and [last work](super::emergency_stop) comes before. What takes the process away
//! without asking is the [guardian](super::guardian)'s business.
//!
//! Writing allocates nothing, does not wait, and may be repeated.

use std::sync::Arc;

use super::mapping::Mapping;
use super::ports::Ports;
use super::real_ports::{RealPorts, grant};
use crate::vcpu::port_access::Width;

/// One value.
#[derive(Clone, Debug)]
pub struct Write {
    /// Where.
    pub target: Target,
    /// With which access.
    pub width: Width,
    /// What.
    pub value: u32,
}

/// Where a value is written.
#[derive(Clone, Debug)]
pub enum Target {
    /// A port of the host.
    Port(u16),
    /// A register.
    Register(Arc<Mapping>, u64),
}

/// The safe values of a partition, in the order in which they are written.
#[derive(Clone, Debug, Default)]
pub struct SafeValues(Arc<[Write]>);

impl SafeValues {
    /// These.
    #[must_use]
    pub fn new(writes: Vec<Write>) -> Self {
        Self(writes.into())
    }

    /// True if there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Writes all of them, from a thread that has been granted the ports.
    pub fn write(&self) {
        self.write_with(&mut RealPorts, |_, _| true);
    }

    /// Writes all of them, from a thread that may take the privilege for the ports.
    pub(super) fn write_from_anywhere(&self) {
        let may = |first, last| grant(first, last).is_ok();
        self.write_with(&mut RealPorts, may);
    }

    /// Writes those that need no privilege.
    pub fn write_registers(&self) {
        self.write_with(&mut RealPorts, |_, _| false);
    }

    /// A port for which the privilege is refused is left out: the access would end the process.
    fn write_with(&self, ports: &mut impl Ports, may: impl Fn(u16, u16) -> bool) {
        for Write { target, width, value } in self.0.iter() {
            match target {
                Target::Port(port) => {
                    if may(*port, port.saturating_add(width.bytes() as u16 - 1)) {
                        ports.write(*port, *width, *value);
                    }
                }
                Target::Register(memory, offset) => memory.write(*offset, *width, *value),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Fake(Vec<(u16, Width, u32)>);

    impl Ports for Fake {
        fn read(&mut self, _: u16, _: Width) -> u32 {
            panic!("a safe value is written, never read")
        }

        fn write(&mut self, port: u16, width: Width, value: u32) {
            self.0.push((port, width, value));
        }
    }

    fn values() -> SafeValues {
        let write = |port, width, value| Write { target: Target::Port(port), width, value };
        SafeValues::new(vec![
            write(0x378, Width::One, 0xa5),
            write(0xfffc, Width::Four, 7),
            write(0x378, Width::One, 0),
        ])
    }

    #[test]
    fn all_are_written_in_their_order_each_time() {
        let mut fake = Fake::default();
        values().write_with(&mut fake, |_, _| true);
        let once = [(0x378, Width::One, 0xa5), (0xfffc, Width::Four, 7), (0x378, Width::One, 0)];
        assert_eq!(fake.0, once);
        values().write_with(&mut fake, |_, _| true);
        assert_eq!(fake.0[3..], once);
    }

    #[test]
    fn a_port_without_privilege_is_left_out_and_the_rest_written() {
        let mut fake = Fake::default();
        values().write_with(&mut fake, |first, last| (first, last) == (0xfffc, 0xffff));
        assert_eq!(fake.0, [(0xfffc, Width::Four, 7)]);
    }
}
