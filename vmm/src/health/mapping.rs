//! Which error an end of a guest is. `docs/health.md` has the same as a table.

use takt_abi::{Exception, memory::PAGE};

use super::Fault;
use crate::vcpu::guest::End;

impl End {
    /// Which error this end is; `None` if it is none of the guest's.
    #[must_use]
    pub fn fault(&self) -> Option<Fault> {
        Some(match self {
            End::Stopped | End::ScheduleChange(_) => return None,
            End::Raised(detail) => detail.fault(),
            End::Exited(0) | End::PoweredOff => Fault::PartitionEnded,
            End::Exited(_) => Fault::ApplicationError,
            End::Exception(exception) => of_exception(exception),
            // It asks for an interrupt that there is not.
            End::Halted => Fault::IllegalRequest,
            End::Reset => Fault::PartitionReset,
            End::Silent(_) => Fault::PartitionSilent,
            End::TripleFault => Fault::ProcessorShutdown,
            End::Kvm(_) | End::NotLoaded => Fault::HardwareFault,
        })
    }
}

/// Vectors are those of the processor manuals, see [`takt_abi::exception_name`].
fn of_exception(exception: &Exception) -> Fault {
    match exception.vector {
        // Divide error, overflow, x87 and SIMD floating point.
        0 | 4 | 16 | 19 => Fault::NumericError,
        // Non-maskable interrupt, machine check.
        2 | 18 => Fault::HardwareFault,
        // Double fault, stack fault: a stack that cannot take what is pushed.
        8 | 12 => Fault::StackOverflow,
        14 if hits_the_stack(exception) => Fault::StackOverflow,
        // Invalid opcode.
        6 => Fault::IllegalRequest,
        _ => Fault::MemoryViolation,
    }
}

/// A page fault where the stack pointer points. The guest's word, and it names the guest's own
/// error only.
fn hits_the_stack(exception: &Exception) -> bool {
    exception.cr2.abs_diff(exception.rsp) < PAGE
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::time::Nanos;

    use crate::boot::StartMode;
    use crate::vcpu::guest::KvmFailure;

    fn exception(vector: u64, cr2: u64) -> End {
        let (rsp, rip) = (0x18_0000, 0x10_0000);
        End::Exception(Exception { vector, error_code: 0, rip, rsp, rflags: 2, cr2 })
    }

    #[test]
    fn each_end_is_the_error_that_the_documentation_says() {
        let table = [
            (End::Exited(0), Fault::PartitionEnded),
            (End::PoweredOff, Fault::PartitionEnded),
            (End::Exited(1), Fault::ApplicationError),
            (End::Halted, Fault::IllegalRequest),
            (End::Reset, Fault::PartitionReset),
            (End::Silent(Nanos(7)), Fault::PartitionSilent),
            (End::TripleFault, Fault::ProcessorShutdown),
            (End::Kvm(KvmFailure::Internal), Fault::HardwareFault),
            (End::Kvm(KvmFailure::Entry(7)), Fault::HardwareFault),
            (End::NotLoaded, Fault::HardwareFault),
        ];
        for (end, fault) in table {
            assert_eq!(end.fault(), Some(fault), "{end}");
        }
        assert_eq!(End::Stopped.fault(), None);
        assert_eq!(End::ScheduleChange(StartMode::Warm).fault(), None);
    }

    #[test]
    fn each_exception_is_the_error_that_the_documentation_says() {
        let of = |vector| exception(vector, 0).fault().unwrap();
        for vector in 0..40 {
            let expected = match vector {
                0 | 4 | 16 | 19 => Fault::NumericError,
                2 | 18 => Fault::HardwareFault,
                6 => Fault::IllegalRequest,
                8 | 12 => Fault::StackOverflow,
                _ => Fault::MemoryViolation,
            };
            assert_eq!(of(vector), expected, "{vector}");
        }
        assert_eq!(of(u64::MAX), Fault::MemoryViolation);
    }

    #[test]
    fn a_page_fault_at_the_stack_pointer_is_a_stack_overflow() {
        for (cr2, fault) in [
            (0x17_fff8, Fault::StackOverflow),
            (0x18_0008, Fault::StackOverflow),
            (0x17_f000, Fault::MemoryViolation),
            (0, Fault::MemoryViolation),
            (u64::MAX, Fault::MemoryViolation),
        ] {
            assert_eq!(exception(14, cr2).fault(), Some(fault), "{cr2:#x}");
        }
    }
}
