//! The tables of the health monitor: who does what about which error.
//!
//! Each `[[health]]` is one row, and what has no row keeps its default. A row that could never be
//! used is refused, as is a second one for the same error: its author believes something that
//! is not so, and would find out on the day of the error.

use takt_scheduler::time::Nanos;
use toml::Spanned;

use crate::Kind;
use crate::diagnostic::{Diagnostic, quote};
use crate::partition::{self, Checked};
use crate::raw::{self, Keys};

mod fault;
mod table;

pub use fault::{FAULTS, Fault};
pub use table::{ACTIONS, Action, Limit, Table};

/// Most restarts of a limit: above, it is none.
const AT_MOST_MAX: i64 = 100;
/// Longest span of a limit, a day.
const WITHIN_MAX: Nanos = Nanos::from_millis(86_400_000);

/// Checks all rows, in the order of the file, and enters them into the partitions' tables.
pub(crate) fn check(
    rows: &[Spanned<Keys<raw::Health>>],
    partitions: &mut [Checked],
) -> Result<(), Diagnostic> {
    let mut seen: Vec<(usize, Fault, &Spanned<String>)> = Vec::with_capacity(rows.len());
    for row in rows {
        let Keys(raw) = row.get_ref();
        let owner = partition::find(partitions, raw.partition.get_ref(), raw.partition.span())?;
        let (id, kind) = (owner.partition.id.0, &owner.partition.kind);
        let fault = check_fault(&raw.error, kind)?;
        if fault == Fault::PartitionSilent && owner.partition.watchdog.is_none() {
            let found =
                format!("no watchdog looks for a heartbeat of {}", quote(&owner.partition.name));
            let allowed = "this error for a partition with a `watchdog`";
            return Err(Diagnostic::new(raw.error.span(), found, allowed)
                .and(owner.header.clone(), "the partition"));
        }
        let action = check_action(&raw.action, kind)?;
        if let Some((.., other)) = seen.iter().find(|(p, f, _)| (*p, *f) == (id, fault)) {
            let name = quote(&owner.partition.name);
            let found = format!("a second action for the error \"{fault}\" of {name}");
            let allowed = "one [[health]] for each error of a partition";
            return Err(Diagnostic::new(raw.error.span(), found, allowed)
                .and(other.span(), "the other one"));
        }
        seen.push((id, fault, &raw.error));
        let table = &mut partitions[id].partition.health;
        *table = table.with(fault, action);
    }
    Ok(())
}

/// The table of a partition for which there is no row, with its limit.
pub(crate) fn default_table(
    kind: &Kind,
    limit: Option<&Spanned<Keys<raw::Restarts>>>,
) -> Result<Table, Diagnostic> {
    let table = match kind {
        Kind::Plc { .. } => Table::PLC,
        Kind::Linux { .. } => Table::LINUX,
    };
    let Some(limit) = limit else { return Ok(table) };
    let Keys(raw) = limit.get_ref();
    let number = *raw.at_most.get_ref();
    let at_most =
        u32::try_from(number).ok().filter(|_| number <= AT_MOST_MAX).ok_or_else(|| {
            let allowed = format!("0 to {AT_MOST_MAX}; 0 for none at all");
            Diagnostic::new(raw.at_most.span(), format!("{number} restarts"), allowed)
        })?;
    let within = raw.within.get_ref().0;
    if within == Nanos::ZERO || within > WITHIN_MAX {
        let found = format!("a span of {within} for restarts");
        let allowed = format!("more than nothing, and at most {WITHIN_MAX}");
        return Err(Diagnostic::new(raw.within.span(), found, allowed));
    }
    Ok(table.within(Limit { at_most, within }))
}

fn check_fault(name: &Spanned<String>, kind: &Kind) -> Result<Fault, Diagnostic> {
    let (kind, possible): (_, fn(Fault) -> bool) = match kind {
        Kind::Plc { .. } => ("plc", Fault::of_plc),
        Kind::Linux { .. } => ("linux", Fault::of_linux),
    };
    let allowed = || {
        let names = FAULTS.into_iter().filter(|fault| possible(*fault)).map(Fault::name);
        format!("for a \"{kind}\": {}", list(names))
    };
    let Some(fault) = Fault::from_name(name.get_ref()) else {
        let found = format!("there is no error {}", quote(name.get_ref()));
        return Err(Diagnostic::new(name.span(), found, allowed()));
    };
    if !possible(fault) {
        let found = format!("a partition of kind \"{kind}\" never has the error \"{fault}\"");
        return Err(Diagnostic::new(name.span(), found, allowed()));
    }
    Ok(fault)
}

fn check_action(name: &Spanned<String>, kind: &Kind) -> Result<Action, Diagnostic> {
    let linux = matches!(kind, Kind::Linux { .. });
    let possible = |action: &Action| !(linux && *action == Action::WarmStart);
    let allowed = || list(ACTIONS.into_iter().filter(possible).map(Action::name));
    let Some(action) = Action::from_name(name.get_ref()) else {
        let found = format!("there is no action {} for an error", quote(name.get_ref()));
        return Err(Diagnostic::new(name.span(), found, allowed()));
    };
    if !possible(&action) {
        let found = "a \"linux\" retains nothing that a warm start could keep";
        return Err(Diagnostic::new(name.span(), found, allowed()));
    }
    Ok(action)
}

fn list(names: impl Iterator<Item = &'static str>) -> String {
    names.map(quote).collect::<Vec<_>>().join(", ")
}
