//! The PLC guest's side of the loop: its pages, its doorbells, its console.

use kvm_ioctls::VcpuExit;
use takt_abi::interrupt_controller::VECTORS;
use takt_abi::memory::{ERROR_TEXT_BYTES, TEXT, TEXT_BYTES};
use takt_abi::{Information, MAGIC, Status, VERSION, interrupt_controller, port, start};
use takt_devices::output::DroppingOutput;
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Release, Slot};
use vm_memory::{Bytes, GuestAddress};

use super::guest::{End, Guest, Step, handle_common};
use super::port_access::PortAccess;
use super::record::Scan;
use crate::boot::{Start, StartMode, StartReason};
use crate::health::{Detail, Text};
use crate::memory::{GuestMemory, Page};
use crate::passthrough::Granted;
use crate::sandbox;

/// A PLC guest.
pub struct PlcGuest {
    memory: GuestMemory,
    information: Page<Information>,
    status: Page<Status>,
    /// The fixed part of the information page.
    announced: Information,
    console: DroppingOutput,
    illegal: u64,
    tick: Option<u8>,
    /// Also what keeps the devices' memory mapped.
    devices: Option<Granted>,
}

impl PlcGuest {
    /// The guest in `memory`; `None` if that was not made for a PLC.
    #[must_use]
    pub fn new(
        memory: &GuestMemory,
        memory_bytes: u64,
        tsc_khz: u32,
        frame: Nanos,
        console: DroppingOutput,
    ) -> Option<Self> {
        let announced = Information {
            magic: MAGIC,
            version: VERSION,
            memory_bytes,
            tsc_khz: u64::from(tsc_khz),
            major_frame_ns: frame.0,
            release: 0,
            frame: 0,
            release_tsc: 0,
            window_end_tsc: 0,
            next_release_tsc: 0,
            next_window_end_tsc: 0,
            schedule: 0,
            start_mode: start::COLD,
            start_condition: start::NORMAL,
            interrupt_controller: interrupt_controller::NONE,
        };
        let (information, status) = (memory.information()?, memory.status()?);
        let memory = memory.clone();
        Some(Self {
            memory,
            information,
            status,
            announced,
            console,
            illegal: 0,
            tick: None,
            devices: None,
        })
    }

    /// With these devices of the host's.
    #[must_use]
    pub fn with_devices(mut self, devices: Option<Granted>) -> Self {
        if devices.as_ref().is_some_and(Granted::interrupts) {
            self.announced.interrupt_controller = interrupt_controller::LOCAL_APIC;
        }
        Self { devices, ..self }
    }

    /// Whether its machine has an interrupt controller.
    #[must_use]
    pub fn has_interrupts(&self) -> bool {
        self.announced.interrupt_controller != interrupt_controller::NONE
    }

    /// The guest has been loaded anew and is about to start.
    pub fn start_anew(&mut self, Start { mode, reason }: Start) {
        self.tick = None;
        self.announced.start_mode = match mode {
            StartMode::Cold => start::COLD,
            StartMode::Warm => start::WARM,
        };
        self.announced.start_condition = match reason {
            StartReason::ScheduleChange | StartReason::Operator => start::PARTITION_RESTART,
            StartReason::HealthMonitor => start::HEALTH_MONITOR,
        };
    }

    fn port_write(&mut self, port: u16, data: &[u8]) -> Step {
        match (port, data) {
            (port::DONE, &[a, b, c, d]) => match u32::from_le_bytes([a, b, c, d]) {
                0 => Step::Done,
                window if window == port::done(self.announced.release) => Step::Done,
                // It was taken out between its decision and this, and the window is another one.
                _ => Step::Resume,
            },
            (port::CONSOLE, &[a, b, c, d]) => self.print(u32::from_le_bytes([a, b, c, d])),
            (port::EXCEPTION, [_, _, _, _]) => {
                Step::Ended(End::Exception(self.status.read().exception))
            }
            (port::EXIT, &[a, b, c, d]) => {
                Step::Ended(End::Exited(u32::from_le_bytes([a, b, c, d])))
            }
            (port::TICK, &[vector, 0, 0, 0]) if VECTORS.contains(&vector) => {
                self.tick = Some(vector);
                Step::Resume
            }
            (port::ERROR, &[a, b, c, d]) => self.raise(u32::from_le_bytes([a, b, c, d])),
            _ => self.illegal(),
        }
    }

