//! A driver that resets a disk which is busy with requests that it cannot do.
//!
//!     reset-disk SLOT
//!
//! It takes the registers of a virtio disk, by its number among the virtio devices, whose own driver has to be unbound,
//! and writes to the disk until nothing is done any more. Then it takes the disk away from its requests by a reset, and takes
//! the memory of the requests for its own at once, as Linux's driver does; gives the disk another queue, which the
//! disk cannot serve either, and resets that. At last it says so on the kernel's log, and waits until the disk serves a queue
//! again.
//!
//! Exit status 0: each reset was complete when it was written, the last queue was served, and nothing
//! was written to the memory of the others.

#[path = "hostile-virtio/memory.rs"]
mod memory;
#[path = "hostile-virtio/registers.rs"]
mod registers;

use std::fs;
use std::io;
use std::process::ExitCode;
use std::thread;
use std::time::{Duration, Instant};

use memory::{PAGE, Page};
use registers::{
    ACCEPTED, ACCEPTED_SELECT, AVAILABLE, DESCRIPTORS, NOTIFY, QUEUE_READY, QUEUE_SELECT,
    QUEUE_SIZE, STATUS, USED,
};

/// More registers of virtio 1.2, section 4.2.2.
const OFFERED: u64 = 0x10;
const OFFERED_SELECT: u64 = 0x14;
const INTERRUPTS: u64 = 0x60;
const ACKNOWLEDGE: u64 = 0x64;

/// Of the lower features: `VIRTIO_BLK_F_FLUSH`. Of the upper ones: `VIRTIO_F_VERSION_1`.
const FEATURES: [u32; 2] = [1 << 9, 1];
const ENTRIES: u32 = 64;
const NEXT: u16 = 1;
const WRITE: u16 = 2;

/// Kinds of requests.
const IN: u32 = 0;
const OUT: u32 = 1;
/// The sectors that are read and written, of a page together.
const SECTOR: u64 = 16;
/// The value of a status that the disk has not written yet, and of all memory that is not the disk's any more.
const UNTOUCHED: u8 = 0xa5;
/// How long nothing is done by a disk that stands still.
const STILL: Duration = Duration::from_millis(300);
/// Queues that are taken away from the disk.
const RESETS: usize = 3;

/// A queue with the memory of its requests.
struct Queue {
    descriptors: Page,
    available: Page,
    used: Page,
    /// Headers and statuses: 32 bytes for each request.
    heads: Page,
    data: Page,
    requests: u16,
}

impl Queue {
    fn new() -> io::Result<Self> {
        let page = Page::of_memory;
        let pages = (page()?, page()?, page()?, page()?, page()?);
        let (descriptors, available, used, heads, data) = pages;
        Ok(Self { descriptors, available, used, heads, data, requests: 0 })
    }

    /// Offers one more request for the whole page of data.
    fn offer(&mut self, kind: u32) {
        let slot = u64::from(self.requests) % (u64::from(ENTRIES) / 3);
        let head = 32 * slot;
        self.heads.store(head, kind);
        self.heads.store(head + 4, 0_u32);
        self.heads.store(head + 8, SECTOR);
        self.heads.store(head + 16, UNTOUCHED);
        let data = if kind == IN { WRITE } else { 0 };
        let first = 3 * slot as u16;
        self.describe(first, self.heads.physical + head, 16, NEXT);
        self.describe(first + 1, self.data.physical, PAGE as u32, NEXT | data);
        self.describe(first + 2, self.heads.physical + head + 16, 1, WRITE);
        self.available.store(4 + 2 * (u64::from(self.requests) % u64::from(ENTRIES)), first);
        self.requests = self.requests.wrapping_add(1);
        self.available.store(2, self.requests);
    }

    fn describe(&self, number: u16, at: u64, length: u32, flags: u16) {
        let place = 16 * u64::from(number);
        self.descriptors.store(place, at);
        self.descriptors.store(place + 8, length);
        self.descriptors.store(place + 12, flags);
        self.descriptors.store(place + 14, number + 1);
    }

    fn done(&self) -> u16 {
        self.used.load(2)
    }

    /// Waits until all requests are done; false if none is for so long.
    fn wait(&self, time: Duration) -> bool {
        let begin = Instant::now();
        while self.done() != self.requests {
            if begin.elapsed() > time {
                return false;
            }
            thread::sleep(Duration::from_millis(1));
        }
        true
    }

