//! The end of a run, in order: a Linux that can be asked is asked to switch itself off, so that its file systems
//! are whole, and all partitions run on meanwhile.
//!
//! ```text
//!            signal, key, time                all are off, time is up, signal, key
//!  running ------------------> leaving --------------------------------------------> over
//!     |                                                                               ^
//!     +-------------- the same, and there is none to ask; a table says so ------------+
//! ```

use takt_scheduler::time::Nanos;

use super::Supervisor;
use crate::account::Account;
use crate::power_button::PowerButton;

impl Supervisor {
    /// Ends the run: at once if there is no guest to ask, or if they have been asked.
    pub(super) fn leave(&mut self) {
        if self.leaving {
            self.give_up();
            return;
        }
        let now = self.desk.now();
        let Some(patience) = self.ask_to_power_off(now) else {
            self.running = false;
            return;
        };
        self.leaving = true;
        let until = now.plus(patience);
        self.until = Some(until);
        if let Some(timers) = &mut self.timers {
            timers.end_at(until);
        }
        let text = format!(
            "the run ends when Linux is off, in {patience} at the latest; ask again to end it at once"
        );
        self.screen.line("takt", &text);
    }

    /// Ends the run, and says which guests were waited for.
    fn give_up(&mut self) {
        self.running = false;
        for account in self.accounts.iter().filter(|account| is_awaited(account)) {
            let text = format!("{}: did not power off, and is stopped", account.name);
            self.screen.line("takt", &text);
        }
    }

    /// Asks the guests that run. Returns how long the most patient has; `None` if there is none to ask.
    fn ask_to_power_off(&mut self, now: Nanos) -> Option<Nanos> {
        let mut longest = None;
        for account in &mut self.accounts {
            let Some((patience, text)) = account.ask_to_power_off(now) else { continue };
            longest = longest.max(patience);
            self.screen.line("takt", &format!("{}: {text}", account.name));
        }
        longest
    }

    /// Whether there is a guest to wait for.
    pub(super) fn awaits_power_off(&self) -> bool {
        self.accounts.iter().any(is_awaited)
    }
}

/// Whether a guest has been asked and has not ended.
fn is_awaited(account: &Account) -> bool {
    account.life.is_up() && is_asked(account)
}

/// Whether a guest has been asked, and so is not started again whatever its end.
pub(super) fn is_asked(account: &Account) -> bool {
    account.power_button.as_ref().is_some_and(PowerButton::is_pressed)
}
