//! The Linux guest's side of the loop: the few devices that are emulated for it.
//!
//! Its processors share them, under one lock: an exit is rare beside what it costs, and devices are made for one
//! access at a time.
//!
//! Of the memory of its PCI function nothing is here. The regions of channels are memory slots, and so are the registers of
//! virtio devices; what comes here is a write to one that is read-only, and any access to what is empty.

use std::sync::{Arc, Mutex};
use std::thread;

use kvm_ioctls::VcpuExit;
use takt_devices::ports::PortBus;
use takt_devices::power::{PowerLine, PowerRequest};
use takt_devices::virtio::page::BYTES;
use takt_devices::virtio::registers::Registers;
use takt_devices::watchdog::Timer;
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Release, Slot};

use super::guest::{End, Guest, Step, handle_common};
use super::guest_timer::GuestTimer;
use super::record::Scan;
use crate::handoff::lock;
use crate::sandbox;
use crate::virtio;

/// The devices of a guest, which one of its processors accesses at a time.
pub struct Board {
    /// Those with ports.
    pub ports: PortBus,
    /// The line that some of them pull.
    pub power: PowerLine,
    /// By their slots.
    pub virtio: Vec<Registers>,
}

/// A Linux guest, as the thread of one of its processors knows it.
pub struct LinuxGuest {
    board: Arc<Mutex<Board>>,
    /// Accesses of this processor that nothing answered.
    illegal: u64,
    watchdog: Option<Timer>,
    timer: Option<GuestTimer>,
}

impl Board {
    /// Whether an exit would wait, because there is no room for what the guest prints.
    fn would_wait(&self, exit: &VcpuExit<'_>) -> bool {
        matches!(exit, VcpuExit::IoOut(port, data) if self.ports.would_wait(*port, data))
    }

    /// Answers an exit; `None` if it is none for devices. Counts the accesses that nothing answers.
    fn answer(&mut self, exit: &mut VcpuExit<'_>, illegal: &mut u64) -> Option<Step> {
        let unclaimed = self.ports.unclaimed();
        let mut step = Step::Resume;
        match exit {
            VcpuExit::IoOut(port, data) => {
                self.ports.write(*port, width(data.len()), data);
                step = match self.power.request() {
                    None => Step::Resume,
                    Some(PowerRequest::Off) => Step::Ended(End::PoweredOff),
                    Some(PowerRequest::Reset) => Step::Ended(End::Reset),
                };
            }
            VcpuExit::IoIn(port, data) => self.ports.read(*port, width(data.len()), data),
            VcpuExit::MmioRead(_, data) => {
                data.fill(0xff);
                *illegal += 1;
            }
            VcpuExit::MmioWrite(address, data) => match self.virtio(*address) {
                Some((device, offset)) => device.write(offset, data),
                None => *illegal += 1,
            },
            _ => return None,
        }
        *illegal += self.ports.unclaimed() - unclaimed;
        Some(step)
    }

    /// The virtio device that an address belongs to, and where in its registers it lies. KVM splits what
    /// would leave a page.
    fn virtio(&mut self, address: u64) -> Option<(&mut Registers, u64)> {
        let offset = address.checked_sub(virtio::Slot(0).registers().into())?;
        let device = self.virtio.get_mut(usize::try_from(offset / BYTES).ok()?)?;
        Some((device, offset % BYTES))
    }
}