    fn all_good(&self) -> bool {
        let slots = u64::from(self.requests).min(u64::from(ENTRIES) / 3);
        (0..slots).all(|slot| self.heads.load::<u8>(32 * slot + 16) == 0)
    }

    const fn written_by_the_disk(&self) -> [Page; 3] {
        [self.used, self.heads, self.data]
    }

    /// Takes the memory for its own.
    fn take(&self) {
        for page in self.written_by_the_disk() {
            (0..PAGE).for_each(|place| page.store(place, UNTOUCHED));
        }
    }

    fn is_untouched(&self) -> bool {
        let same = |page: &Page| (0..PAGE).all(|place| page.load::<u8>(place) == UNTOUCHED);
        self.written_by_the_disk().iter().all(same)
    }
}

struct Disk(Page);

impl Disk {
    /// Gives the disk a queue, as section 3.1.1 wants it.
    fn start(&self) -> io::Result<Queue> {
        let Self(registers) = self;
        let queue = Queue::new()?;
        registers.store(STATUS, 1_u32 | 2);
        for (select, features) in (0_u32..).zip(FEATURES) {
            registers.store(OFFERED_SELECT, select);
            registers.store(ACCEPTED_SELECT, select);
            registers.store(ACCEPTED, registers.load::<u32>(OFFERED) & features);
        }
        registers.store(STATUS, 1_u32 | 2 | 8);
        registers.store(QUEUE_SELECT, 0_u32);
        registers.store(QUEUE_SIZE, ENTRIES);
        let pages =
            [(DESCRIPTORS, queue.descriptors), (AVAILABLE, queue.available), (USED, queue.used)];
        for (register, page) in pages {
            registers.store(register, page.physical as u32);
            registers.store(register + 4, (page.physical >> 32) as u32);
        }
        registers.store(QUEUE_READY, 1_u32);
        registers.store(STATUS, 1_u32 | 2 | 4 | 8);
        match registers.load::<u32>(STATUS) {
            15 => Ok(queue),
            status => Err(io::Error::other(format!("the disk's status is {status:#x}"))),
        }
    }

    fn notify(&self) {
        self.0.store(NOTIFY, 0_u32);
    }

    /// How long it took until the disk said that it was reset.
    fn reset(&self) -> Duration {
        let begin = Instant::now();
        self.0.store(STATUS, 0_u32);
        while self.0.load::<u32>(STATUS) != 0 {
            std::hint::spin_loop();
        }
        begin.elapsed()
    }

    /// Interrupts have no handler here.
    fn acknowledge(&self) {
        self.0.store(ACKNOWLEDGE, self.0.load::<u32>(INTERRUPTS));
    }
}

fn run(slot: u64) -> io::Result<bool> {
    let disk = Disk(Page::of_registers(slot)?);
    disk.reset();
    let mut queue = disk.start()?;
    let mut before = 0_u64;
    loop {
        queue.offer(OUT);
        disk.notify();
        if !queue.wait(STILL) {
            break;
        }
        disk.acknowledge();
        before += 1;
    }
    // A write is stuck, with a read and a write behind it that the disk has not begun.
    let mut lost = Vec::new();
    let mut longest = Duration::ZERO;
    for _ in 0..RESETS {
        queue.offer(IN);
        queue.offer(OUT);
        disk.notify();
        if queue.wait(STILL) {
            return Err(io::Error::other("the disk does not stand still"));
        }
        longest = longest.max(disk.reset());
        queue.take();
        lost.push(queue);
        queue = disk.start()?;
    }
    fs::write("/dev/kmsg", "reset-under-requests\n")?;
    queue.offer(IN);
    disk.notify();
    let served = queue.wait(Duration::from_secs(60)) && queue.all_good();
    // What the disk was busy with is over before it serves another queue.
    let untouched = lost.iter().all(Queue::is_untouched);
    disk.reset();
    println!(
        "reset-disk: {before} writes, {RESETS} resets, the longest of {} ns; served again: {served}; \
         memory of lost requests untouched: {untouched}",
        longest.as_nanos()
    );
    Ok(served && untouched)
}

fn main() -> ExitCode {
    let slot = std::env::args().nth(1).and_then(|word| word.parse().ok());
    let Some(slot) = slot else {
        eprintln!("usage: reset-disk SLOT");
        return ExitCode::from(64);
    };
    match run(slot) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            println!("reset-disk: {error}");
            ExitCode::from(70)
        }
    }
}
