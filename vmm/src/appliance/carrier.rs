//! The inside end of the line by which the control socket is carried out of the machine (`vmm/carry`).
//!
//! It is a process of its own, of SCHED_OTHER, on the CPUs that are left when those with windows are set apart. It has
//! no capability from its first instruction on. `scripts/run` gives a machine a line if the partition file has a control
//! socket, and names it in the environment.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use crate::sandbox::privileges;

/// The program.
const PROGRAM: &str = "/carry";
/// Where PCI functions are.
const FUNCTIONS: &str = "/sys/bus/pci/devices";
/// In the environment: the address of the function that is the line, and the control socket.
const LINE: &str = "TAKT_CONTROL_LINE";
const SOCKET: &str = "TAKT_CONTROL_SOCKET";

/// Starts it, if the machine has a line. A run without it is still a run, and its user is told.
pub fn start() -> Option<Child> {
    let (line, socket) = (std::env::var_os(LINE)?, std::env::var_os(SOCKET)?);
    let function = Path::new(FUNCTIONS).join(line);
    // Firmware enables a function's memory, most of the time.
    if let Ok(mut enable) = OpenOptions::new().write(true).open(function.join("enable")) {
        let _ = enable.write_all(b"1");
    }
    let mut command = Command::new(PROGRAM);
    command.arg("inside").arg(function.join("resource2")).arg(socket).stdin(Stdio::null());
    // SAFETY: this process has one thread, so what runs between fork and exec may do as it does elsewhere.
    unsafe { command.pre_exec(|| privileges::drop_all(0)) };
    match command.spawn() {
        Ok(child) => Some(child),
        Err(error) => {
            eprintln!(
                "takt: appliance: the control socket is not carried out: cannot run {PROGRAM}: {error}"
            );
            None
        }
    }
}

/// Ends it after the run. It ends by itself when Takt closes its socket, with what Takt has said last; one that has
/// found no Takt does not.
pub fn end(carrier: &mut Child) {
    for _ in 0..20 {
        if !matches!(carrier.try_wait(), Ok(None)) {
            return;
        }
        thread::sleep(Duration::from_millis(10));
    }
    // It is a child that has not been waited for, so its number is still its own.
    let _ = carrier.kill().and_then(|()| carrier.wait());
}