    /// Takes the first `length` bytes of the text area.
    fn print(&mut self, length: u32) -> Step {
        let mut text = [0; TEXT_BYTES];
        let Some(text) = text.get_mut(..length as usize) else { return self.illegal() };
        match self.memory.regions().read_slice(text, GuestAddress(TEXT)) {
            Ok(()) => {
                self.console.write(text);
                Step::Resume
            }
            Err(_) => self.illegal(),
        }
    }

    /// Takes what the guest says of an error.
    fn raise(&mut self, code: u32) -> Step {
        let mut text = [0; ERROR_TEXT_BYTES];
        match self.memory.regions().read_slice(&mut text, GuestAddress(TEXT)) {
            Ok(()) => Step::Raised(Detail::Application(code, Text::new(text))),
            Err(_) => self.illegal(),
        }
    }

    fn illegal(&mut self) -> Step {
        self.illegal += 1;
        Step::Resume
    }
}

impl Guest for PlcGuest {
    const THREAD: sandbox::Kind = sandbox::Kind::Plc;

    fn announce(&mut self, release: &Release, next: &Slot, base: &Timebase) {
        let page = &mut self.announced;
        page.release = release.sequence;
        page.frame = release.frame;
        page.release_tsc = base.instant(release.start).0;
        page.window_end_tsc = base.instant(release.end).0;
        (page.next_release_tsc, page.next_window_end_tsc) = match next {
            Slot::Window(next) => (base.instant(next.start).0, base.instant(next.end).0),
            Slot::Idle(_) => (0, 0),
        };
        page.schedule = release.schedule.0 as u32;
        self.information.write(self.announced);
    }

    fn handle(&mut self, exit: VcpuExit<'_>) -> Step {
        match exit {
            VcpuExit::IoOut(port, data) => self.port_write(port, data),
            VcpuExit::IoIn(_, data) => {
                data.fill(0xff);
                self.illegal()
            }
            VcpuExit::MmioRead(_, data) => {
                data.fill(0xff);
                self.illegal()
            }
            // Also a write to the read-only information page.
            VcpuExit::MmioWrite(..) => self.illegal(),
            other => handle_common(&other),
        }
    }

    fn has_port(&self, port: u16) -> bool {
        self.devices.as_ref().is_some_and(|devices| devices.ports.has(port))
    }

    fn access(&mut self, mut access: PortAccess<'_>) -> Step {
        let devices = self.devices.as_mut();
        if devices.is_some_and(|devices| devices.ports.perform(&mut access)) {
            Step::Resume
        } else {
            self.illegal()
        }
    }

    fn io_ranges(&self) -> Vec<[u16; 2]> {
        let ranges = self.devices.iter().flat_map(|devices| devices.ports.ranges());
        ranges.map(|range| [range.host, range.host_last()]).collect()
    }

    fn left(&mut self) {
        if let Some(devices) = &self.devices {
            devices.safe_values.write();
        }
    }

    fn claim(&self, sequence: u64) -> Option<Scan> {
        let status = self.status.read();
        (status.started == sequence.wrapping_add(1))
            .then_some(Scan { start: Tsc(status.start_tsc), done: Tsc(status.done_tsc) })
    }

    fn last_stamp(&self) -> Tsc {
        Tsc(self.status.read().done_tsc)
    }

    fn says_done(&self) -> bool {
        true
    }

    fn tick(&self) -> Option<u8> {
        self.tick
    }

