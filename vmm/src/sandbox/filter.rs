//! The system calls that each kind of thread may make.
//!
//! The lists are data, `vmm/seccomp/*.json`, with a reason for each call. They are compiled when
//! Takt is built; only the programs for the kernel's filter are in it.

use std::io;

/// Kinds of threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Runs the vCPU of a PLC.
    Plc,
    /// Runs the vCPU of a Linux.
    Linux,
    /// Ends windows.
    WindowEnforcer,
    /// Loads a Linux anew.
    Loader,
    /// Loads a PLC anew.
    PlcLoader,
    /// Serves a disk of a Linux.
    Disk,
    /// Writes what may not be taken: the console, a trace, a recording.
    Writer,
    /// Writes retained values.
    Saver,
    /// Reads a file to send from.
    Reader,
    /// Closes the kernel's devices at the end.
    Closer,
    /// The supervisor thread.
    Main,
    /// The process that writes safe values when there is no other.
    Guardian,
}

/// What follows from a call that is not in the list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// The end of the process, after safe values.
    #[default]
    Enforce,
    /// A line in the kernel's log.
    Log,
}

impl Kind {
    const fn program(self) -> &'static [u8] {
        match self {
            Kind::Plc => include_bytes!(concat!(env!("OUT_DIR"), "/plc.bpf")),
            Kind::Linux => include_bytes!(concat!(env!("OUT_DIR"), "/linux.bpf")),
            Kind::WindowEnforcer => include_bytes!(concat!(env!("OUT_DIR"), "/kicker.bpf")),
            Kind::Loader => include_bytes!(concat!(env!("OUT_DIR"), "/loader.bpf")),
            Kind::PlcLoader => include_bytes!(concat!(env!("OUT_DIR"), "/plc-loader.bpf")),
            Kind::Writer => include_bytes!(concat!(env!("OUT_DIR"), "/writer.bpf")),
            Kind::Saver => include_bytes!(concat!(env!("OUT_DIR"), "/saver.bpf")),
            Kind::Reader => include_bytes!(concat!(env!("OUT_DIR"), "/reader.bpf")),
            Kind::Closer => include_bytes!(concat!(env!("OUT_DIR"), "/closer.bpf")),
            Kind::Disk => include_bytes!(concat!(env!("OUT_DIR"), "/disk.bpf")),
            Kind::Main => include_bytes!(concat!(env!("OUT_DIR"), "/main.bpf")),
            Kind::Guardian => include_bytes!(concat!(env!("OUT_DIR"), "/guardian.bpf")),
        }
    }
}

/// Installs the filter in the calling thread, which must not be able to gain privileges.
///
/// # Errors
/// What the kernel says.
pub fn install(kind: Kind, mode: Mode) -> io::Result<()> {
    let mut program = instructions(kind.program(), mode);
    let length = program.len().try_into().map_err(|_| io::ErrorKind::InvalidData)?;
    let program = libc::sock_fprog { len: length, filter: program.as_mut_ptr() };
    // SAFETY: the kernel reads `len` instructions from the live vector, and checks them.
    let result = unsafe {
        libc::syscall(libc::SYS_seccomp, libc::SECCOMP_SET_MODE_FILTER, 0, &raw const program)
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// A program from its bytes: what `vmm/seccomp/compile.rs` has written.
fn instructions(bytes: &[u8], mode: Mode) -> Vec<libc::sock_filter> {
    /// "Return this constant" (`BPF_RET | BPF_K`).
    const RETURN: u16 = 6;
    let (whole, _) = bytes.as_chunks::<8>();
    let instruction = |&[c0, c1, jt, jf, k0, k1, k2, k3]: &[u8; 8]| {
        let code = u16::from_ne_bytes([c0, c1]);
        let k = u32::from_ne_bytes([k0, k1, k2, k3]);
        let k = match mode {
            Mode::Log if code == RETURN && k == libc::SECCOMP_RET_TRAP => libc::SECCOMP_RET_LOG,
            _ => k,
        };
        libc::sock_filter { code, jt, jf, k }
    };
    whole.iter().map(instruction).collect()
}

#[cfg(test)]
#[path = "filter_tests.rs"]
mod tests;
