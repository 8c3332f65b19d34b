//! Does this host's KVM run a guest's kernel at hardware speed?
//!
//! That `/dev/kvm` exists says little: some hosts offer a KVM that *emulates* guest code in kernel
//! mode, at a millionth of the speed of the processor. So a throw-away guest counts down a
//! register in ring 0, and the time is taken.

use std::fmt;
use std::time::{Duration, Instant};

use kvm_ioctls::{Kvm, VcpuExit};
use takt_host::kvm::{self, Examination, Found, Machines};
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress};

use crate::boot::long_mode::{self, Entry, StartError};
use crate::health::bus_locks;
use crate::machine::{self, MachineError, TimerOwner};
use crate::memory::{GuestMemory, MemoryError, Pages};
use crate::registers;

/// Rounds of the loop. At two instructions a round, hardware takes well under a millisecond, an
/// emulator of a million instructions a second a fifth of a second.
const ROUNDS: u32 = 100_000;
/// Anything slower is no hardware.
const LIMIT: Duration = Duration::from_millis(10);
const CODE: u64 = 0x10_0000;
const MEMORY: u64 = 2 << 20;

/// What the probe found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Speed {
    /// Time for [`ROUNDS`] rounds.
    time: Duration,
}

impl Speed {
    /// True if guest code in kernel mode runs on the processor itself.
    #[must_use]
    pub fn is_hardware(&self) -> bool {
        self.time < LIMIT
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.is_hardware() {
            "KVM runs kernel-mode guest code at hardware speed"
        } else {
            "KVM emulates kernel-mode guest code"
        };
        let us = self.time.as_micros();
        write!(f, "{verdict} ({ROUNDS} rounds of a loop took {us} us)")
    }
}

/// The probe could not be made.
#[derive(Debug, Error)]
pub enum ProbeError {
    /// No usable KVM.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// No memory.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The vCPU could not be started.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The guest did something else than it was to do.
    #[error("the probe's guest did something else: {0}")]
    Strayed(String),
}

/// Whether KVM leaves it to Takt where a Linux's deadlines go.
///
/// It may set them on a shorter path of its own, past the filter for registers: where it uses the
/// processor's preemption timer, and from Linux 6.18 on everywhere (`handle_fastpath_wrmsr`,
/// arch/x86/kvm/x86.c). So a throw-away guest writes one.
///
/// # Errors
/// See [`ProbeError`].
fn hands_deadlines_over(kvm: &Kvm) -> Result<bool, ProbeError> {
    let memory = GuestMemory::for_linux(MEMORY, Pages::Small, &[], 0)?;
    let mut machine = machine::for_linux(kvm, &memory, TimerOwner::Takt, 1)?;
    // mov ecx, TSC_DEADLINE; xor eax, eax; xor edx, edx; wrmsr; out 0x80, al
    let [a, b, c, d] = registers::TSC_DEADLINE.to_le_bytes();
    let code = [0xb9, a, b, c, d, 0x31, 0xc0, 0x31, 0xd2, 0x0f, 0x30, 0xe6, 0x80];
    memory.regions().write_slice(&code, GuestAddress(CODE)).map_err(StartError::from)?;
    let entry = Entry { rip: CODE, ..Entry::default() };
    long_mode::start(&machine.vcpu, memory.regions(), entry)?;
    loop {
        match machine.vcpu.run() {
            Ok(VcpuExit::X86Wrmsr(_)) => return Ok(true),
            Ok(VcpuExit::IoOut(..)) => return Ok(false),
            Ok(exit) => return Err(ProbeError::Strayed(format!("{exit:?}"))),
            Err(e) if e.errno() == libc::EINTR => {}
            Err(e) => return Err(ProbeError::Strayed(e.to_string())),
        }
    }
}

/// Finds out all that machines can tell of this host's KVM. They are dropped again.
#[must_use]
pub fn examine() -> Examination {
    let found = match Kvm::new() {
        Err(error) => Found::Closed { errno: error.errno() },
        Ok(kvm) => match &machine::missing(&kvm)[..] {
            [] => Found::Complete(machines(&kvm)),
            missing => {
                Found::Lacking { missing: missing.iter().map(|name| (*name).into()).collect() }
            }
        },
    };
    Examination { schema_version: kvm::SCHEMA_VERSION, kvm: found }
}

fn machines(kvm: &Kvm) -> Machines {
    let plc = GuestMemory::for_plc(MEMORY, Pages::Small, &[])
        .map_err(MachineError::from)
        .and_then(|memory| machine::for_plc(kvm, &memory, false));
    let linux = GuestMemory::for_linux(MEMORY, Pages::Small, &[], 0)
        .map_err(MachineError::from)
        .and_then(|memory| machine::for_linux(kvm, &memory, TimerOwner::Takt, 1));
    Machines {
        tsc_khz: plc.as_ref().ok().map(|plc| plc.tsc.khz()),
        plc_error: plc.err().map(|error| error.to_string()),
        linux_error: linux.err().map(|error| error.to_string()),
        speed: match probe() {
            Ok(speed) if speed.is_hardware() => kvm::Speed::Hardware { text: speed.to_string() },
            Ok(speed) => kvm::Speed::Emulated { text: speed.to_string() },
            Err(error) => kvm::Speed::Failed { error: error.to_string() },
        },
        tells_bus_locks: bus_locks::are_told(kvm),
        hands_deadlines_over: hands_deadlines_over(kvm).ok(),
    }
}

/// Runs the probe.
///
/// # Errors
/// See [`ProbeError`].
pub fn probe() -> Result<Speed, ProbeError> {
    let kvm = machine::open_kvm()?;
    let memory = GuestMemory::for_plc(MEMORY, Pages::Small, &[])?;
    let mut machine = machine::for_plc(&kvm, &memory, false)?;
    // mov ecx, ROUNDS; 1: dec ecx; jnz 1b; hlt
    let [a, b, c, d] = ROUNDS.to_le_bytes();
    let code = [0xb9, a, b, c, d, 0xff, 0xc9, 0x75, 0xfc, 0xf4];
    memory.regions().write_slice(&code, GuestAddress(CODE)).map_err(StartError::from)?;
    let entry = Entry { rip: CODE, ..Entry::default() };
    long_mode::start(&machine.vcpu, memory.regions(), entry)?;
    let start = Instant::now();
    loop {
        match machine.vcpu.run() {
            Ok(VcpuExit::Hlt) => return Ok(Speed { time: start.elapsed() }),
            Ok(exit) => return Err(ProbeError::Strayed(format!("{exit:?}"))),
            Err(e) if e.errno() == libc::EINTR => {}
            Err(e) => return Err(ProbeError::Strayed(e.to_string())),
        }
    }
}