    fn illegal_accesses(&self) -> u64 {
        self.illegal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::Pages;
    use crate::passthrough::ports::{PortMap, PortRange};
    use crate::passthrough::real_ports::RealPorts;
    use crate::passthrough::safe_values::SafeValues;
    use crate::vcpu::port_access::{Direction, Width};
    use takt_devices::output;
    use takt_scheduler::schedules::ScheduleId;
    use takt_scheduler::time::TscFrequency;
    use takt_scheduler::timetable::Idle;

    fn guest() -> (PlcGuest, GuestMemory, output::OutputEnd) {
        let memory = GuestMemory::for_plc(2 << 20, Pages::Small, &[]).unwrap();
        let (console, end) = output::dropping();
        let guest =
            PlcGuest::new(&memory, 2 << 20, 1_000_000, Nanos::from_millis(1), console).unwrap();
        (guest, memory, end)
    }

    const BASE: Timebase = match TscFrequency::from_khz(2_000_000) {
        Some(frequency) => Timebase { epoch: Tsc(5_000), frequency },
        None => panic!(),
    };

    fn release(sequence: u64, start: u64) -> Release {
        let (start, end) = (Nanos(start), Nanos(start + 300));
        Release { sequence, schedule: ScheduleId(1), window: 0, frame: 3, start, end }
    }

    #[test]
    fn the_information_page_tells_this_window_and_the_next() {
        let (mut guest, memory, _end) = guest();
        let page = || memory.information().unwrap().read();
        let next = Slot::Window(release(8, 4_000));
        guest.announce(&release(7, 3_000), &next, &BASE);
        let p = page();
        assert_eq!((p.magic, p.version, p.release, p.frame), (MAGIC, VERSION, 7, 3));
        assert_eq!((p.release_tsc, p.window_end_tsc), (11_000, 11_600));
        assert_eq!((p.next_release_tsc, p.next_window_end_tsc), (13_000, 13_600));
        assert_eq!((p.schedule, p.start_mode, p.start_condition), (1, start::COLD, start::NORMAL));

        let idle = Slot::Idle(Idle { sequence: 8, frame: 4, start: Nanos(4_000) });
        guest.announce(&release(7, 3_000), &idle, &BASE);
        assert_eq!((page().next_release_tsc, page().next_window_end_tsc), (0, 0));
    }

    #[test]
    fn a_guest_is_told_how_and_why_it_was_started() {
        let (mut guest, memory, _end) = guest();
        let mut told = |mode, reason| {
            guest.start_anew(Start { mode, reason });
            guest.announce(&release(7, 3_000), &Slot::Window(release(8, 4_000)), &BASE);
            let p = memory.information().unwrap().read();
            (p.start_mode, p.start_condition)
        };
        let switched = told(StartMode::Warm, StartReason::ScheduleChange);
        assert_eq!(switched, (start::WARM, start::PARTITION_RESTART));
        let failed = told(StartMode::Cold, StartReason::HealthMonitor);
        assert_eq!(failed, (start::COLD, start::HEALTH_MONITOR));
    }

    #[test]
    fn doorbells_are_32_bits_wide_and_anything_else_is_illegal() {
        let (mut guest, _memory, _end) = guest();
        assert_eq!(guest.handle(VcpuExit::IoOut(port::DONE, &[0; 4])), Step::Done);
        let exited = Step::Ended(End::Exited(0x0403_0201));
        assert_eq!(guest.handle(VcpuExit::IoOut(port::EXIT, &[1, 2, 3, 4])), exited);
        assert_eq!(guest.illegal_accesses(), 0);
        for data in [&[][..], &[0], &[0; 2], &[0; 8]] {
            assert_eq!(guest.handle(VcpuExit::IoOut(port::DONE, data)), Step::Resume);
        }
        assert_eq!(guest.illegal_accesses(), 4);
    }

    #[test]
    fn a_guest_gives_away_the_window_that_it_means_and_no_other() {
        let (mut guest, _memory, _end) = guest();
        let next = Slot::Window(release(8, 4_000));
        let mut done = |sequence, value: u32| {
            guest.announce(&release(sequence, 3_000), &next, &BASE);
            guest.handle(VcpuExit::IoOut(port::DONE, &value.to_le_bytes()))
        };
        assert_eq!(done(7, port::done(7)), Step::Done);
        assert_eq!(done(8, port::done(7)), Step::Resume);
        assert_eq!(done(8, 0), Step::Done);
        // A release whose number is the value for any.
        let wrapped = u64::from(u32::MAX);
        assert_eq!(done(wrapped, port::done(wrapped)), Step::Done);
        assert_eq!(done(wrapped + 1, port::done(wrapped + 1)), Step::Done);
        assert_eq!(guest.illegal_accesses(), 0);
    }

    #[test]
    fn a_tick_has_a_vector_of_an_interrupt_and_lasts_until_the_next_start() {
        let (mut guest, _memory, _end) = guest();
        let mut ask = |vector: u32| {
            guest.handle(VcpuExit::IoOut(port::TICK, &vector.to_le_bytes()));
            (guest.tick(), guest.illegal_accesses())
        };
        assert_eq!(
            (ask(0), ask(31), ask(255), ask(256 + 32)),
            ((None, 1), (None, 2), (None, 3), (None, 4))
        );
        assert_eq!((ask(32), ask(254), ask(8)), ((Some(32), 4), (Some(254), 4), (Some(254), 5)));
        guest.start_anew(Start { mode: StartMode::Warm, reason: StartReason::Operator });
        assert_eq!(guest.tick(), None);
    }

    #[test]
    fn a_ring_that_kvm_does_not_take_wakes_no_partition() {
        let (mut guest, _memory, _end) = guest();
        for number in [0u32, 1, 41, 42, u32::MAX] {
            let ring = VcpuExit::IoOut(port::DOORBELL, &number.to_le_bytes());
            assert_eq!(guest.handle(ring), Step::Resume);
        }
        assert_eq!(guest.illegal_accesses(), 5);
    }

    #[test]
    fn a_text_is_printed_up_to_the_length_that_was_said() {
        let (mut guest, memory, mut end) = guest();
        memory.regions().write_slice(b"level 1.2\nnot this", GuestAddress(TEXT)).unwrap();
        let mut say = |length: u32| {
            guest.handle(VcpuExit::IoOut(port::CONSOLE, &length.to_le_bytes()));
            guest.illegal_accesses()
        };
        assert_eq!((say(10), say(0)), (0, 0));
        assert_eq!((say(TEXT_BYTES as u32 + 1), say(u32::MAX)), (1, 2));
        let mut seen = Vec::new();
        end.drain_into(&mut seen);
        assert_eq!(seen, b"level 1.2\n");
    }

    #[test]
    fn an_error_comes_with_its_code_and_the_guests_words() {
        let (mut guest, memory, _end) = guest();
        memory.regions().write_slice(b"valve stuck\0stale", GuestAddress(TEXT)).unwrap();
        let step = guest.handle(VcpuExit::IoOut(port::ERROR, &[7, 0, 0, 0]));
        let Step::Raised(detail) = step else { panic!("{step:?}") };
        assert_eq!(detail.to_string(), "code 7: valve stuck");
        assert_eq!(guest.handle(VcpuExit::IoOut(port::ERROR, &[7])), Step::Resume);
        assert_eq!(guest.illegal_accesses(), 1);
    }

    #[test]
    fn what_no_device_answers_reads_as_ones_and_is_counted() {
        let (mut guest, _memory, _end) = guest();
        let mut data = [0; 4];
        assert_eq!(guest.handle(VcpuExit::IoIn(0x60, &mut data)), Step::Resume);
        assert_eq!(data, [0xff; 4]);
        let mut data = [0; 8];
        assert_eq!(guest.handle(VcpuExit::MmioRead(0xfee0_0000, &mut data)), Step::Resume);
        assert_eq!(data, [0xff; 8]);
        assert_eq!(guest.handle(VcpuExit::MmioWrite(0xc000_0000, &data)), Step::Resume);
        assert_eq!(guest.illegal_accesses(), 3);
    }

    #[test]
    fn an_access_that_leaves_its_range_is_illegal() {
        let (guest, _memory, _end) = guest();
        assert!(!guest.has_port(0x378));
        let range = PortRange { first: 0x378, last: 0x37a, host: 0x1378 };
        let mut guest = guest.with_devices(Some(Granted {
            ports: PortMap::new(&[range], RealPorts),
            safe_values: SafeValues::default(),
            memory: Vec::new(),
            lines: Vec::new(),
            space: None,
        }));
        assert_eq!(guest.io_ranges(), [[0x1378, 0x137a]]);
        assert!(guest.has_port(0x37a) && !guest.has_port(0x37b) && !guest.has_port(0x1378));
        let mut data = [0; 4];
        let (port, width, direction) = (0x37a, Width::Four, Direction::In);
        let access = PortAccess { port, width, direction, data: &mut data };
        assert_eq!(guest.access(access), Step::Resume);
        assert_eq!((data, guest.illegal_accesses()), ([0xff; 4], 1));
    }

    #[test]
    fn a_claim_is_for_one_release_only() {
        let (guest, memory, _end) = guest();
        assert_eq!(guest.claim(0), None);
        let mut page = memory.status().unwrap();
        let mut status = page.read();
        (status.started, status.start_tsc, status.done_tsc) = (8, 10, 20);
        page.write(status);
        assert_eq!(guest.claim(7), Some(Scan { start: Tsc(10), done: Tsc(20) }));
        assert_eq!((guest.claim(6), guest.claim(8)), (None, None));
    }

    #[test]
    fn an_exception_comes_with_the_frame_that_the_guest_recorded() {
        let (mut guest, memory, _end) = guest();
        let mut page = memory.status().unwrap();
        let mut status = page.read();
        status.exception.vector = 14;
        page.write(status);
        let step = guest.handle(VcpuExit::IoOut(port::EXCEPTION, &[0; 4]));
        assert_eq!(step, Step::Ended(End::Exception(status.exception)));
    }
}
