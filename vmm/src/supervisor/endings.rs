//! The ends of guests: what is said of them, and what follows.
//!
//! An error that a guest does not survive takes this way. Its thread counts it and tells of its end; the health
//! monitor says what its table has for it; the partition's [`Life`](crate::life::Life) decides what follows, also from
//! orders and from the end of the run; and the effects are carried out, by the account for the thread and here for
//! the run.

use takt_scheduler::table::PartitionId;

use super::{Supervisor, leaving, tell};
use crate::account::Account;
use crate::control::Outcome;
use crate::control::protocol::EventKind;
use crate::life::{Effects, Event, Finished, Told};
use crate::restart::{Loading, Restart};
use crate::vcpu::guest::End;

impl Supervisor {
    /// Takes note of the partitions whose threads have ended.
    pub fn note_endings(&mut self) {
        loop {
            let told = self.accounts.iter_mut().enumerate().filter_map(|(id, account)| {
                let finished = account.ends.take().ok()??;
                Some((PartitionId(id), account.life.cause(finished)))
            });
            let mut told: Vec<_> = told.collect();
            if told.is_empty() {
                return;
            }
            told.sort_by_key(|(_, finished)| finished.at);
            // What they said last comes before the news of their ends.
            self.drain();
            for (id, finished) in told {
                self.note_end(id, finished);
            }
        }
    }

    /// Says how a partition's guest has ended, and does what follows.
    fn note_end(&mut self, id: PartitionId, finished: Finished) {
        let (base, now) = (self.desk.base(), self.desk.now());
        let Some(account) = self.accounts.get_mut(id.0) else { return };
        account.finish_line(id, &mut self.screen);
        let Account { name, health, .. } = account;
        if let End::ScheduleChange(_) = finished.end {
            self.screen.line("takt", &format!("{name}: {}", finished.end));
        }
        let action = health.end(&finished, base, |line| {
            self.screen.line("takt", &format!("{name}: {line}"));
            tell(&mut self.operators, now, EventKind::Health, Some(name), line);
        });
        if let Some(error) = account.restart.as_ref().and_then(Restart::failure) {
            self.screen.line("takt", &format!("{}: {error}", account.name));
        }
        let leaving = leaving::is_asked(account);
        let Effects { end_run, told, .. } = account.step(Event::Left { finished, action, leaving });
        self.running &= !end_run;
        let Some(told) = told else { return };
        if let Some(Outcome { kind, text }) = account.outcome(told) {
            self.screen.line("takt", &format!("{}: {text}", account.name));
            tell(&mut self.operators, now, kind, Some(&account.name), &text);
            return;
        }
        if told == Told::NotStarted {
            let text = format!("{}: not started again, since the run ends", account.name);
            self.screen.line("takt", &text);
        }
        let kind = if told == Told::Restarted { EventKind::Restarted } else { EventKind::Ended };
        tell(&mut self.operators, now, kind, Some(&account.name), &finished.end.to_string());
    }

    /// Lets go of the threads whose guests have ended, and makes no guest wait any more.
    #[must_use]
    pub fn without_restarts(mut self) -> (Self, Vec<Loading>) {
        self.over = true;
        let mut loading = Vec::new();
        for account in &mut self.accounts {
            loading.extend(account.restart.take().map(Restart::end));
            account.step(Event::RunOver);
        }
        (self, loading)
    }
}
