//! Sources without a device: a FIFO tells of interrupts, and a file is the configuration space.

use std::fs::File;
use std::io::Write;
use std::os::fd::{FromRawFd, OwnedFd};

use super::*;
use crate::event::eventfd;
use crate::passthrough::vfio::device::Device;

const ARMED: u16 = 0x0003;

/// A source, the end at which the device would be, and its configuration space.
fn source() -> (Source, File, File) {
    let mut ends = [0; 2];
    // SAFETY: the call fills in the array it is given.
    let made = unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_NONBLOCK | libc::O_CLOEXEC) };
    assert_eq!(made, 0);
    // SAFETY: both were just made and have no other owner.
    let [uio, device] = ends.map(|end| File::from(unsafe { OwnedFd::from_raw_fd(end) }));
    // SAFETY: the name is a literal; the descriptor is new.
    let config =
        unsafe { File::from_raw_fd(libc::memfd_create(c"config".as_ptr(), libc::MFD_CLOEXEC)) };
    let line = Arc::new(Line::Pci { uio, config: config.try_clone().unwrap(), armed: ARMED });
    let source = Source {
        name: "interrupt 64 of plc".to_owned(),
        line,
        signal: eventfd().unwrap(),
        asked: eventfd().unwrap(),
        state: State::Open(PER_TICK),
        told: false,
    };
    (source, device, config)
}

fn reading_end(source: &Source) -> File {
    source.line.teller().unwrap().try_clone().unwrap()
}

/// Whether the line has been opened since this was asked last.
fn opened(config: &File) -> bool {
    let opened = config.metadata().unwrap().len() != 0;
    config.set_len(0).unwrap();
    opened
}

fn interrupts(source: Source) -> Interrupts {
    let mut all = Interrupts::new().unwrap();
    for (fd, which) in
        [(source.line.teller().unwrap().as_raw_fd(), LINE), (source.asked.as_raw_fd(), ASKED)]
    {
        all.epoll.ctl(ControlOperation::Add, fd, EpollEvent::new(EventSet::IN, which)).unwrap();
    }
    all.sources.push(source);
    all
}

#[test]
fn nothing_is_open_before_the_guest_asks_and_several_requests_are_one() {
    let (source, _device, config) = source();
    let asked = source.asked.try_clone().unwrap();
    let mut all = interrupts(source);
    all.on_tick();
    all.on_ready();
    assert!(!opened(&config));
    asked.write(1).unwrap();
    asked.write(1).unwrap();
    all.on_ready();
    assert!(opened(&config));
    all.on_ready();
    all.on_tick();
    assert!(!opened(&config));
}

#[test]
fn an_interrupt_is_injected_once_and_opens_nothing() {
    let (source, mut device, config) = source();
    let signal = source.signal.try_clone().unwrap();
    let mut all = interrupts(source);
    device.write_all(&7u32.to_ne_bytes()).unwrap();
    all.on_ready();
    assert_eq!(signal.read().unwrap(), 1);
    all.on_ready();
    assert!(signal.read().is_err());
    assert!(!opened(&config));
}

#[test]
fn a_guest_that_asks_without_end_gets_its_share_of_each_tick() {
    let (source, _device, config) = source();
    let asked = source.asked.try_clone().unwrap();
    let mut all = interrupts(source);
    let mut count = 0;
    for _ in 0..10 * PER_TICK {
        asked.write(1).unwrap();
        all.on_ready();
        count += u32::from(opened(&config));
    }
    assert_eq!(count, PER_TICK);
    assert!(all.take_news().is_empty());
    // What it has asked for is not forgotten.
    all.on_tick();
    assert!(opened(&config));
    assert_eq!(all.take_news().len(), 1);
    all.on_tick();
    assert!(!opened(&config));
    assert!(all.take_news().is_empty());
}

#[test]
fn a_device_that_fails_is_given_up_and_said_so_once() {
    let (mut source, device, _config) = source();
    // The device's end of the pipe is for writing, this one is not: the line cannot be opened.
    source.line = Arc::new(Line::Uio(reading_end(&source)));
    let asked = source.asked.try_clone().unwrap();
    let mut all = interrupts(source);
    asked.write(1).unwrap();
    all.on_ready();
    let news = all.take_news();
    assert_eq!(news.len(), 1, "{news:?}");
    assert!(news[0].starts_with("interrupt 64 of plc: given up: "), "{news:?}");
    asked.write(1).unwrap();
    all.on_ready();
    all.on_tick();
    assert!(all.take_news().is_empty());
    drop(device);
}

#[test]
fn a_line_that_cannot_be_read_any_more_is_given_up_too() {
    let (source, mut device, _config) = source();
    let signal = source.signal.try_clone().unwrap();
    let mut all = interrupts(source);
    // Half a counter is no interrupt.
    device.write_all(&[0; 2]).unwrap();
    all.on_ready();
    assert_eq!(all.take_news().len(), 1);
    device.write_all(&[0; 4]).unwrap();
    all.on_ready();
    assert!(all.take_news().is_empty() && signal.read().is_err());
}

#[test]
fn a_line_of_vfios_is_opened_by_an_eventfd_at_the_same_rate_and_is_not_read() {
    let (mut source, _device, _config) = source();
    // SAFETY: the name is a literal; the descriptor is new.
    let file =
        unsafe { File::from_raw_fd(libc::memfd_create(c"vfio".as_ptr(), libc::MFD_CLOEXEC)) };
    let opener = eventfd().unwrap();
    let opened = opener.try_clone().unwrap();
    let mut all = Interrupts::new().unwrap();
    let function = Arc::new(Device::of_file(file, 0, true));
    source.line = Arc::new(Line::Vfio { device: function, opener });
    assert!(source.line.teller().is_none() && !source.line.take().unwrap());
    let asked = source.asked.try_clone().unwrap();
    all.epoll
        .ctl(ControlOperation::Add, source.asked.as_raw_fd(), EpollEvent::new(EventSet::IN, ASKED))
        .unwrap();
    all.sources.push(source);

    let mut count = 0;
    for _ in 0..3 * PER_TICK {
        asked.write(1).unwrap();
        all.on_ready();
        count += opened.read().unwrap_or(0);
    }
    assert_eq!(count, u64::from(PER_TICK));
    all.on_tick();
    assert_eq!(opened.read().unwrap(), 1);
}

#[test]
fn a_line_that_cannot_be_connected_is_an_error() {
    // SAFETY: the name is a literal; the descriptor is new.
    let file =
        unsafe { File::from_raw_fd(libc::memfd_create(c"vfio".as_ptr(), libc::MFD_CLOEXEC)) };
    let device = Arc::new(Device::of_file(file, 0, true));
    assert!(device.opener().is_err());
    let line = Line::Vfio { device, opener: eventfd().unwrap() };
    assert!(line.connect(&eventfd().unwrap()).is_err());
}
