//! The Linux guest's side of the loop: the few devices that are emulated for it.
//!
//! Of the memory of its PCI function nothing is here. The regions of channels are memory slots;
//! what comes here is a write to one that is read-only, and any access to what is empty.

use kvm_ioctls::VcpuExit;
use takt_devices::ports::PortBus;
use takt_devices::power::{PowerLine, PowerRequest};
use takt_devices::virtio::registers::{BYTES, Registers};
use takt_devices::watchdog::Timer;
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Release, Slot};

use super::guest::{End, Guest, Step, handle_common};
use super::guest_timer::GuestTimer;
use super::record::Scan;
use crate::sandbox;
use crate::virtio;

/// A Linux guest.
pub struct LinuxGuest {
    ports: PortBus,
    power: PowerLine,
    /// By their slots.
    virtio: Vec<Registers>,
    stray_memory: u64,
    watchdog: Option<Timer>,
    timer: Option<GuestTimer>,
}

impl LinuxGuest {
    /// A guest with these devices; `power` is the line that some of them pull.
    #[must_use]
    pub fn new(ports: PortBus, power: PowerLine) -> Self {
        Self { ports, power, virtio: Vec::new(), stray_memory: 0, watchdog: None, timer: None }
    }

    /// The same guest with virtio devices, by their slots.
    #[must_use]
    pub fn with_virtio(self, virtio: Vec<Registers>) -> Self {
        Self { virtio, ..self }
    }

    /// The virtio device that an address belongs to, and where in its registers it lies. KVM splits what
    /// would leave a page.
    fn virtio(&mut self, address: u64) -> Option<(&mut Registers, u64)> {
        let offset = address.checked_sub(virtio::Slot(0).registers().into())?;
        let device = self.virtio.get_mut(usize::try_from(offset / BYTES).ok()?)?;
        Some((device, offset % BYTES))
    }

    /// The same guest with a watchdog, whose registers are among the devices.
    #[must_use]
    pub fn watched_by(self, watchdog: Option<Timer>) -> Self {
        Self { watchdog, ..self }
    }

    /// The same guest with a timer whose deadlines are Takt's to place.
    #[must_use]
    pub fn with_timer(self, timer: Option<GuestTimer>) -> Self {
        Self { timer, ..self }
    }
}

/// Width of one access, from the bytes of an exit: KVM hands a string instruction over whole,
/// and Linux makes those to none of these devices, so anything that is no single access is taken
/// byte by byte.
fn width(bytes: usize) -> usize {
    if matches!(bytes, 2 | 4) { bytes } else { 1 }
}

impl Guest for LinuxGuest {
    const THREAD: sandbox::Kind = sandbox::Kind::Linux;

    /// An unmodified Linux knows nothing of windows.
    fn announce(&mut self, _: &Release, _: &Slot, _: &Timebase) {}

    fn handle(&mut self, exit: VcpuExit<'_>) -> Step {
        match exit {
            VcpuExit::IoOut(port, data) => {
                self.ports.write(port, width(data.len()), data);
                match self.power.request() {
                    None => Step::Resume,
                    Some(PowerRequest::Off) => Step::Ended(End::PoweredOff),
                    Some(PowerRequest::Reset) => Step::Ended(End::Reset),
                }
            }
            VcpuExit::IoIn(port, data) => {
                self.ports.read(port, width(data.len()), data);
                Step::Resume
            }
            VcpuExit::MmioRead(address, data) => {
                match self.virtio(address) {
                    Some((device, offset)) => device.read(offset, data),
                    None => {
                        data.fill(0xff);
                        self.stray_memory += 1;
                    }
                }
                Step::Resume
            }
            VcpuExit::MmioWrite(address, data) => {
                match self.virtio(address) {
                    Some((device, offset)) => device.write(offset, data),
                    None => self.stray_memory += 1,
                }
                Step::Resume
            }
            other => handle_common(&other),
        }
    }

    fn timer(&mut self) -> Option<&mut GuestTimer> {
        self.timer.as_mut()
    }

