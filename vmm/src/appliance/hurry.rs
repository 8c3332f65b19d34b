//! A kernel in a hurry, for as long as nothing runs that could be disturbed.
//!
//! Whatever a machine gets from KVM (memory slots, routes of interrupts, doorbells, its first thread)
//! takes a grace period: KVM waits until no processor can still see what was there before. A kernel
//! with PREEMPT_RT takes its time for that, some timer ticks each, because hurrying means to interrupt
//! the other processors (`rcu_normal`, which it sets for itself; kernel/rcu/update.c). While a run is
//! prepared in the appliance there is nobody on them, so there it hurries, and no longer when the
//! first guest starts.
//!
//! On any other host the processors are somebody else's too, and the setting is one for all of them:
//! it is left alone.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;

use super::MODULE_LIST;

/// What is set, and to what.
const SETTINGS: [(&str, &str); 2] =
    [("/sys/kernel/rcu_normal", "0"), ("/sys/kernel/rcu_expedited", "1")];

/// While it lives, grace periods are short. Dropping it sets what was set before.
pub struct Hurry {
    before: Vec<(fs::File, String)>,
}

impl Hurry {
    /// Begins to hurry, if this is the appliance. A kernel that knows no hurry starts guests as well,
    /// only later.
    #[must_use]
    pub fn begin() -> Hurry {
        if Path::new(MODULE_LIST).exists() { Self::by(&SETTINGS) } else { Self::by(&[]) }
    }

    fn by(settings: &[(&str, &str)]) -> Hurry {
        let mut before = Vec::new();
        for (path, hurried) in settings {
            let Ok(was) = fs::read_to_string(path) else { continue };
            let Ok(mut file) = OpenOptions::new().write(true).open(path) else { continue };
            if file.write_all(hurried.as_bytes()).is_ok() {
                before.push((file, was));
            }
        }
        Hurry { before }
    }
}

impl Drop for Hurry {
    fn drop(&mut self) {
        for (file, was) in &mut self.before {
            // What could be set can be set back.
            let _ = file.write_all(was.trim_end().as_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_set_before_is_set_again() {
        let file = std::env::temp_dir().join(format!("takt-hurry-{}", std::process::id()));
        fs::write(&file, "1\n").unwrap();
        let hurry = Hurry::by(&[("/no/such/setting", "0"), (file.to_str().unwrap(), "0")]);
        assert_eq!(fs::read_to_string(&file).unwrap(), "0\n");
        drop(hurry);
        // The kernel takes each write for itself; a plain file keeps them one behind the other.
        assert_eq!(fs::read_to_string(&file).unwrap(), "01");
        fs::remove_file(file).unwrap();
    }
}
