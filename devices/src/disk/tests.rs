//! The disk as a driver sees it, and as a hostile guest does: registers written and rings filled
//! by hand.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use vm_memory::{Bytes, GuestAddress, GuestMemoryMmap};

use super::device::DiskDevice;
use super::handover::Handover;
use super::server::{Disk, Server};
use super::{
    BUFFER_ALIGNMENT, DISCARD_SECTORS_MAX, Medium, PIECE_BYTES, QUEUE_SIZE, SECTOR,
    SEGMENT_BYTES_MAX, SEGMENTS_MAX, Shape,
};
use crate::virtio::driver::{HIGH, RAM, memory, page};
use crate::virtio::registers::Registers;

mod driver;
mod hostile;
mod requests;

/// Sectors of the disk here.
const SECTORS: u64 = 1024;
/// Where the guest keeps its things.
const TABLE: u64 = 0x1000;
const AVAILABLE: u64 = 0x2000;
const USED: u64 = 0x3000;
const HEADER: u64 = 0x4000;
const STATUS: u64 = 0x4800;
const DATA: u64 = 0x1_0000;

/// Status bytes of virtio's, and one that is none.
const OK: u8 = 0;
const IOERR: u8 = 1;
const UNSUPP: u8 = 2;
const UNTOUCHED: u8 = 0xee;

/// Kinds of requests.
const IN: u32 = 0;
const OUT: u32 = 1;
const FLUSH: u32 = 4;
const GET_ID: u32 = 8;
const DISCARD: u32 = 11;

/// Flags of descriptors.
const NEXT: u16 = 1;
const WRITE: u16 = 2;
const INDIRECT: u16 = 4;

/// A disk in memory, which counts what it is asked for.
struct Platter {
    bytes: Vec<u8>,
    transfers: Arc<AtomicUsize>,
    fails: Option<io::ErrorKind>,
}

impl Platter {
    fn begin(&self) -> io::Result<()> {
        self.transfers.fetch_add(1, Ordering::SeqCst);
        self.fails.map_or(Ok(()), |kind| Err(kind.into()))
    }
}

impl Medium for Platter {
    fn read(&mut self, at: u64, into: &mut [u8]) -> io::Result<()> {
        self.begin()?;
        assert!(into.as_ptr().addr().is_multiple_of(BUFFER_ALIGNMENT));
        into.copy_from_slice(&self.bytes[at as usize..][..into.len()]);
        Ok(())
    }

    fn write(&mut self, at: u64, from: &[u8]) -> io::Result<()> {
        self.begin()?;
        assert!(from.as_ptr().addr().is_multiple_of(BUFFER_ALIGNMENT));
        self.bytes[at as usize..][..from.len()].copy_from_slice(from);
        Ok(())
    }

    fn discard(&mut self, at: u64, bytes: u64) -> io::Result<()> {
        self.begin()?;
        self.bytes[at as usize..][..bytes as usize].fill(0);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.begin()
    }
}

/// A descriptor as it lies in the table.
#[derive(Clone, Copy)]
struct Descriptor {
    address: u64,
    bytes: u32,
    flags: u16,
    next: u16,
}

const fn readable(address: u64, bytes: u32) -> Descriptor {
    Descriptor { address, bytes, flags: 0, next: 0 }
}

const fn writable(address: u64, bytes: u32) -> Descriptor {
    Descriptor { address, bytes, flags: WRITE, next: 0 }
}

/// A guest with a disk.
struct Guest {
    memory: GuestMemoryMmap,
    registers: Registers,
    shared: Arc<Handover>,
    server: Server<Platter>,
    transfers: Arc<AtomicUsize>,
    available: u16,
}

impl Guest {
    /// Switched on, and no driver yet. Sector n of the disk is full of n.
    fn new(read_only: bool) -> Self {
        Self::with(read_only, None)
    }

    fn with(read_only: bool, fails: Option<io::ErrorKind>) -> Self {
        let memory = memory();
        let transfers = Arc::new(AtomicUsize::new(0));
        let bytes = (0..SECTORS * SECTOR).map(|n| (n / SECTOR) as u8).collect();
        let medium = Platter { bytes, transfers: transfers.clone(), fails };
        let shape = Shape { sectors: SECTORS, read_only };
        let page = page();
        let shared = Arc::new(Handover::new(page.clone()));
        let disk = Disk { shape, id: *b"twenty bytes of name", medium };
        Self {
            registers: Registers::new(DiskDevice::new(shape, shared.clone()), page),
            server: Server::new(shared.clone(), memory.clone(), disk),
            shared,
            memory,
            transfers,
            available: 0,
        }
    }

    /// With a driver that did everything right.
    fn driven(read_only: bool) -> Self {
        Self::new(read_only).drive()
    }

    fn drive(mut self) -> Self {
        self.start_driver();
        self
    }