    fn ended_from_outside(&self) -> Option<End> {
        let timer = self.watchdog.as_ref().filter(|timer| timer.has_expired())?;
        Some(End::Silent(Nanos(timer.time())))
    }

    fn left(&mut self) {
        if let Some(timer) = &self.watchdog {
            timer.stop();
        }
    }

    fn claim(&self, _: u64) -> Option<Scan> {
        None
    }

    fn last_stamp(&self) -> Tsc {
        Tsc(0)
    }

    fn says_done(&self) -> bool {
        false
    }

    fn illegal_accesses(&self) -> u64 {
        self.ports.unclaimed() + self.stray_memory
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use takt_devices::disk::Shape;
    use takt_devices::disk::device::DiskDevice;
    use takt_devices::power::AcpiPower;
    use takt_plan::linux_map::PCI_WINDOW;

    #[test]
    fn a_power_request_ends_the_guest() {
        for (offset, value, end) in [(0, 0x34, End::PoweredOff), (2, 1, End::Reset)] {
            let power = PowerLine::default();
            let mut ports = PortBus::default();
            ports.attach(0x600..=0x602, Box::new(AcpiPower(power.clone()))).unwrap();
            let mut guest = LinuxGuest::new(ports, power);
            assert_eq!(guest.handle(VcpuExit::IoOut(0x601, &[value])), Step::Resume);
            let step = guest.handle(VcpuExit::IoOut(0x600 + offset, &[value]));
            assert_eq!(step, Step::Ended(end));
        }
    }

    #[test]
    fn memory_without_a_device_reads_as_ones() {
        let mut guest = LinuxGuest::new(PortBus::default(), PowerLine::default());
        let mut data = [0; 4];
        assert_eq!(guest.handle(VcpuExit::MmioRead(0xd000_0000, &mut data)), Step::Resume);
        assert_eq!((data, guest.illegal_accesses()), ([0xff; 4], 1));
    }

    #[test]
    fn each_disk_answers_at_its_own_registers_and_none_behind_them() {
        let registers = |sectors| {
            let shape = Shape { sectors, read_only: true };
            Registers::new(DiskDevice::new(shape, Arc::default()))
        };
        let mut guest = LinuxGuest::new(PortBus::default(), PowerLine::default())
            .with_virtio(vec![registers(5), registers(6)]);
        let mut read = |address| {
            let mut data = [0; 4];
            assert_eq!(guest.handle(VcpuExit::MmioRead(address, &mut data)), Step::Resume);
            (u32::from_le_bytes(data), guest.illegal_accesses())
        };
        assert_eq!([read(0xe000_0100), read(0xe000_1100)], [(5, 0), (6, 0)]);
        assert_eq!([read(0xdfff_fffc), read(0xe000_2000)], [(u32::MAX, 1), (u32::MAX, 2)]);
        let write = VcpuExit::MmioWrite(0xe000_1070, &[1, 0, 0, 0]);
        assert_eq!(guest.handle(write), Step::Resume);
        let mut data = [0; 4];
        let _ = guest.handle(VcpuExit::MmioRead(0xe000_1070, &mut data));
        assert_eq!((data, guest.illegal_accesses()), ([1, 0, 0, 0], 2));
    }

    #[test]
    fn every_access_to_empty_memory_is_counted() {
        let mut guest = LinuxGuest::new(PortBus::default(), PowerLine::default());
        let mut number = 0x2545_f491_4f6c_dd1du64;
        for count in 1..=20_000 {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let address = u64::from(*PCI_WINDOW.start()) + (number >> 40 & 0x1f_ffff);
            let width = 1 << (number >> 62);
            let mut data = [number as u8 & 0x7f; 8];
            if number >> 33 & 1 == 0 {
                let write = VcpuExit::MmioWrite(address, &data[..width]);
                assert_eq!(guest.handle(write), Step::Resume);
            } else {
                let read = VcpuExit::MmioRead(address, &mut data[..width]);
                assert_eq!(guest.handle(read), Step::Resume);
                assert_eq!(data[..width], [0xff; 8][..width]);
            }
            assert_eq!(guest.illegal_accesses(), count);
        }
    }
}
