//! Starting a vCPU in 64-bit mode, without a firmware or a boot sector.
//!
//! Both guests begin here: the PLC because it should run its own code from the first instruction,
//! Linux because its 64-bit boot protocol asks for just this state. The structures that the
//! processor needs before the guest has its own lie below 1 MiB:
//!
//! | address | what |
//! | --- | --- |
//! | `0x0500` | descriptor table: null, code at 0x10, data at 0x18, as Linux wants it |
//! | `0x8ff0` | top of a small stack |
//! | `0x9000` | page map level 4, one entry |
//! | `0xa000` | page directory pointers, four entries |
//! | `0xb000` | four page directories of 2 MiB pages: the first 4 GiB, identity-mapped |

use kvm_bindings::{kvm_debugregs, kvm_fpu, kvm_regs, kvm_segment, kvm_sregs, kvm_vcpu_events};
use kvm_ioctls::VcpuFd;
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress, GuestMemoryError, GuestMemoryMmap};

const GDT: u64 = 0x500;
/// Top of the first stack. What is below it in its page is the stack.
pub const STACK_TOP: u64 = 0x8ff0;
const PML4: u64 = 0x9000;
const PDPT: u64 = 0xa000;
const DIRECTORIES: u64 = 0xb000;
const GIB_MAPPED: u64 = 4;

const CODE_SELECTOR: u16 = 0x10;
const DATA_SELECTOR: u16 = 0x18;

const PRESENT_WRITABLE: u64 = 0b11;
const LARGE_PAGE: u64 = 1 << 7;

/// CR0: protection, monitor coprocessor, extension type, numeric error, write protect, paging.
const CR0: u64 = 1 | 1 << 1 | 1 << 4 | 1 << 5 | 1 << 16 | 1 << 31;
/// CR4: physical address extension, FXSAVE and SIMD exceptions.
const CR4: u64 = 1 << 5 | 1 << 9 | 1 << 10;
/// EFER: long mode enabled and active, no-execute.
const EFER: u64 = 1 << 8 | 1 << 10 | 1 << 11;

/// Debug registers at reset: nothing hit, nothing armed.
const DR6: u64 = 0xffff_0ff0;
const DR7: u64 = 0x400;

