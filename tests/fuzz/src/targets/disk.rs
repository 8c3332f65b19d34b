//! A driver of a virtio disk that fills registers, rings and descriptors with whatever it likes, at
//! any moment.

use std::io;
use std::sync::Arc;

use takt_devices::disk::device::DiskDevice;
use takt_devices::disk::handover::Handover;
use takt_devices::disk::server::{Disk, Server};
use takt_devices::disk::{Medium, SECTOR, Shape};
use takt_devices::virtio::page::{BYTES, RegisterPage};
use takt_devices::virtio::registers::Registers;
use vm_memory::{Bytes, GuestAddress, GuestMemoryMmap};

const SECTORS: u64 = 64;
/// RAM of the guest: what 16 bits can address.
const RAM: usize = 1 << 16;
/// Where the queue's three parts lie at first.
const QUEUE: [u32; 3] = [0x1000, 0x2000, 0x3000];

/// A disk that holds nothing, and to which no transfer may come that leaves it.
struct Void;

impl Void {
    fn check(at: u64, bytes: u64) {
        let end = at.checked_add(bytes);
        assert!(end.is_some_and(|end| end <= SECTORS * SECTOR), "{bytes} bytes at {at}");
    }
}

impl Medium for Void {
    fn read(&mut self, at: u64, into: &mut [u8]) -> io::Result<()> {
        Self::check(at, into.len() as u64);
        Ok(())
    }

    fn write(&mut self, at: u64, from: &[u8]) -> io::Result<()> {
        Self::check(at, from.len() as u64);
        Ok(())
    }

    fn discard(&mut self, at: u64, bytes: u64) -> io::Result<()> {
        Self::check(at, bytes);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Steps of an honest driver, up to its last: registers and what it writes there.
fn honest() -> impl Iterator<Item = (u64, u32)> {
    let [table, available, used] = QUEUE;
    let addresses = [(0x80, table), (0x90, available), (0xa0, used)];
    [
        (0x70, 0),
        (0x70, 3),
        (0x24, 0),
        (0x20, 1 << 9 | 1 << 13),
        (0x24, 1),
        (0x20, 1),
        (0x70, 0xb),
        (0x38, 16),
    ]
    .into_iter()
    .chain(addresses)
    .chain([(0x44, 1), (0x70, 0xf)])
}

/// Begins as an honest driver would and goes on as the bytes say: a byte for the kind of step, two
/// for a register or an address, one for a length, and what is written.
///
/// # Panics
/// If a transfer leaves the disk, or what may only be read is written.
pub fn run(mut data: &[u8]) {
    let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), RAM)]).expect("memory");
    let page = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), BYTES as usize)]).expect("memory");
    let page = RegisterPage::new(&page, 0).expect("a page");
    let shape = Shape { sectors: SECTORS, read_only: false };
    let shared = Arc::new(Handover::new(page.clone()));
    let disk = Disk { shape, id: *b"twenty bytes of name", medium: Void };
    let mut server = Server::new(shared.clone(), memory.clone(), disk);
    let mut registers = Registers::new(DiskDevice::new(shape, shared.clone()), page.clone());
    for (register, value) in honest() {
        registers.write(register, &value.to_le_bytes());
    }
    while let [what, low, high, length, rest @ ..] = data {
        let at = u16::from_le_bytes([*low, *high]);
        let (bytes, after) = rest.split_at(usize::from(*length).min(rest.len()));
        data = after;
        match what % 8 {
            0 | 1 => registers.write(u64::from(at % 0x200), &bytes[..bytes.len().min(8)]),
            2 => {
                shared.recall();
                registers = Registers::new(DiskDevice::new(shape, shared.clone()), page.clone());
            }
            3 => {
                let _ = server.serve(|| ());
            }
            // What the guest writes behind the end of its memory is lost, as on a PC.
            _ => {
                let _ = memory.write_slice(bytes, GuestAddress(at.into()));
            }
        }
    }
    let _ = server.serve(|| ());
}
