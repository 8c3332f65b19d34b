//! Whether the clock by which the kernel sleeps can be steered.
//!
//! Sleeps are divided because a time daemon may change the rate of CLOCK_MONOTONIC by up to a tenth in the
//! middle of one ([`takt_scheduler::sleep`]). Each division is a wake-up, and 11 us of what a PLC leaves to the
//! background. The appliance has no time daemon. So that none can be started, its process 1 takes the privilege
//! for it out of its bounding set before it starts any other process: no descendant can then get it, by
//! any program. All processes descend from it but the kernel's own threads.
//!
//! Everywhere else the bounding set of process 1 has it, or this is a container whose process 1 says nothing of
//! the host. Then the clock is taken for one that may be steered.

use std::fs;
use std::io;
use std::path::Path;

use takt_scheduler::sleep::Steering;

use crate::hooks;

/// Number of the privilege to set clocks (`CAP_SYS_TIME`, include/uapi/linux/capability.h).
const SYS_TIME: u32 = 25;
/// What the kernel calls its first namespace of processes: `PROC_PID_INIT_INO` of include/linux/proc_ns.h.
const FIRST_NAMESPACE: &str = "pid:[4026531836]";

/// Takes the privilege from all processes that this one is going to start. For process 1.
///
/// # Errors
/// What the kernel says.
pub fn give_up() -> io::Result<()> {
    if hooks::clock_may_be_steered() {
        return Ok(());
    }
    // SAFETY: touches no memory, and takes a privilege only from programs that are executed later.
    match unsafe { libc::prctl(libc::PR_CAPBSET_DROP, SYS_TIME, 0, 0, 0) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Whether the clock can be steered. Reads two files.
#[must_use]
pub fn look() -> Steering {
    look_in(Path::new("/proc"))
}

fn look_in(proc: &Path) -> Steering {
    let first = fs::read_link(proc.join("self/ns/pid"));
    let first = first.is_ok_and(|namespace| namespace == Path::new(FIRST_NAMESPACE));
    let bounds = fs::read_to_string(proc.join("1/status")).ok();
    match bounds.as_deref().and_then(bounding_set) {
        Some(set) if first && set & 1 << SYS_TIME == 0 => Steering::Impossible,
        _ => Steering::Possible,
    }
}

/// The bounding set in a process's status; `None` if it has none.
fn bounding_set(status: &str) -> Option<u64> {
    let set = status.lines().find_map(|line| line.strip_prefix("CapBnd:"))?;
    u64::from_str_radix(set.trim(), 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// What is concluded where these are process 1's status and the own namespace.
    fn concluded(name: &str, status: &str, namespace: &str) -> Steering {
        let proc =
            std::env::temp_dir().join(format!("takt-steering-{}-{name}", std::process::id()));
        fs::create_dir_all(proc.join("self/ns")).unwrap();
        fs::create_dir_all(proc.join("1")).unwrap();
        fs::write(proc.join("1/status"), status).unwrap();
        symlink(namespace, proc.join("self/ns/pid")).unwrap();
        let concluded = look_in(&proc);
        fs::remove_dir_all(proc).unwrap();
        concluded
    }

    #[test]
    fn only_a_first_process_without_the_privilege_rules_it_out() {
        let without = "Name:\tinit\nCapEff:\t000001ffffffffff\nCapBnd:\t000001fffdffffff\n";
        let with = "Name:\tinit\nCapEff:\t000001fffdffffff\nCapBnd:\t000001ffffffffff\n";
        assert_eq!(concluded("appliance", without, FIRST_NAMESPACE), Steering::Impossible);
        assert_eq!(concluded("host", with, FIRST_NAMESPACE), Steering::Possible);
        assert_eq!(concluded("container", without, "pid:[4026532177]"), Steering::Possible);
        for bad in ["", "CapBnd:", "CapBnd: nothing", "CapBnd: 1000001fffdffffffff"] {
            assert_eq!(concluded("bad", bad, FIRST_NAMESPACE), Steering::Possible, "{bad}");
        }
        assert_eq!(look_in(Path::new("/nowhere")), Steering::Possible);
    }
}
