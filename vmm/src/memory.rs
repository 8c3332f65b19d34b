//! Guest memory: taken whole at start-up, and never again.
//!
//! Each region is mapped shared, prefaulted and (by the `mlockall` of `run`) locked: no page fault of
//! the host's can fall into a window, and the memory that a partition has is known before its first
//! instruction. None of it is ever in a core dump.
//!
//! Channels are the only memory that several guests see, so only they are files: sealed ones in
//! memory, one for each region. Which guest may write a region is a matter of the memory slots: in
//! all but one it is read-only.

use std::fs::File;
use std::io;
use std::marker::PhantomData;
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::Arc;

use kvm_bindings::{KVM_MEM_READONLY, kvm_userspace_memory_region};
use kvm_ioctls::VmFd;
use takt_abi::io::IoTable;
use takt_abi::memory::{
    INFORMATION, IO_TABLE, IO_TABLE_PAGES, PAGE, PORT_TABLE, PROGRAM_TABLE, STATUS,
};
use takt_abi::program::ProgramTable;
use takt_host::huge_pages;
use takt_plan::HugePageSize;
use takt_plan::linux_map::{HOLE_END, HOLE_START, VIRTIO_REGISTERS};
use thiserror::Error;
use vm_memory::mmap::{MmapRegionBuilder, MmapRegionError};
use vm_memory::{
    FileOffset, GuestAddress, GuestMemoryBackend, GuestMemoryMmap, GuestMemoryRegion,
    GuestRegionMmap, MmapRegion,
};

/// Guest memory could not be had.
#[derive(Debug, Error)]
pub enum MemoryError {
    /// The host has no memory to give, or no file for it.
    #[error("cannot allocate {bytes} bytes of guest memory: {source}")]
    Allocate {
        /// Size of the region.
        bytes: u64,
        /// What the host said.
        source: io::Error,
    },
    /// The region cannot be mapped.
    #[error("cannot map {bytes} bytes of guest memory: {reason}")]
    Map {
        /// Size of the region.
        bytes: u64,
        /// What vm-memory said.
        reason: String,
    },
    /// There are no huge pages for it any more.
    #[error(
        "cannot map {bytes} bytes of guest memory in huge pages of {size}: {source}; has another program taken some? {}/free_hugepages tells",
        huge_pages::folder(size.bytes())
    )]
    HugePages {
        /// Size of the region.
        bytes: u64,
        /// Size of the pages.
        size: HugePageSize,
        /// What the host said.
        source: io::Error,
    },
    /// KVM refused the memory slot.
    #[error("KVM refused the memory slot at {address:#x}: {source}")]
    Slot {
        /// Guest-physical start.
        address: u64,
        /// What KVM said.
        source: kvm_ioctls::Error,
    },
}

/// Of which pages of the host's a guest's RAM is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pages {
    /// Of 4 KiB.
    #[default]
    Small,
    /// Of huge pages, of which the RAM is a whole number.
    Huge(HugePageSize),
}

/// Memory that several guests see.
#[derive(Debug)]
pub struct SharedRegion {
    file: File,
    bytes: u64,
}

impl SharedRegion {
    /// Zeroed memory.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn new(bytes: u64) -> Result<Self, MemoryError> {
        Ok(Self { file: memfd(bytes)?, bytes })
    }

    /// Its length.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// A mapping for Takt's own use.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn map(&self, writable: bool) -> Result<MmapRegion, MemoryError> {
        let write = if writable { libc::PROT_WRITE } else { 0 };
        map(self.bytes, Source::File(self.file()?), libc::PROT_READ | write)
    }

    fn map_at(&self, start: u64) -> Result<GuestRegionMmap, MemoryError> {
        map_at(start, self.bytes, self.file()?)
    }

    fn file(&self) -> Result<File, MemoryError> {
        let allocate = |source| MemoryError::Allocate { bytes: self.bytes, source };
        self.file.try_clone().map_err(allocate)
    }
}

/// Where a guest sees a shared region.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Guest-physical start.
    pub start: u64,
    /// What it sees.
    pub region: &'a SharedRegion,
    /// Whether it may write there.
    pub writable: bool,
}

