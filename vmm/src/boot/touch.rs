//! Touching all memory of a PLC guest before it starts.
//!
//! That a page is locked in the host's memory does not yet mean that KVM has mapped it for the
//! guest: it does so at the first access, in the kernel and for some microseconds each. A guest
//! that starts makes dozens of them in a row, and a kick waits for the one under way: first windows
//! have ended 0.2 ms late for that, at their neighbours' expense. So a few instructions run in the
//! guest's place and read a byte of each page. KVM maps a page that the host may write as writable
//! at the first read (`hva_to_pfn_fast` in the kernel's virt/kvm/kvm_main.c).
//!
//! In memory of huge pages the instructions run in each range of 2 MiB anew. Where KVM works around the erratum "iTLB
//! multihit", a large page is not executable, and the first instruction that is fetched from one
//! splits it: pages that had been touched before would be faults again.
//!
//! It is the vCPU's own thread that does so. KVM remembers which thread ran a vCPU last, and the
//! first run by another one waits until no processor can know the former any more
//! (`synchronize_rcu` at `KVM_RUN` in virt/kvm/kvm_main.c): some 20 ms of each start.

use kvm_ioctls::{VcpuExit, VcpuFd};
use takt_abi::memory::PAGE;
use takt_abi::port;
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress};

use super::long_mode::{self, Entry, STACK_TOP, StartError};
use crate::memory::{GuestMemory, Pages};

/// Where the code lies: in the page of the first stack, which is not used yet.
const CODE_START: u64 = STACK_TOP & !(PAGE - 1);

/// `1: mov al, [rdi]; add rdi, 4096; dec rsi; jnz 1b; mov dx, 0x7a00; out dx, eax`. Not a halt, which
/// is no exit where there is an interrupt controller.
const CODE: [u8; 19] = [
    0x8a, 0x07, 0x48, 0x81, 0xc7, 0x00, 0x10, 0x00, 0x00, 0x48, 0xff, 0xce, 0x75, 0xf2, 0x66, 0xba,
    0x00, 0x7a, 0xef,
];

/// Range of a huge page that KVM splits: its smallest large page.
const PIECE: u64 = 2 << 20;

/// The memory could not be touched.
#[derive(Debug, Error)]
pub enum TouchError {
    /// The vCPU could not be started.
    #[error(transparent)]
    Start(#[from] StartError),
    /// KVM could not run it.
    #[error("cannot run the vCPU to map its memory: {0}")]
    Run(#[from] kvm_ioctls::Error),
    /// It did something else than read and say so.
    #[error("the vCPU strayed while its memory was mapped: {0}")]
    Strayed(String),
}

/// Touches every page of `memory`, which is otherwise unchanged. The tables of [`long_mode`] must lie
/// there already; the vCPU's registers have to be set anew.
///
/// # Errors
/// See [`TouchError`].
pub fn touch(vcpu: &mut VcpuFd, memory: &GuestMemory) -> Result<(), TouchError> {
    let regions = memory.regions();
    for (code, start, length) in pieces(memory.ranges(), memory.pages()) {
        let code_start = GuestAddress(code);
        let mut before = [0; CODE.len()];
        regions.read_slice(&mut before, code_start).map_err(StartError::from)?;
        regions.write_slice(&CODE, code_start).map_err(StartError::from)?;
        let entry = Entry { rip: code, rdi: start, rsi: length / PAGE };
        long_mode::set_registers(vcpu, entry)?;
        run(vcpu)?;
        regions.write_slice(&before, code_start).map_err(StartError::from)?;
    }
    Ok(())
}

/// What is touched at a time: where the code lies for it, its start and its length.
fn pieces(ranges: impl Iterator<Item = (u64, u64)>, pages: Pages) -> Vec<(u64, u64, u64)> {
    let mut pieces = Vec::new();
    for (start, length) in ranges {
        if pages == Pages::Small || length < PIECE {
            pieces.push((CODE_START, start, length));
            continue;
        }
        for at in (start..start + length).step_by(PIECE as usize) {
            // The processor's tables are at the start of the first piece.
            let code = if at == 0 { CODE_START } else { at };
            pieces.push((code, at, PIECE.min(start + length - at)));
        }
    }
    pieces
}

/// Runs the code to its end.
fn run(vcpu: &mut VcpuFd) -> Result<(), TouchError> {
    loop {
        match vcpu.run() {
            Ok(VcpuExit::IoOut(port::DONE, _)) => return Ok(()),
            Ok(exit) => return Err(TouchError::Strayed(format!("{exit:?}"))),
            Err(e) if e.errno() == libc::EINTR => {}
            Err(e) => return Err(e.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::memory::STATUS;
    use takt_plan::HugePageSize;

    #[test]
    fn in_huge_pages_each_piece_runs_the_code_in_itself() {
        let ranges = [(0, 3 * PIECE), (STATUS, PAGE)];
        let of = |pages| pieces(ranges.into_iter(), pages);
        let status = (CODE_START, STATUS, PAGE);
        assert_eq!(of(Pages::Small), [(CODE_START, 0, 3 * PIECE), status]);
        let [second, third] = [PIECE, 2 * PIECE].map(|at| (at, at, PIECE));
        for size in HugePageSize::ALL {
            let huge = of(Pages::Huge(size));
            assert_eq!(huge, [(CODE_START, 0, PIECE), second, third, status]);
        }
    }
}
