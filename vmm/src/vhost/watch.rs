//! What notices that the host's kernel does not take a device's queues: its Linux then waits for ever, and sees no reason.

use std::mem;
use std::sync::Arc;

use takt_devices::virtio::carried::Link;

/// The supervisor's view of a carried device.
pub struct LinkWatch {
    /// As the operator knows it.
    device: String,
    link: Arc<Link>,
    is_told: bool,
}

impl LinkWatch {
    /// Of this device.
    #[must_use]
    pub const fn new(device: String, link: Arc<Link>) -> Self {
        Self { device, link, is_told: false }
    }

    /// The first error of the host's kernel, once.
    pub fn look(&mut self) -> Option<String> {
        let Self { device, link, is_told } = self;
        let error = link.error().filter(|_| !mem::replace(is_told, true))?;
        Some(format!(
            "{device}: the host's kernel does not take its queues: {error}; its Linux waits for it"
        ))
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use takt_devices::virtio::carried::{Carrier, QUEUES, Ring};
    use takt_devices::virtio::registers::Registers;
    use takt_devices::vsock;

    use super::*;
    use crate::memory::{GuestMemory, Pages};
    use crate::virtio::Slot;

    struct Gone;

    impl Carrier for Gone {
        fn features(&self) -> u64 {
            1 << 32
        }

        fn start(&mut self, _: u64, _: [Ring; QUEUES]) -> io::Result<()> {
            Err(io::Error::from_raw_os_error(libc::EBADFD))
        }

        fn stop(&mut self) {}
    }

    #[test]
    fn the_first_error_of_a_carrier_is_told_once() {
        let memory = GuestMemory::for_linux(1 << 20, Pages::Small, &[], 1).unwrap();
        let link = Arc::new(Link::new(Gone));
        let mut watch = LinkWatch::new("sockets".into(), link.clone());
        assert_eq!(watch.look(), None);
        let device = vsock::device(7, memory.only_ram().unwrap(), link);
        let mut registers = Registers::new(device, Slot(0).page(&memory).unwrap());
        let mut write = |offset, value: u32| registers.write(offset, &value.to_le_bytes());
        // Its driver agrees to version 1, and hands two queues over that are in its RAM.
        for (offset, value) in [(0x70, 1), (0x70, 3), (0x24, 1), (0x20, 1), (0x70, 0xb)] {
            write(offset, value);
        }
        for queue in 0..2 {
            let parts = [(0x80, 0x1000), (0x90, 0x2000), (0xa0, 0x3000)];
            for (offset, value) in [(0x30, queue), (0x38, 256)].into_iter().chain(parts) {
                write(offset, value);
            }
            write(0x44, 1);
        }
        write(0x70, 0xf);
        let told = watch.look().unwrap();
        assert!(
            told.starts_with("sockets: the host's kernel does not take its queues: File"),
            "{told}"
        );
        assert_eq!(watch.look(), None);
    }
}