impl LinuxGuest {
    /// A guest with these devices.
    #[must_use]
    pub fn on(board: Arc<Mutex<Board>>) -> Self {
        Self { board, illegal: 0, watchdog: None, timer: None }
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

    fn handle(&mut self, mut exit: VcpuExit<'_>) -> Step {
        let mut board = lock(&self.board);
        // Not under the lock: the other processors go on, and what is typed gets through, above all to a guest that
        // prints without end. The supervisor wakes the thread when it has taken something, or the run is over
        // (`Control::wake`): a timer would interrupt the windows of others.
        while board.would_wait(&exit) {
            drop(board);
            thread::park();
            board = lock(&self.board);
        }
        let answered = board.answer(&mut exit, &mut self.illegal);
        drop(board);
        answered.unwrap_or_else(|| handle_common(&exit))
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
        if let Some(timer) = &self.timer {
            timer.left();
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
        self.illegal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, mpsc};
    use std::time::{Duration, Instant};
    use takt_devices::disk::Shape;
    use takt_devices::disk::device::DiskDevice;
    use takt_devices::disk::handover::Handover;
    use takt_devices::output;
    use takt_devices::ports::PortDevice;
    use takt_devices::power::AcpiPower;
    use takt_devices::serial::{IrqLine, SerialPort};
    use takt_plan::linux_map::PCI_WINDOW;
    use vmm_sys_util::eventfd::{EFD_NONBLOCK, EventFd};

    use crate::memory::{GuestMemory, Pages};

    fn guest(ports: PortBus, power: PowerLine, virtio: Vec<Registers>) -> LinuxGuest {
        LinuxGuest::on(Arc::new(Mutex::new(Board { ports, power, virtio })))
    }

    #[test]
    fn a_power_request_ends_the_guest() {
        for (offset, value, end) in [(0, 0x34, End::PoweredOff), (2, 1, End::Reset)] {
            let power = PowerLine::default();
            let mut ports = PortBus::default();
            ports.attach(0x600..=0x602, Box::new(AcpiPower(power.clone()))).unwrap();
            let mut guest = guest(ports, power, Vec::new());
            assert_eq!(guest.handle(VcpuExit::IoOut(0x601, &[value])), Step::Resume);
            let step = guest.handle(VcpuExit::IoOut(0x600 + offset, &[value]));
            assert_eq!(step, Step::Ended(end));
        }
    }

    #[test]
    fn a_processor_that_waits_to_print_holds_up_no_other_and_what_is_typed_gets_through() {
        const DATA: u16 = 0x3f8;
        const SCRATCH: u16 = DATA + 7;
        const PATIENCE: Duration = Duration::from_secs(60);

        let stop = Arc::new(AtomicBool::new(false));
        let (out, mut end) = output::waiting(stop.clone());
        let irq = IrqLine(EventFd::new(EFD_NONBLOCK).unwrap());
        let console = SerialPort::new(irq, out);
        let mut ports = PortBus::default();
        ports.attach(DATA..=SCRATCH, Box::new(console.clone())).unwrap();
        let power = PowerLine::default();
        let board = Arc::new(Mutex::new(Board { ports, power, virtio: Vec::new() }));
        let prints = thread::spawn({
            let (mut processor, stop) = (LinuxGuest::on(board.clone()), stop.clone());
            move || {
                while !stop.load(Ordering::Relaxed) {
                    assert_eq!(processor.handle(VcpuExit::IoOut(DATA, b"y")), Step::Resume);
                }
            }
        });
        // The output is not read: from here on the processor waits.
        while !console.would_wait(0, 1) {
            thread::yield_now();
        }
        let (done, other) = mpsc::channel();
        thread::spawn(move || {
            let mut processor = LinuxGuest::on(board);
            for value in 1..=100 {
                processor.handle(VcpuExit::IoOut(SCRATCH, &[value]));
            }
            done.send(()).unwrap();
        });
        let waited = other.recv_timeout(PATIENCE);
        let begun = Instant::now();
        while waited.is_ok() && console.type_bytes(b"\x03") == 0 {
            assert!(begun.elapsed() < PATIENCE, "nothing can be typed");
            thread::yield_now();
        }
        stop.store(true, Ordering::Relaxed);
        prints.thread().unpark();
        prints.join().unwrap();
        assert_eq!(waited, Ok(()), "the other processor waits too");
        let mut printed = Vec::new();
        end.drain_into(&mut printed);
        assert!(printed.iter().all(|byte| *byte == b'y'));
    }

    #[test]
    fn memory_without_a_device_reads_as_ones() {
        let mut guest = guest(PortBus::default(), PowerLine::default(), Vec::new());
        let mut data = [0; 4];
        assert_eq!(guest.handle(VcpuExit::MmioRead(0xd000_0000, &mut data)), Step::Resume);
        assert_eq!((data, guest.illegal_accesses()), ([0xff; 4], 1));
    }

    #[test]
    fn each_disk_takes_writes_to_its_own_registers_and_none_behind_them() {
        let memory = GuestMemory::for_linux(1 << 20, Pages::Small, &[], 2).unwrap();
        let (disks, pages): (Vec<_>, Vec<_>) = [virtio::Slot(0), virtio::Slot(1)]
            .map(|slot| {
                let page = slot.page(&memory).unwrap();
                let shape = Shape { sectors: 5, read_only: true };
                let device = DiskDevice::new(shape, Arc::new(Handover::new(page.clone())));
                (Registers::new(device, page.clone()), page)
            })
            .into_iter()
            .unzip();
        assert!(virtio::Slot(2).page(&memory).is_err());
        let mut guest = guest(PortBus::default(), PowerLine::default(), disks);
        let mut write = |address| {
            let exit = VcpuExit::MmioWrite(address, &[1, 0, 0, 0]);
            assert_eq!(guest.handle(exit), Step::Resume);
            guest.illegal_accesses()
        };
        assert_eq!([0xe000_1070, 0xdfff_fffc, 0xe000_2070].map(&mut write), [0, 1, 2]);
        // Each is as its driver has left it.
        assert_eq!([0, 1].map(|number: usize| pages[number].get(0x70)), [0, 1]);
    }

    #[test]
    fn every_access_to_empty_memory_is_counted() {
        let mut guest = guest(PortBus::default(), PowerLine::default(), Vec::new());
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
