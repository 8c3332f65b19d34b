//! What a PLC guest can say to Takt: writes to its ports, and the page that it leaves for them.

use std::cell::RefCell;
use std::thread_local;

use kvm_ioctls::VcpuExit;
use takt::memory::{GuestMemory, Pages};
use takt::vcpu::guest::Guest;
use takt::vcpu::plc::PlcGuest;
use takt_abi::memory::STATUS;
use takt_devices::output::{self, OutputEnd};
use takt_scheduler::time::Nanos;
use vm_memory::{Bytes, GuestAddress};

const RAM: u64 = 2 << 20;
/// Of the status page, what one step overwrites at most.
const WRITTEN: usize = 64;

struct Subject {
    memory: GuestMemory,
    guest: PlcGuest,
    console: OutputEnd,
}

thread_local! {
    // One for all cases, as a guest may misbehave for as long as it runs.
    static SUBJECT: RefCell<Subject> = RefCell::new(subject());
}

fn subject() -> Subject {
    let memory = GuestMemory::for_plc(RAM, Pages::Small, &[]).expect("memory");
    let (text, console) = output::dropping();
    let guest = PlcGuest::new(&memory, RAM, 1_000_000, Nanos(1_000_000), text);
    Subject { guest: guest.expect("memory of a PLC"), memory, console }
}

/// Makes one exit after the other: a byte for its kind, two for port or place, four of data, and
/// what the guest writes into its status page before.
///
/// # Panics
/// If a read is not answered with all ones.
pub fn run(mut data: &[u8]) {
    SUBJECT.with_borrow_mut(|subject| {
        let mut text = Vec::new();
        while let [what, low, high, a, b, c, d, rest @ ..] = data {
            let number = u16::from_le_bytes([*low, *high]);
            let mut bytes = [*a, *b, *c, *d];
            let width = 1 << (what >> 6 & 1) << (what >> 7);
            let (written, after) = rest.split_at(rest.len().min(WRITTEN));
            data = after;
            let at = STATUS + u64::from(number) % (4096 - WRITTEN as u64);
            let _ = subject.memory.regions().write_slice(written, GuestAddress(at));
            let _ = match what & 3 {
                0 => subject.guest.handle(VcpuExit::IoOut(number, &bytes[..width])),
                1 => {
                    let step = subject.guest.handle(VcpuExit::IoIn(number, &mut bytes[..width]));
                    assert!(bytes[..width].iter().all(|&byte| byte == 0xff));
                    step
                }
                2 => subject.guest.handle(VcpuExit::MmioWrite(at, &bytes[..width])),
                _ => subject.guest.handle(VcpuExit::MmioRead(at, &mut bytes[..width])),
            };
            let _ = (subject.guest.claim(u64::from(number)), subject.guest.last_stamp());
            subject.console.drain_into(&mut text);
        }
    });
}