/// The initial state could not be set.
#[derive(Debug, Error)]
pub enum StartError {
    /// The guest's memory does not reach as far as the structures.
    #[error("the guest has no memory for its first page tables: {0}")]
    Memory(#[from] GuestMemoryError),
    /// KVM refused the registers.
    #[error("KVM refused the initial registers: {0}")]
    Registers(#[from] kvm_ioctls::Error),
}

/// What differs between guests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// First instruction.
    pub rip: u64,
    /// First argument by the System V convention: the PLC's information page.
    pub rdi: u64,
    /// Second argument: Linux's boot parameters.
    pub rsi: u64,
}

/// Writes the tables to guest memory and the registers to the vCPU.
///
/// # Errors
/// See [`StartError`].
pub fn start(vcpu: &VcpuFd, memory: &GuestMemoryMmap, entry: Entry) -> Result<(), StartError> {
    write_tables(memory)?;
    set_registers(vcpu, entry)
}

/// The half of [`start`] that is about memory.
///
/// # Errors
/// If the memory does not reach as far as the structures.
pub fn write_tables(memory: &GuestMemoryMmap) -> Result<(), GuestMemoryError> {
    let put = |address: u64, value: u64| memory.write_obj(value, GuestAddress(address));
    let gdt = [0, 0, descriptor(&code()), descriptor(&data())];
    for (address, value) in (GDT..).step_by(8).zip(gdt) {
        put(address, value)?;
    }
    put(PML4, PDPT | PRESENT_WRITABLE)?;
    for gib in 0..GIB_MAPPED {
        let directory = DIRECTORIES + (gib << 12);
        put(PDPT + gib * 8, directory | PRESENT_WRITABLE)?;
        let entry = |n: u64| ((gib << 30) + (n << 21)) | PRESENT_WRITABLE | LARGE_PAGE;
        let entries: Vec<u8> = (0..512).flat_map(|n| entry(n).to_le_bytes()).collect();
        memory.write_slice(&entries, GuestAddress(directory))?;
    }
    Ok(())
}

/// The half of [`start`] that is about the processor.
///
/// # Errors
/// See [`StartError`].
pub fn set_registers(vcpu: &VcpuFd, entry: Entry) -> Result<(), StartError> {
    let mut special = vcpu.get_sregs()?;
    set_special(&mut special, code(), data());
    vcpu.set_sregs(&special)?;
    vcpu.set_regs(&kvm_regs {
        rip: entry.rip,
        rdi: entry.rdi,
        rsi: entry.rsi,
        rsp: STACK_TOP,
        rbp: STACK_TOP,
        // Bit 1 is always set; interrupts are off.
        rflags: 2,
        ..Default::default()
    })?;
    vcpu.set_fpu(&kvm_fpu { fcw: 0x37f, mxcsr: 0x1f80, ..Default::default() })?;
    // What an earlier guest of this vCPU may have left: an exception that was about to be
    // delivered, and breakpoints.
    vcpu.set_vcpu_events(&kvm_vcpu_events::default())?;
    vcpu.set_debug_regs(&kvm_debugregs { dr6: DR6, dr7: DR7, ..Default::default() })?;
    Ok(())
}

fn set_special(special: &mut kvm_sregs, code: kvm_segment, data: kvm_segment) {
    special.cs = code;
    special.ds = data;
    special.es = data;
    special.fs = data;
    special.gs = data;
    special.ss = data;
    special.gdt.base = GDT;
    special.gdt.limit = 4 * 8 - 1;
    special.idt.base = 0;
    special.idt.limit = 0;
    special.cr0 = CR0;
    special.cr3 = PML4;
    special.cr4 = CR4;
    special.efer = EFER;
}

fn code() -> kvm_segment {
    segment(CODE_SELECTOR, 0xb, true)
}

fn data() -> kvm_segment {
    segment(DATA_SELECTOR, 0x3, false)
}

/// A flat ring-0 segment of the given type (manuals: "segment types").
fn segment(selector: u16, type_: u8, is_code: bool) -> kvm_segment {
    kvm_segment {
        base: 0,
        limit: u32::MAX,
        selector,
        type_,
        present: 1,
        s: 1,
        g: 1,
        l: u8::from(is_code),
        db: u8::from(!is_code),
        ..Default::default()
    }
}

/// The 8-byte form of a flat segment, for the descriptor table in memory.
fn descriptor(s: &kvm_segment) -> u64 {
    let flags = u64::from(s.type_)
        | u64::from(s.s) << 4
        | u64::from(s.dpl) << 5
        | u64::from(s.present) << 7
        | 0xf << 8
        | u64::from(s.l) << 13
        | u64::from(s.db) << 14
        | u64::from(s.g) << 15;
    flags << 40 | 0xffff
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_are_the_ones_every_boot_loader_uses() {
        assert_eq!(descriptor(&segment(CODE_SELECTOR, 0xb, true)), 0x00af_9b00_0000_ffff);
        assert_eq!(descriptor(&segment(DATA_SELECTOR, 0x3, false)), 0x00cf_9300_0000_ffff);
    }

    #[test]
    fn the_first_four_gib_are_mapped_to_themselves() {
        let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), 1 << 20)]).unwrap();
        write_tables(&memory).unwrap();
        let get = |a: u64| memory.read_obj::<u64>(GuestAddress(a)).unwrap();
        for address in [0u64, 0x10_0000, 0xc000_0000, 0xffff_ffff] {
            let pdpt = get(PML4) & !0xfff;
            let directory = get(pdpt + (address >> 30) * 8) & !0xfff;
            let entry = get(directory + (address >> 21 & 511) * 8);
            assert_eq!(entry, address & !0x1f_ffff | 0x83);
        }
    }

    #[test]
    fn a_guest_too_small_for_its_tables_is_refused() {
        let memory = GuestMemoryMmap::from_ranges(&[(GuestAddress(0), 0xb000)]).unwrap();
        assert!(write_tables(&memory).is_err());
    }
}