/// All memory of one guest. The first region is RAM from address 0.
#[derive(Clone)]
pub struct GuestMemory {
    regions: Arc<GuestMemoryMmap>,
    /// Starts of the regions that the guest may only read.
    read_only: Arc<[u64]>,
    pages: Pages,
}

impl GuestMemory {
    /// RAM of a Linux guest, with a hole below 4 GiB, and what it sees in there: its channels, and the registers of so
    /// many virtio devices.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn for_linux(
        bytes: u64,
        pages: Pages,
        channels: &[View<'_>],
        virtio: usize,
    ) -> Result<Self, MemoryError> {
        let low = bytes.min(HOLE_START);
        let mut regions = vec![region(0, low, pages)?];
        if bytes > low {
            regions.push(region(HOLE_END, bytes - low, pages)?);
        }
        let registers = VIRTIO_REGISTERS.into();
        if virtio > 0 {
            regions.push(region(registers, virtio as u64 * PAGE, Pages::Small)?);
        }
        Self::from_regions(regions, &[registers], channels, (bytes, pages))
    }

    /// RAM of a PLC guest, the pages through which it is told its time and its ports and tells
    /// its own, and the channels that it has an end of.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn for_plc(bytes: u64, pages: Pages, channels: &[View<'_>]) -> Result<Self, MemoryError> {
        Self::for_plc_with((bytes, pages), &[(INFORMATION, 1), (PORT_TABLE, 1)], channels)
    }

    /// As [`for_plc`](Self::for_plc), with the pages that tell the guest of its programs and of what is mapped to
    /// their inputs and outputs.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn for_plc_with_programs(
        bytes: u64,
        pages: Pages,
        channels: &[View<'_>],
    ) -> Result<Self, MemoryError> {
        let read_only =
            [(INFORMATION, 1), (PORT_TABLE, 1), (PROGRAM_TABLE, 1), (IO_TABLE, IO_TABLE_PAGES)];
        Self::for_plc_with((bytes, pages), &read_only, channels)
    }

    fn for_plc_with(
        (bytes, pages): (u64, Pages),
        read_only: &[(u64, u64)],
        channels: &[View<'_>],
    ) -> Result<Self, MemoryError> {
        let mut regions = vec![region(0, bytes, pages)?];
        for (start, count) in read_only.iter().chain([&(STATUS, 1)]) {
            regions.push(region(*start, count * PAGE, Pages::Small)?);
        }
        let starts: Vec<u64> = read_only.iter().map(|(start, _)| *start).collect();
        Self::from_regions(regions, &starts, channels, (bytes, pages))
    }

    /// Adds the channels to the guest's own regions, of which it may only read some.
    fn from_regions(
        mut regions: Vec<GuestRegionMmap>,
        read_only: &[u64],
        channels: &[View<'_>],
        (bytes, pages): (u64, Pages),
    ) -> Result<Self, MemoryError> {
        for view in channels {
            regions.push(view.region.map_at(view.start)?);
        }
        let views = channels.iter().filter(|view| !view.writable).map(|view| view.start);
        let read_only = read_only.iter().copied().chain(views).collect();
        regions.sort_by_key(|region| region.start_addr());
        let regions = GuestMemoryMmap::from_regions(regions)
            .map_err(|e| MemoryError::Map { bytes, reason: e.to_string() })?;
        Ok(Self { regions: Arc::new(regions), read_only, pages })
    }

    /// Gives all regions to a virtual machine. What the guest may only read becomes a read-only
    /// slot there: a write to it is an exit, not a change.
    ///
    /// # Errors
    /// [`MemoryError::Slot`].
    pub fn map_into(&self, vm: &VmFd) -> Result<(), MemoryError> {
        for (slot, region) in (0..).zip(self.regions.iter()) {
            let address = region.start_addr().0;
            let slot = kvm_userspace_memory_region {
                slot,
                flags: if self.read_only.contains(&address) { KVM_MEM_READONLY } else { 0 },
                guest_phys_addr: address,
                memory_size: region.len(),
                userspace_addr: region.as_ptr() as u64,
            };
            // SAFETY: the slot names exactly one mapping that belongs to `regions`. The thread
            // that runs the guest keeps a clone of `self` beside the vCPU, so that the mapping
            // outlives every use that KVM makes of it.
            unsafe { vm.set_user_memory_region(slot) }
                .map_err(|source| MemoryError::Slot { address, source })?;
        }
        Ok(())
    }

    /// Only RAM: for devices that read and write where the guest says. What the guest
    /// may only read is memory like any other to Takt.
    ///
    /// # Errors
    /// None that could happen: what is left out is there.
    pub fn only_ram(&self) -> Result<GuestMemoryMmap, MemoryError> {
        let in_hole = self.ranges().filter(|(start, _)| (HOLE_START..HOLE_END).contains(start));
        in_hole.into_iter().try_fold(self.regions().clone(), |all, (start, bytes)| {
            let (rest, _) = all
                .remove_region(GuestAddress(start), bytes)
                .map_err(|e| MemoryError::Map { bytes, reason: e.to_string() })?;
            Ok(rest)
        })
    }

    /// Of which pages its RAM is made.
    #[must_use]
    pub fn pages(&self) -> Pages {
        self.pages
    }

    /// The regions, for loaders.
    #[must_use]
    pub fn regions(&self) -> &GuestMemoryMmap {
        &self.regions
    }

    /// All ranges: guest-physical start and length.
    pub fn ranges(&self) -> impl Iterator<Item = (u64, u64)> {
        self.regions.iter().map(|r| (r.start_addr().0, r.len()))
    }

    /// Those of RAM. What lies in the hole is something else.
    pub fn ram(&self) -> impl Iterator<Item = (u64, u64)> {
        self.ranges().filter(|(start, _)| !(HOLE_START..HOLE_END).contains(start))
    }

    /// The information page of a PLC guest; `None` for other guests.
    #[must_use]
    pub fn information(&self) -> Option<Page<takt_abi::Information>> {
        self.page(INFORMATION)
    }

    /// The status page of a PLC guest; `None` for other guests.
    #[must_use]
    pub fn status(&self) -> Option<Page<takt_abi::Status>> {
        self.page(STATUS)
    }

    /// The port table, which lies at `address`; `None` if there is nothing.
    #[must_use]
    pub fn port_table(&self, address: u64) -> Option<Page<takt_abi::PortTable>> {
        self.page(address)
    }

    /// The program table of a PLC guest; `None` for guests without programs.
    #[must_use]
    pub fn program_table(&self) -> Option<Page<ProgramTable>> {
        self.page(PROGRAM_TABLE)
    }

    /// The I/O table of a PLC guest; `None` for guests without programs.
    #[must_use]
    pub fn io_table(&self) -> Option<Page<IoTable>> {
        self.page(IO_TABLE)
    }

    fn page<T: PageContent>(&self, address: u64) -> Option<Page<T>> {
        let region = self.regions.find_region(GuestAddress(address))?;
        let fits = region.start_addr().0 == address && region.len() >= size_of::<T>() as u64;
        fits.then(|| Page {
            start: region.as_ptr().cast(),
            _memory: self.clone(),
            _content: PhantomData,
        })
    }
}

/// A zeroed, prefaulted mapping of `bytes` at guest-physical `start`, which no descriptor leads to.
fn region(start: u64, bytes: u64, pages: Pages) -> Result<GuestRegionMmap, MemoryError> {
    let source = Source::Memory(pages);
    at(start, bytes, map(bytes, source, libc::PROT_READ | libc::PROT_WRITE)?)
}

/// A sealed file in memory.
fn memfd(bytes: u64) -> Result<File, MemoryError> {
    let allocate = |source| MemoryError::Allocate { bytes, source };
    // SAFETY: the name is a literal C string; the call has no other memory effect.
    let fd = unsafe {
        libc::memfd_create(c"takt-guest".as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING)
    };
    if fd < 0 {
        return Err(allocate(io::Error::last_os_error()));
    }
    // SAFETY: `fd` was just made and has no other owner.
    let file = unsafe { File::from_raw_fd(fd) };
    file.set_len(bytes).map_err(allocate)?;
    // A file that cannot shrink cannot turn an access of ours into a SIGBUS.
    let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL;
    // SAFETY: a plain integer argument to a descriptor that we own.
    if unsafe { libc::fcntl(file.as_raw_fd(), libc::F_ADD_SEALS, seals) } < 0 {
        return Err(allocate(io::Error::last_os_error()));
    }
    Ok(file)
}

/// Maps a file of `bytes` for the guest-physical address `start`, shared and prefaulted.
fn map_at(start: u64, bytes: u64, file: File) -> Result<GuestRegionMmap, MemoryError> {
    let source = Source::File(file);
    at(start, bytes, map(bytes, source, libc::PROT_READ | libc::PROT_WRITE)?)
}

fn at(start: u64, bytes: u64, mapping: MmapRegion) -> Result<GuestRegionMmap, MemoryError> {
    GuestRegionMmap::new(mapping, GuestAddress(start)).ok_or_else(|| MemoryError::Map {
        bytes,
        reason: format!("it would pass the end of the address space at {start:#x}"),
    })
}

/// What is mapped.
enum Source {
    File(File),
    /// Memory that no file leads to.
    Memory(Pages),
}

/// Maps `bytes`, shared and prefaulted.
fn map(bytes: u64, source: Source, protection: libc::c_int) -> Result<MmapRegion, MemoryError> {
    let map = |reason: String| MemoryError::Map { bytes, reason };
    let size = usize::try_from(bytes).map_err(|e| map(e.to_string()))?;
    let builder = MmapRegionBuilder::new(size).with_mmap_prot(protection);
    let flags = libc::MAP_SHARED | libc::MAP_POPULATE;
    let mapping = match source {
        Source::File(file) => {
            let whole = FileOffset::new(file, 0);
            builder.with_file_offset(whole).with_mmap_flags(flags).build()
        }
        Source::Memory(Pages::Small) => {
            builder.with_mmap_flags(flags | libc::MAP_ANONYMOUS).build()
        }
        Source::Memory(Pages::Huge(page)) => {
            let huge = |source| MemoryError::HugePages { bytes, size: page, source };
            let log = page.bytes().trailing_zeros().cast_signed() << libc::MAP_HUGE_SHIFT;
            let flags = flags | libc::MAP_ANONYMOUS | libc::MAP_HUGETLB | log;
            let mapping = match builder.with_mmap_flags(flags).build() {
                Err(MmapRegionError::Mmap(source)) => return Err(huge(source)),
                other => other.map_err(|e| map(e.to_string()))?,
            };
            populate(&mapping).map_err(huge)?;
            Ok(mapping)
        }
    };
    let mapping = mapping.map_err(|e| map(e.to_string()))?;
    // SAFETY: concerns core dumps only, of exactly the mapping that was just made.
    let result = unsafe { libc::madvise(mapping.as_ptr().cast(), size, libc::MADV_DONTDUMP) };
    if result != 0 {
        return Err(map(io::Error::last_os_error().to_string()));
    }
    Ok(mapping)
}

/// Makes sure that each page is there. `MAP_POPULATE` keeps quiet of a huge page that cannot be had, for
/// instance since a cpuset does not let this process have it, and the first access would end the process.
fn populate(mapping: &MmapRegion) -> io::Result<()> {
    // SAFETY: allocates the pages of exactly this mapping, whose content stays as it is.
    let result = unsafe {
        libc::madvise(mapping.as_ptr().cast(), mapping.size(), libc::MADV_POPULATE_WRITE)
    };
    match io::Error::last_os_error() {
        // Kernels before Linux 5.14 do not know it.
        error if result != 0 && error.raw_os_error() != Some(libc::EINVAL) => Err(error),
        _ => Ok(()),
    }
}

/// What may lie in a [`Page`]: plain integers, any bit pattern of which is a value.
///
/// # Safety
/// The type must be `Copy`, without padding, references or invalid bit patterns.
pub unsafe trait PageContent: Copy {}

// SAFETY: `repr(C)`, made of u32 and u64 without padding (sizes asserted in takt-abi).
unsafe impl PageContent for takt_abi::Information {}
// SAFETY: as above.
unsafe impl PageContent for takt_abi::Status {}
// SAFETY: as above.
unsafe impl PageContent for takt_abi::PortTable {}
// SAFETY: as above.
unsafe impl PageContent for ProgramTable {}
// SAFETY: as above.
unsafe impl PageContent for IoTable {}

/// One or more pages that host and guest both see, as a value that is copied whole.
///
/// A copy out is a snapshot of what the guest claims: it can be torn or nonsense, never unsound.
pub struct Page<T> {
    start: *mut T,
    _memory: GuestMemory,
    _content: PhantomData<T>,
}

// SAFETY: the pointer is to memory that `_memory` keeps mapped, wherever the page is moved to.
unsafe impl<T: PageContent> Send for Page<T> {}

impl<T: PageContent> Page<T> {
    /// Copies the content out.
    #[must_use]
    #[inline]
    pub fn read(&self) -> T {
        // SAFETY: mapped for as long as `_memory` lives, page-aligned, large enough (checked
        // when the page was made), and any bit pattern is a T. Volatile, since a guest may write.
        unsafe { self.start.read_volatile() }
    }

    /// Replaces the content.
    #[inline]
    pub fn write(&mut self, content: T) {
        // SAFETY: as for `read`.
        unsafe { self.start.write_volatile(content) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::memory::CHANNELS;
    use vm_memory::Bytes;

    #[test]
    fn linux_has_its_channels_in_the_hole_and_they_are_no_ram() {
        let shared = SharedRegion::new(PAGE).unwrap();
        let view = |start, writable| View { start, region: &shared, writable };
        let views = [view(HOLE_END - PAGE, true), view(HOLE_START, false)];
        let memory = GuestMemory::for_linux(64 << 20, Pages::Small, &views, 2).unwrap();
        let ram = (0, 64 << 20);
        let registers = u64::from(VIRTIO_REGISTERS);
        let devices = [(HOLE_START, PAGE), (registers, 2 * PAGE), (HOLE_END - PAGE, PAGE)];
        let all = [&[ram], &devices[..]].concat();
        assert_eq!(memory.ranges().collect::<Vec<_>>(), all);
        assert_eq!(memory.ram().collect::<Vec<_>>(), [ram]);
        assert_eq!(*memory.read_only, [registers, HOLE_START]);
        let only_ram = memory.only_ram().unwrap();
        assert_eq!(only_ram.iter().map(|r| (r.start_addr().0, r.len())).collect::<Vec<_>>(), [ram]);
    }

    #[test]
    fn a_plc_has_its_pages_and_linux_has_none() {
        let memory = GuestMemory::for_plc(2 << 20, Pages::Small, &[]).unwrap();
        let mut page = memory.information().unwrap();
        let mut information = page.read();
        assert_eq!(information.magic, 0);
        information.release = 7;
        page.write(information);
        assert_eq!(memory.information().unwrap().read().release, 7);
        assert!(memory.status().is_some() && memory.program_table().is_none());
        let with_programs = GuestMemory::for_plc_with_programs(2 << 20, Pages::Small, &[]).unwrap();
        assert!(with_programs.program_table().is_some() && with_programs.io_table().is_some());
        assert!([PROGRAM_TABLE, IO_TABLE].iter().all(|p| with_programs.read_only.contains(p)));
        let linux = GuestMemory::for_linux(1 << 20, Pages::Small, &[], 0).unwrap();
        assert!(linux.information().is_none());
    }

    #[test]
    fn what_one_guest_writes_to_a_channel_the_other_sees() {
        let shared = SharedRegion::new(PAGE).unwrap();
        let view = |start, writable| View { start, region: &shared, writable };
        let source = GuestMemory::for_plc(2 << 20, Pages::Small, &[view(CHANNELS, true)]).unwrap();
        let other = CHANNELS + PAGE;
        let destination =
            GuestMemory::for_plc(2 << 20, Pages::Small, &[view(other, false)]).unwrap();
        source.regions().write_obj(7u64, GuestAddress(CHANNELS)).unwrap();
        let seen: u64 = destination.regions().read_obj(GuestAddress(other)).unwrap();
        assert_eq!(seen, 7);
        assert_eq!(*source.read_only, [INFORMATION, PORT_TABLE]);
        assert_eq!(*destination.read_only, [INFORMATION, PORT_TABLE, other]);
    }

    #[test]
    fn memory_that_does_not_exist_is_an_error() {
        assert!(GuestMemory::for_plc(u64::MAX, Pages::Small, &[]).is_err());
        assert!(GuestMemory::for_plc(1 << 50, Pages::Small, &[]).is_err());
    }
}
