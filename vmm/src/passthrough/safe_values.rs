//! Safe values: what the outputs of a partition are set to when nobody drives them any more.
//!
//! The thread that ran the guest writes them, at the moment at which the guest has left for the
//! last time: it has the privilege for the ports already, it is a deadline thread, and no other
//! load of the host can hold it up. The event thread would be the obvious place, and would come
//! whenever Linux lets it.
//!
//! All ends of a run come through there, since every thread is let go and joined at its end,
//! whatever went wrong. What does not is a panic: it ends the process, but not before its message is
//! on the screen, which takes long enough for many a scan. So a hook that runs first takes all guests
//! off their processors and writes all values of all partitions. A guest that was in the middle of
//! an access on another CPU can be later than that; its own thread then writes once more. What takes
//! the process away without asking is the [guardian](super::guardian)'s business.
//!
//! Writing allocates nothing, waits for nobody, and may be repeated.

use std::panic;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::mapping::Mapping;
use super::ports::Ports;
use super::real_ports::{RealPorts, grant};
use crate::vcpu::Control;
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

    /// Writes all of them, from any thread.
    pub(super) fn write_from_anywhere(&self) {
        let may = |first, last| grant(first, last).is_ok();
        self.write_with(&mut RealPorts, may);
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

/// For as long as it lives, a panic writes safe values.
pub struct PanicGuard(Arc<AtomicBool>);

impl PanicGuard {
    /// Those of all partitions, whose threads these are.
    #[must_use]
    pub fn new(all: Vec<SafeValues>, threads: Vec<Arc<Control>>) -> Self {
        let live = Arc::new(AtomicBool::new(true));
        let guard = Self(live.clone());
        if all.iter().any(|values| !values.is_empty()) {
            let next = panic::take_hook();
            panic::set_hook(Box::new(move |panic| {
                if live.load(Ordering::SeqCst) {
                    Control::stop_all(&threads);
                    all.iter().for_each(SafeValues::write_from_anywhere);
                }
                next(panic);
            }));
        }
        guard
    }
}

impl Drop for PanicGuard {
    fn drop(&mut self) {
        // The devices go back to the host, and are no business of ours then.
        self.0.store(false, Ordering::SeqCst);
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
