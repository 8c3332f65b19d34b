//! PID 1 of the appliance: a machine on which nothing runs beside `takt`.
//!
//! The appliance image holds a kernel, a few modules and this program. It has no shell and no
//! service manager, so this program mounts file systems, loads KVM, carries the results out
//! and switches the machine off, before and after the ordinary command line.
//! A small init program could do the same, but it would be a second thing to build, to trust and
//! to keep in step with `takt`.
//!
//! The command line itself is executed by a child, this program once more. It gives all its
//! privileges away ([`crate::sandbox`]), and what is needed after the run, to use a port and
//! to switch the machine off, stays with a process that only waits for it, and has given
//! away everything else. One that is
//! killed leaves its results too, and the machine then starts again, as it does when process 1 dies.
//!
//! Results leave through an emulator's debug console port as one cpio archive. A disk or a network would
//! need drivers, and with them interrupts and kernel threads beside the partitions, only to carry
//! a few files after the run. The archive ends with the file `status`: an archive that has that
//! file is whole.
//!
//! Only kernel interfaces are mounted. `/out` and `/tmp` are plain folders, since the root of an
//! initramfs is memory anyway and a mount on `/tmp` would hide partition files put there.

mod archive;
mod carrier;
pub mod expedited_rcu;
mod result_port;
mod role;

use std::ffi::{CStr, OsStr, OsString};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::thread;
use std::time::Duration;

use result_port::ResultPort;

pub use role::Role;

use crate::host_clock;
use crate::sandbox::{self, Allowed};
use crate::steering;

/// Names the modules to load, in order. A line with several names is a choice: the first that the
/// machine accepts is enough. That this file exists tells the appliance from a container.
const MODULE_LIST: &str = "/modules/order";
/// Where they are.
const MODULES: &str = "/modules";
/// Names the drivers of hardware watchdogs, in the order in which they load.
const WATCHDOGS: &str = "/modules/watchdogs";
/// As [`MODULE_LIST`], for interrupts of devices: they are loaded only for a partition file that
/// names some.
const INTERRUPT_MODULES: &str = "/modules/interrupts";
/// Those that a device behind an IOMMU needs.
const VFIO_MODULES: &str = "/modules/vfio";
/// Those that network interfaces need.
const NET_MODULES: &str = "/modules/net";
/// Those that sockets need.
const VSOCK_MODULES: &str = "/modules/vsock";
/// Whatever a run leaves in this folder is carried out of the machine.
const OUT: &str = "/out";
/// What the kernel shows on the console.
const KERNEL_LOG_LEVEL: &str = "/proc/sys/kernel/printk";
/// Whether the kernel looks for CPUs that hang.
const LOCKUP_DETECTION: &str = "/proc/sys/kernel/watchdog";
/// The first word of the command line proper; see [`arguments`].
const PROGRAM: &str = "takt";
/// The ordinary process 1.
const FIRST: u32 = 1;
/// Exit status for "the host cannot", as in the ordinary command line.
const HOST_CANNOT: u8 = 3;

