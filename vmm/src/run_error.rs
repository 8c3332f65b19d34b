//! Why a run did not take place.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::boot::long_mode::StartError;
use crate::boot::plc::PlcImageError;
use crate::boot::programs::ProgramError;
use crate::channels::ChannelError;
use crate::console_log::ConsoleLogError;
use crate::control::{DoorError, ViewError};
use crate::cpuset::CpusetError;
use crate::disk::DiskError;
use crate::event::EventError;
use crate::host_ports::HostPortError;
use crate::host_watchdog::WatchdogError;
use crate::huge_pages::HugePageError;
use crate::interrupts::InterruptError;
use crate::linux_machine::LinuxMachineError;
use crate::live::LiveError;
use crate::machine::MachineError;
use crate::memory::MemoryError;
use crate::net::NetError;
use crate::passthrough::error::DeviceError;
use crate::pci::PciError;
use crate::resctrl::GroupError;
use crate::sandbox::SandboxError;
use crate::saver::SaverError;
use crate::supervisor::error::SupervisorError;
use crate::unix_socket::SocketError;
use crate::vcpu::thread::ThreadError;
use crate::vsock::VsockError;

/// A run that did not take place, or could not tell of itself.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum RunError {
    #[error(transparent)]
    Machine(#[from] MachineError),
    #[error(transparent)]
    Memory(#[from] MemoryError),
    #[error(transparent)]
    HugePages(#[from] HugePageError),
    #[error("partition {partition}: {source}")]
    Plc { partition: String, source: PlcImageError },
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error(transparent)]
    Linux(#[from] LinuxMachineError),
    #[error(transparent)]
    Channel(#[from] ChannelError),
    #[error(transparent)]
    Live(#[from] LiveError),
    #[error("partition {partition}: {source}")]
    ConsoleLog { partition: String, source: ConsoleLogError },
    #[error(transparent)]
    Saver(#[from] SaverError),
    #[error(transparent)]
    HostPort(#[from] HostPortError),
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Disk(#[from] DiskError),
    #[error("partition {partition}: {source}")]
    Net { partition: String, source: NetError },
    #[error("partition {partition}: {source}")]
    Vsock { partition: String, source: VsockError },
    #[error(transparent)]
    Interrupt(#[from] InterruptError),
    #[error(transparent)]
    Event(#[from] EventError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error(transparent)]
    Cpuset(#[from] CpusetError),
    #[error(transparent)]
    Group(#[from] GroupError),
    #[error(transparent)]
    Thread(#[from] ThreadError),
    #[error(transparent)]
    Supervisor(#[from] SupervisorError),
    #[error(transparent)]
    Sandbox(#[from] SandboxError),
    #[error(transparent)]
    Pci(#[from] PciError),
    #[error(transparent)]
    Watchdog(#[from] WatchdogError),
    #[error(
        "partition {partition}: this host's KVM does not tell of bus locks (KVM_CAP_X86_BUS_LOCK_EXIT); take a processor that does, such as Intel's since Sapphire Rapids, or leave `bus_locks` out"
    )]
    BusLocks { partition: String },
    #[error("control: {0}")]
    Control(#[from] DoorError),
    #[error("control: {0}")]
    View(#[from] ViewError),
    #[error("cannot lock memory: {0}; run as root, or raise the limit (ulimit -l unlimited)")]
    Lock(io::Error),
    #[cfg(feature = "test-hooks")]
    #[error("TEST: a step of the start has failed, as was asked for")]
    Provoked,
    #[error("cannot {what}: {source}")]
    Host { what: &'static str, source: io::Error },
    #[error("cannot write the {what} to {}: {source}", path.display())]
    Output { what: &'static str, path: PathBuf, source: io::Error },
}

impl RunError {
    /// True if it is a file of the user's that is at fault, not the host.
    #[must_use]
    pub const fn is_users(&self) -> bool {
        matches!(
            self,
            RunError::Plc { .. }
                | RunError::Linux(LinuxMachineError::Image { .. })
                | RunError::Disk(DiskError::File(_))
                | RunError::Saver(_)
                | RunError::ConsoleLog { source: ConsoleLogError::File { .. }, .. }
                | RunError::Control(DoorError::NoGroup(_))
                | RunError::Control(DoorError::Socket(
                    SocketError::InUse(_) | SocketError::NotASocket(_)
                ))
        )
    }
}