    fn start_driver(&mut self) {
        self.set_up(QUEUE_SIZE.into(), [TABLE, AVAILABLE, USED]);
        assert_eq!(self.read(0x70), 0xf);
    }

    /// Steps of a driver up to its last, with any queue.
    fn set_up(&mut self, size: u32, parts: [u64; 3]) {
        self.available = 0;
        for at in [AVAILABLE, USED] {
            self.memory.write_obj(0u32, GuestAddress(at)).unwrap();
        }
        self.negotiate();
        self.registers.set_up_queue(0, size, parts);
        self.registers.set_running();
    }

    /// Up to `FEATURES_OK`, with all that is offered.
    fn negotiate(&mut self) {
        let offered = self.registers.offered();
        self.registers.accept(offered);
    }

    fn read(&self, offset: u64) -> u32 {
        self.registers.read_word(offset)
    }

    fn write(&mut self, offset: u64, value: u32) {
        self.registers.write_word(offset, value);
    }

    fn needs_reset(&self) -> bool {
        self.read(0x70) & 0x40 != 0
    }

    fn transfers(&self) -> usize {
        self.transfers.load(Ordering::SeqCst)
    }

    /// Writes descriptors into a table as they are.
    fn write_descriptors(&self, table: u64, first: u16, descriptors: &[Descriptor]) {
        for (n, d) in (u64::from(first)..).zip(descriptors) {
            let at = GuestAddress(table + 16 * n);
            self.memory.write_obj(d.address, at).unwrap();
            let rest = [d.bytes, u32::from(d.flags) | u32::from(d.next) << 16];
            self.memory.write_obj(rest, GuestAddress(at.0 + 8)).unwrap();
        }
    }

    /// Makes them a chain from the descriptor `first` on, and offers it.
    fn offer(&mut self, first: u16, descriptors: &[Descriptor]) {
        let mut chain = descriptors.to_vec();
        let last = chain.len() - 1;
        for (n, descriptor) in (first..).zip(&mut chain[..last]) {
            (descriptor.flags, descriptor.next) = (descriptor.flags | NEXT, n + 1);
        }
        self.write_descriptors(TABLE, first, &chain);
        self.make_available(first);
    }

    fn make_available(&mut self, head: u16) {
        let place = AVAILABLE + 4 + 2 * u64::from(self.available % QUEUE_SIZE);
        self.memory.write_obj(head, GuestAddress(place)).unwrap();
        self.available = self.available.wrapping_add(1);
        self.memory.write_obj(self.available, GuestAddress(AVAILABLE + 2)).unwrap();
    }

    fn write_header(&self, kind: u32, sector: u64) {
        self.memory.write_obj([kind, 0], GuestAddress(HEADER)).unwrap();
        self.memory.write_obj(sector, GuestAddress(HEADER + 8)).unwrap();
        self.memory.write_obj(UNTOUCHED, GuestAddress(STATUS)).unwrap();
    }

    /// What a request to discard names, to lie at `DATA`.
    fn write_discarded(&self, sector: u64, sectors: u32, flags: u32) {
        self.memory.write_obj(sector, GuestAddress(DATA)).unwrap();
        self.memory.write_obj([sectors, flags], GuestAddress(DATA + 8)).unwrap();
    }

    /// One request with these pieces between header and status. Returns its status.
    fn ask(&mut self, kind: u32, sector: u64, pieces: &[Descriptor]) -> u8 {
        self.write_header(kind, sector);
        let mut chain = vec![readable(HEADER, 16)];
        chain.extend(pieces);
        chain.push(writable(STATUS, 1));
        self.offer(0, &chain);
        assert!(self.server.serve(|| ()));
        self.status()
    }

    fn status(&self) -> u8 {
        self.memory.read_obj(GuestAddress(STATUS)).unwrap()
    }

    /// Index of the used ring, and head and length of its entry before.
    fn used(&self) -> (u16, u32, u32) {
        let index: u16 = self.memory.read_obj(GuestAddress(USED + 2)).unwrap();
        let last = u64::from(index.wrapping_sub(1) % QUEUE_SIZE);
        let [head, bytes] = self.memory.read_obj(GuestAddress(USED + 4 + 8 * last)).unwrap();
        (index, head, bytes)
    }

    /// Fails unless the device stopped without an answer, told the guest, and serves again after a
    /// reset.
    fn assert_broken_until_reset(&mut self) {
        assert!(self.server.serve(|| ()), "the guest is not interrupted");
        assert!(self.needs_reset() && self.shared.was_broken());
        assert_eq!(self.read(0x60) & 2, 2, "no interrupt for a change of the configuration");
        assert!(!self.server.serve(|| ()));
        self.start_driver();
        assert_eq!(self.read(0x60), 1);
        assert_eq!(self.ask(IN, 0, &[writable(DATA, 512)]), OK);
    }
}
