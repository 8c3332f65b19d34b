//! The memory of a program: one file that this tool and the program's process both map.

use std::ffi::c_int;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

use takt_program::{Area, Image, address, limit};

use super::HostError;

/// What a job's return address points to: the call END; see `takt_program::call::Call::End`.
/// `xor eax, eax; syscall; ud2`.
const END_STUB: [u8; 6] = [0x31, 0xc0, 0x0f, 0x05, 0x0f, 0x0b];
/// Where [`CLEAR_STUB`] lies in the call page.
const CLEAR_AT: u64 = 64;
/// Unmaps what this tool had mapped, and stops: `munmap(rdi, rsi); munmap(r12, r13); int3`.
/// `mov eax, 11; syscall; mov rdi, r12; mov rsi, r13; mov eax, 11; syscall; int3`.
const CLEAR_STUB: [u8; 21] = [
    0xb8, 0x0b, 0, 0, 0, 0x0f, 0x05, 0x4c, 0x89, 0xe7, 0x4c, 0x89, 0xee, 0xb8, 0x0b, 0, 0, 0, 0x0f,
    0x05, 0xcc,
];

/// What may be done with a region at ring 3.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Rights {
    Read,
    Write,
    Execute,
}

impl Rights {
    pub const fn protection(self) -> c_int {
        match self {
            Self::Read => libc::PROT_READ,
            Self::Write => libc::PROT_READ | libc::PROT_WRITE,
            Self::Execute => libc::PROT_READ | libc::PROT_EXEC,
        }
    }
}

/// Some pages of the program's address space.
#[derive(Clone, Copy)]
pub struct Region {
    pub address: u64,
    pub bytes: u64,
    pub rights: Rights,
    /// Where they lie in the file.
    pub offset: u64,
}

/// All memory of a program.
pub struct Memory {
    file: OwnedFd,
    base: *mut u8,
    bytes: u64,
    regions: Vec<Region>,
}

impl Memory {
    /// Code, constants and initial state of the image, and zeros elsewhere. `inputs` is what the program may do with
    /// its inputs.
    pub fn new(image: &Image<'_>, inputs: Rights) -> Result<Self, HostError> {
        let (regions, bytes) = regions(image, inputs);
        // SAFETY: the name is a C string; the result is checked.
        let fd = unsafe { libc::memfd_create(c"takt-program".as_ptr(), libc::MFD_CLOEXEC) };
        if fd < 0 {
            return Err(HostError::last("memfd_create"));
        }
        // SAFETY: the descriptor is new and has no other owner.
        let file = unsafe { OwnedFd::from_raw_fd(fd) };
        // SAFETY: an own file is made larger. It has at most some hundred MiB.
        if unsafe { libc::ftruncate(fd, bytes.cast_signed()) } != 0 {
            return Err(HostError::last("ftruncate"));
        }
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        // SAFETY: a new mapping at an address of the kernel's choice.
        let base = unsafe {
            libc::mmap(std::ptr::null_mut(), bytes as usize, protection, libc::MAP_SHARED, fd, 0)
        };
        if base == libc::MAP_FAILED {
            return Err(HostError::last("mmap"));
        }
        let memory = Self { file, base: base.cast(), bytes, regions };
        memory.put(address::CALL_PAGE, &END_STUB);
        memory.put(address::CALL_PAGE + CLEAR_AT, &CLEAR_STUB);
        memory.put(address::CODE, image.code());
        memory.put(image.constants_address(), image.constants());
        memory.put(address::STATE, image.state());
        Ok(memory)
    }

    /// Where the code lies that clears the process of all else.
    pub const fn clear_stub() -> u64 {
        address::CALL_PAGE + CLEAR_AT
    }

    pub fn regions(&self) -> &[Region] {
        &self.regions
    }

    pub fn descriptor(&self) -> c_int {
        self.file.as_raw_fd()
    }

    /// Whether the program may read, or write, all of these bytes. As in the kernel, no bytes at all are allowed at any address.
    pub fn allows(&self, at: u64, bytes: u64, write: bool) -> bool {
        let found = self.find(at, bytes);
        bytes == 0 || found.is_some_and(|region| !write || region.rights == Rights::Write)
    }

    /// The region that has this address.
    pub fn region(&self, at: u64) -> Option<&Region> {
        self.find(at, 1)
    }

    fn find(&self, at: u64, bytes: u64) -> Option<&Region> {
        self.regions.iter().find(|region| {
            at.checked_sub(region.address)
                .and_then(|offset| offset.checked_add(bytes))
                .is_some_and(|end| end <= region.bytes)
        })
    }

    /// A copy of these bytes, or of none if they are not all in one region.
    pub fn get(&self, at: u64, bytes: u64) -> Option<Vec<u8>> {
        if bytes == 0 {
            return Some(Vec::new());
        }
        let region = self.find(at, bytes)?;
        let mut copy = vec![0; bytes as usize];
        let from = (region.offset + at - region.address) as usize;
        // SAFETY: `find` has checked that the bytes are inside of the mapping. The program's process, which could
        // write them, is stopped whenever this runs.
        unsafe { self.base.add(from).copy_to_nonoverlapping(copy.as_mut_ptr(), copy.len()) };
        Some(copy)
    }

    /// Writes these bytes, whatever the program's rights are. False if they are not all in one region.
    pub fn put(&self, at: u64, bytes: &[u8]) -> bool {
        let Some(region) = self.find(at, bytes.len() as u64) else { return false };
        let to = (region.offset + at - region.address) as usize;
        // SAFETY: as for `get`.
        unsafe { self.base.add(to).copy_from_nonoverlapping(bytes.as_ptr(), bytes.len()) };
        true
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: the mapping is ours, and no reference into it exists outside of `get` and `put`.
        unsafe { libc::munmap(self.base.cast(), self.bytes as usize) };
    }
}

/// The regions of a program, and the size of the file for them.
fn regions(image: &Image<'_>, inputs: Rights) -> (Vec<Region>, u64) {
    let mut regions = Vec::new();
    let mut end = 0;
    let mut add = |address, bytes, rights| {
        let bytes = address::pages(bytes);
        if bytes > 0 {
            regions.push(Region { address, bytes, rights, offset: end });
            end += bytes;
        }
    };
    add(address::CALL_PAGE, address::PAGE, Rights::Execute);
    add(address::CODE, image.code().len() as u64, Rights::Execute);
    add(image.constants_address(), image.constants().len() as u64, Rights::Read);
    add(address::STATE, image.state_bytes().into(), Rights::Write);
    for task in image.tasks() {
        let bytes = u64::from(task.stack_bytes.min(limit::STACK_BYTES));
        add(address::stack_end(task.id) - bytes, bytes, Rights::Write);
    }
    add(address::INPUT, image.area_bytes(Area::Input).into(), inputs);
    add(address::OUTPUT, image.area_bytes(Area::Output).into(), Rights::Write);
    add(address::MARKER, image.area_bytes(Area::Marker).into(), Rights::Write);
    add(address::TASK_INFORMATION, address::PAGE, Rights::Read);
    (regions, end)
}