/// Why the appliance could not start, or could not hand over its results.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file system could not be mounted.
    #[error("cannot mount {kind:?} on {target:?}: {source}")]
    Mount {
        /// File system type.
        kind: &'static CStr,
        /// Mount point.
        target: &'static CStr,
        /// What the kernel said.
        source: io::Error,
    },
    /// A folder could not be made.
    #[error("cannot make {path}: {source}")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// `/dev/console` cannot serve as standard input and output.
    #[error("cannot use /dev/console: {0}")]
    Console(io::Error),
    /// The module list or a result cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// This program does not run once more.
    #[error("cannot run {path}: {source}")]
    Run {
        /// The program.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// No module of a line of the list loads; each is named with the kernel's reason.
    #[error("cannot load {}", .0.join(", nor "))]
    Module(Vec<String>),
    /// A result is longer than the archive's format can say (4 GiB).
    #[error("{0} is too long for a cpio archive")]
    TooLong(PathBuf),
    /// The archive could not be written.
    #[error("cannot hand over the results: {0}")]
    Results(#[from] io::Error),
}

/// The command line, starting with the program's name.
///
/// The kernel hands to PID 1 the words of its own command line that it does not know (`nokaslr`
/// is one, on x86) and after them everything behind `--` (Linux init/main.c,
/// `unknown_bootoption` and `set_init_arg`). Ours starts at the word `takt` in both cases.
#[must_use]
pub fn arguments(role: Role) -> Vec<OsString> {
    let all = std::env::args_os();
    if role == Role::PidOne {
        all.skip_while(|word| word != PROGRAM).collect()
    } else {
        all.collect()
    }
}

/// Prepares the machine, runs the ordinary command line on `arguments`, carries out the results and
/// switches the machine off.
///
/// When PID 1 exits or panics the kernel panics too, and no result is handed over.
pub fn main(arguments: &[OsString]) -> ! {
    let (status, end) = match prepare().and_then(|()| run(arguments)) {
        Ok(status) => match (status.code().and_then(|c| u8::try_from(c).ok()), status.signal()) {
            (Some(code), _) => (code, libc::RB_POWER_OFF),
            (None, signal) => {
                eprintln!("takt: appliance: killed by signal {}", signal.unwrap_or_default());
                (HOST_CANNOT, libc::RB_AUTOBOOT)
            }
        },
        Err(error) => {
            eprintln!("takt: appliance: {error}");
            (HOST_CANNOT, libc::RB_POWER_OFF)
        }
    };
    if let Err(error) = hand_over(status) {
        eprintln!("takt: appliance: {error}");
    }
    leave(end)
}

/// This program as an ordinary process.
fn run(arguments: &[OsString]) -> Result<ExitStatus, Error> {
    let path = std::env::current_exe().unwrap_or_else(|_| Path::new("/init").to_owned());
    let rest = arguments.get(1..).unwrap_or_default();
    let failed = |source| Error::Run { path: path.clone(), source };
    let mut carrier = carrier::start();
    let mut child = Command::new(&path).arg0(PROGRAM).args(rest).spawn().map_err(failed)?;
    let allowed = [Allowed::Read(OUT.into()), Allowed::Write(KERNEL_LOG_LEVEL.into())];
    // A machine that cannot have it is still one for a run, and its user is told.
    if let Err(error) = sandbox::enter_as_first(&allowed) {
        eprintln!("takt: appliance: {error}");
    }
    let status = child.wait();
    if let Some(carrier) = &mut carrier {
        carrier::end(carrier);
    }
    wait_for_orphans();
    status.map_err(failed)
}

/// A takt that was killed leaves its guardian, which has safe values to write before the machine
/// goes. Whatever else was left is not worth more than a second.
fn wait_for_orphans() {
    let any = |options| {
        // SAFETY: waits for children of this process; a null pointer asks for no status.
        unsafe { libc::waitpid(-1, std::ptr::null_mut(), options) }
    };
    for _ in 0..100 {
        match any(libc::WNOHANG) {
            0 => thread::sleep(Duration::from_millis(10)),
            ..0 => return,
            _ => {}
        }
    }
}

fn prepare() -> Result<(), Error> {
    mount(c"devtmpfs", c"/dev")?;
    take_console().map_err(Error::Console)?;
    mount(c"proc", c"/proc")?;
    mount(c"sysfs", c"/sys")?;
    mount(c"cgroup2", c"/sys/fs/cgroup")?;
    make_folder(Path::new(OUT))?;
    make_folder(Path::new("/tmp"))?;
    switch_lockup_detection_off();
    // A machine on which it cannot be given up is one whose clock may be steered.
    let _ = steering::give_up();
    load_modules(Path::new(MODULE_LIST))?;
    await_the_clock();
    Ok(())
}

/// Waits until the kernel's timers go off when they are due, and not with the next tick, up to 4 ms later; and until its
/// clock has the rate that it is going to keep.
///
/// The kernel changes over when it trusts a clock, which for the TSC takes a second from the
/// kernel's start where it has to measure its rate (`tsc_refine_calibration_work`, kernel
/// arch/x86/kernel/tsc.c). A kernel with little to do has started this program before, and releases would
/// be lost; and a run that has begun by a rate that is corrected later has frames of another length than its file says, by as
/// much, and the host's tick creeps through its windows. One that never changes over is not for this
/// program to judge: the run tells.
fn await_the_clock() {
    let is_measured = || {
        let read = |path| fs::read_to_string(path).unwrap_or_default();
        !is_measuring(&read(host_clock::SOURCE), &read("/proc/cmdline"))
    };
    for _ in 0..300 {
        if has_fine_timers() && is_measured() {
            return;
        }
        thread::sleep(Duration::from_millis(10));
    }
}

/// Whether the kernel still measures the TSC, by its clock source; unless it was told the rate, which it then finds again.
fn is_measuring(source: &str, command_line: &str) -> bool {
    source.trim() == "tsc-early" && !command_line.contains("tsc_early_khz=")
}

/// Whether a timer's resolution is below that of the tick (`hrtimer_get_res`, kernel
/// kernel/time/hrtimer.c).
fn has_fine_timers() -> bool {
    let mut resolution = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the kernel fills in the live structure.
    check(unsafe { libc::clock_getres(libc::CLOCK_MONOTONIC, &raw mut resolution) }).is_err()
        || (resolution.tv_sec, resolution.tv_nsec) <= (0, 1000)
}

/// Loads what interrupts of devices need, if this is the run of the appliance. Elsewhere it is the user
/// who decides which modules there are.
///
/// # Errors
/// What is wrong with the list or a module.
pub fn load_for_interrupts(role: Role) -> io::Result<()> {
    load_for(role, INTERRUPT_MODULES)
}

/// Loads what devices behind an IOMMU need, if this is the appliance.
///
/// # Errors
/// What is wrong with the list or a module.
pub fn load_for_vfio(role: Role) -> io::Result<()> {
    load_for(role, VFIO_MODULES)
}

/// Loads what network interfaces need, if this is the appliance.
///
/// # Errors
/// What is wrong with the list or a module.
pub fn load_for_networks(role: Role) -> io::Result<()> {
    load_for(role, NET_MODULES)
}

/// Loads what sockets need, if this is the appliance.
///
/// # Errors
/// What is wrong with the list or a module.
pub fn load_for_sockets(role: Role) -> io::Result<()> {
    load_for(role, VSOCK_MODULES)
}

fn load_for(role: Role, list: &str) -> io::Result<()> {
    if role != Role::Run {
        return Ok(());
    }
    load_modules(Path::new(list)).map_err(io::Error::other)
}

/// The detector of lockups wakes a thread on each CPU every four seconds that comes before
/// SCHED_DEADLINE (kernel/watchdog.c). The appliance has no reader for its message, and what hangs is
/// seen by Takt and the hardware's watchdog.
fn switch_lockup_detection_off() {
    // A kernel without it has no such file.
    let _ = fs::write(LOCKUP_DETECTION, "0");
}

fn make_folder(path: &Path) -> Result<(), Error> {
    fs::create_dir_all(path).map_err(|source| Error::Folder { path: path.into(), source })
}

fn mount(kind: &'static CStr, target: &'static CStr) -> Result<(), Error> {
    make_folder(Path::new(std::ffi::OsStr::from_bytes(target.to_bytes())))?;
    // SAFETY: the three strings are NUL-terminated and outlive the call; these file systems take
    // no data argument, and a null pointer says so.
    let result = unsafe {
        libc::mount(
            kind.as_ptr(),
            target.as_ptr(),
            kind.as_ptr(),
            libc::MS_NOSUID | libc::MS_NOEXEC,
            std::ptr::null(),
        )
    };
    check(result).map_err(|source| Error::Mount { kind, target, source })
}

/// Makes `/dev/console` the three standard streams, whatever the kernel opened before.
fn take_console() -> io::Result<()> {
    let console = OpenOptions::new().read(true).write(true).open("/dev/console")?;
    for stream in 0..=2 {
        // SAFETY: `console` is open. The standard streams have no owner in safe Rust that could
        // be surprised: std refers to them by these numbers alone.
        check(unsafe { libc::dup2(console.as_raw_fd(), stream) })?;
    }
    Ok(())
}

/// Loads the drivers of hardware watchdogs, if this is the appliance. Which of them finds its
/// hardware shows when the watchdog is opened.
pub fn load_watchdog_drivers(role: Role) {
    if role == Role::Run {
        for name in fs::read_to_string(WATCHDOGS).unwrap_or_default().lines() {
            let _ = load_module(&Path::new(MODULES).join(name));
        }
    }
}

/// What KVM need not do here: interrupt every guest each five minutes for the sake of a clock, take pages
/// that it has split away again, and let guests be hypervisors. (`takt doctor` says the same of other
/// hosts.) A module ignores what it does not know.
///
/// With the processor's own timer (preemption timer) kvm-intel keeps a guest's deadlines without asking
/// Takt where they belong, and a guest that halts has them as timers of the host then.
const PARAMETERS: [(&str, &CStr); 3] = [
    ("kvm.ko", c"kvmclock_periodic_sync=0 nx_huge_pages_recovery_ratio=0"),
    ("kvm-amd.ko", c"nested=0"),
    ("kvm-intel.ko", c"nested=0 preemption_timer=0"),
];

fn load_modules(list: &Path) -> Result<(), Error> {
    let order =
        fs::read_to_string(list).map_err(|source| Error::Read { path: list.into(), source })?;
    let folder = list.parent().unwrap_or(Path::new("/"));
    for line in order.lines() {
        load_one_of(folder, line)?;
    }
    Ok(())
}

/// Loads the first module of `choice` that the machine accepts.
///
/// `kvm-amd` and `kvm-intel` are such a choice: which one fits is best decided by the modules
/// themselves, which know more about it than the CPU's name.
fn load_one_of(folder: &Path, choice: &str) -> Result<(), Error> {
    let mut refused = Vec::new();
    for name in choice.split_whitespace() {
        match load_module(&folder.join(name)) {
            Ok(()) => return Ok(()),
            Err(error) => refused.push(format!("{name}: {error}")),
        }
    }
    Err(Error::Module(refused))
}

fn load_module(path: &Path) -> io::Result<()> {
    let file = File::open(path)?;
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    let parameters = PARAMETERS.iter().find(|(module, _)| *module == name).map_or(c"", |(_, p)| p);
    // SAFETY: finit_module(2) reads the open file and the NUL-terminated parameter string, and
    // changes no memory of this process.
    let result = unsafe {
        libc::syscall(
            libc::SYS_finit_module,
            file.as_raw_fd(),
            parameters.as_ptr(),
            0 as libc::c_int,
        )
    };
    match check(if result < 0 { -1 } else { 0 }) {
        Err(error) if error.raw_os_error() == Some(libc::EEXIST) => Ok(()),
        other => other,
    }
}

/// Writes every file of `/out`, and the status, to the result port if there is one.
fn hand_over(status: u8) -> Result<(), Error> {
    match ResultPort::find() {
        None => Ok(()),
        Some(mut port) => archive::write(&mut port, Path::new(OUT), status),
    }
}

/// Switches the machine off, or starts it again, silently: the console belongs to the run, and its
/// last line too.
fn leave(how: libc::c_int) -> ! {
    // If this fails the kernel's farewell appears on the console, which does no harm.
    let _ = fs::write(KERNEL_LOG_LEVEL, "0");
    // SAFETY: both calls take no pointers. Nothing is left that an end of the machine could harm.
    unsafe {
        libc::tcdrain(libc::STDOUT_FILENO);
        libc::sync();
        libc::reboot(how);
    }
    // Only a machine without a way to switch off comes here, and PID 1 may not return.
    loop {
        thread::park();
    }
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result == -1 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_without_a_working_module_names_each() {
        let error = load_one_of(Path::new("/no/such/folder"), "one.ko two.ko").unwrap_err();
        let text = error.to_string();
        assert!(text.contains("one.ko: ") && text.contains("nor two.ko: "), "{text}");
    }

    #[test]
    fn a_kernel_that_measures_its_counter_is_waited_for_unless_it_was_told_the_rate() {
        assert!(is_measuring("tsc-early\n", "console=ttyS0 -- takt run"));
        assert!(!is_measuring("tsc-early\n", "tsc_early_khz=1000000 -- takt run"));
        for source in ["tsc\n", "hpet\n", ""] {
            assert!(!is_measuring(source, ""), "{source}");
        }
    }

    #[test]
    fn a_test_run_is_not_the_appliance() {
        assert_eq!(arguments(Role::of_this_process()), std::env::args_os().collect::<Vec<_>>());
    }
}
