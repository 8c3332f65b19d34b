//! Expedited RCU grace periods, for as long as nothing runs that could be disturbed.
//!
//! Whatever a machine gets from KVM (memory slots, routes of interrupts, doorbells, its first thread)
//! takes a grace period: KVM waits until no processor can still see what was there before. A kernel
//! with PREEMPT_RT waits some timer ticks for each, because an expedited period interrupts
//! the other processors (`rcu_normal`, which it sets for itself; kernel/rcu/update.c). While a run is
//! prepared in the appliance no guest runs on them, so grace periods are expedited there until the
//! first guest starts.
//!
//! During an expedited period a worker of the kernel polls until no thread can still read the old state
//! (`process_srcu`, kernel/rcu/srcutree.c). With one processor, the worker can preempt the thread that asked for the
//! period while that thread is such a reader. The worker then polls until the next timer tick: up to 4 ms
//! for each machine. So the thread that asks has a real-time class, and the worker runs only when it waits.
//!
//! On any other host the processors are somebody else's too, and the setting is one for all of them:
//! it is left alone.

use std::fs::{self, OpenOptions};
use std::io::Write;

use super::Role;

/// What is set, and to what.
const SETTINGS: [(&str, &str); 2] =
    [("/sys/kernel/rcu_normal", "0"), ("/sys/kernel/rcu_expedited", "1")];

/// While it lives, grace periods are short, for the thread that has it. Dropping it sets what was set
/// before.
pub struct ExpeditedRcu {
    before: Vec<(fs::File, String)>,
    /// Whether the thread is of a real-time class for so long.
    real_time: bool,
}

impl ExpeditedRcu {
    /// Sets expedited grace periods, if this is the appliance. A kernel without them starts guests as well,
    /// only later.
    #[must_use]
    pub fn begin(role: Role) -> ExpeditedRcu {
        let appliance = role.owns_machine();
        // In turn with threads of the kernel's that have this priority too, since to clear memory takes
        // seconds; and not for the threads that it starts.
        let real_time = appliance && class(libc::SCHED_RR | libc::SCHED_RESET_ON_FORK, 1);
        Self::by(if appliance { &SETTINGS } else { &[] }, real_time)
    }

    fn by(settings: &[(&str, &str)], real_time: bool) -> ExpeditedRcu {
        let mut before = Vec::new();
        for (path, value) in settings {
            let Ok(was) = fs::read_to_string(path) else { continue };
            let Ok(mut file) = OpenOptions::new().write(true).open(path) else { continue };
            if file.write_all(value.as_bytes()).is_ok() {
                before.push((file, was));
            }
        }
        ExpeditedRcu { before, real_time }
    }
}

/// Puts the calling thread into a scheduling class.
fn class(policy: libc::c_int, priority: libc::c_int) -> bool {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: the kernel reads the live structure.
    unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) == 0 }
}

impl Drop for ExpeditedRcu {
    fn drop(&mut self) {
        for (file, was) in &mut self.before {
            // What could be set can be set back.
            let _ = file.write_all(was.trim_end().as_bytes());
        }
        if self.real_time {
            class(libc::SCHED_OTHER, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_set_before_is_set_again() {
        let file = std::env::temp_dir().join(format!("takt-expedited-{}", std::process::id()));
        fs::write(&file, "1\n").unwrap();
        let expedited =
            ExpeditedRcu::by(&[("/no/such/setting", "0"), (file.to_str().unwrap(), "0")], false);
        assert_eq!(fs::read_to_string(&file).unwrap(), "0\n");
        drop(expedited);
        // The kernel takes each write for itself; a plain file keeps them one behind the other.
        assert_eq!(fs::read_to_string(&file).unwrap(), "01");
        fs::remove_file(file).unwrap();
    }
}
