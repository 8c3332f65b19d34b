//! A socket pair stands for the UIO device: readable after a ring, until the ring is read.

use std::fs;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;

use super::*;

fn pair() -> (Waiter, UnixStream) {
    let (device, bell) = UnixStream::pair().unwrap();
    device.set_nonblocking(true).unwrap();
    let uio = File::from(OwnedFd::from(device));
    (Waiter { doorbell: Some(Doorbell { uio, config: None }) }, bell)
}

fn ring(mut bell: &UnixStream) {
    bell.write_all(&1_u32.to_le_bytes()).unwrap();
}

#[test]
fn a_ring_before_the_wait_ends_it_at_once() {
    let (mut waiter, bell) = pair();
    ring(&bell);
    // For ever, if the ring were lost.
    assert!(waiter.wait(Deadline::Never).unwrap());
}

#[test]
fn each_ring_ends_one_wait_and_the_time_ends_the_next() {
    let (mut waiter, bell) = pair();
    ring(&bell);
    assert!(waiter.wait(Deadline::Never).unwrap());
    let deadline = Timeout::Within(Duration::from_millis(20)).deadline();
    let before = Instant::now();
    assert!(waiter.wait(deadline).unwrap(), "one more look when the time is over");
    assert!(before.elapsed() >= Duration::from_millis(15), "the ring was read twice");
    assert!(!waiter.wait(deadline).unwrap());
}

#[test]
fn a_ring_during_the_wait_ends_it() {
    let (mut waiter, bell) = pair();
    let ringer = thread::spawn(move || {
        ring(&bell);
        bell
    });
    assert!(waiter.wait(Deadline::Never).unwrap());
    ringer.join().unwrap();
}

#[test]
fn a_device_that_is_gone_leaves_polling() {
    let (mut waiter, bell) = pair();
    drop(bell);
    assert!(waiter.wait(Deadline::Never).unwrap());
    assert!(waiter.doorbell.is_none());
    assert!(waiter.wait(Deadline::Never).unwrap());
}

#[test]
fn no_time_is_no_wait() {
    let (mut waiter, bell) = pair();
    ring(&bell);
    assert!(!waiter.wait(Timeout::Zero.deadline()).unwrap());
    assert!(!waiter.wait(Deadline::At(Instant::now())).unwrap());
    let _ = bell;
}

#[test]
fn a_time_beyond_the_clock_is_for_ever() {
    assert!(matches!(Timeout::Within(Duration::MAX).deadline(), Deadline::Never));
}

#[test]
fn the_interrupt_is_enabled_again_and_nothing_else_of_the_command_is_changed() {
    let folder = std::env::temp_dir().join(format!("takt-port-config-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let config = [0xf4, 0x1a, 0xf0, 0x10, 0x06, 0x04, 0x08, 0x00];
    fs::write(folder.join("config"), config).unwrap();
    // Any file that can be opened stands for the device.
    let waiter = Waiter::listening(&folder.join("config"), &folder).unwrap();
    let expected = [0xf4, 0x1a, 0xf0, 0x10, 0x06, 0x00, 0x08, 0x00];
    assert_eq!(fs::read(folder.join("config")).unwrap(), expected);
    drop(waiter);
    fs::remove_dir_all(&folder).unwrap();
}
