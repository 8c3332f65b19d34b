//! The periods of the kernel's deadline scheduler, in terms of the file.
//!
//! A file whose windows come too often or too rarely for it is refused here, rather than by the kernel
//! on the day that the machine is started. The bounds are the kernel's defaults; a host whose owner
//! has narrowed them refuses the rest itself.

use takt_scheduler::reservation::{CpuReservations, PERIOD_MAX, PERIOD_MIN, PeriodError};
use takt_scheduler::schedules::Schedules;
use takt_scheduler::table::{Cpu, PartitionId};
use takt_scheduler::time::Nanos;

use super::diagnostic::{Diagnostic, Span, quote};
use super::raw;
use super::schedules::Draft;

/// Checks the periods that the windows of one CPU ask for.
pub fn check(draft: &Draft<'_>, schedules: &Schedules, cpu: Cpu) -> Result<(), Diagnostic> {
    let Err(error) = CpuReservations::check(schedules, cpu) else { return Ok(()) };
    let name = |id: PartitionId| quote(&draft.partitions[id.0].partition.name);
    Err(match error {
        PeriodError::Partition { partition, period } => {
            let found = format!("{error} for {}", name(partition));
            let remedy = if period < PERIOD_MIN {
                "fewer windows, or ones at even distances"
            } else {
                "a shorter `period` repeats a window within the frame"
            };
            let allowed = format!(
                "{PERIOD_MIN} to {PERIOD_MAX}, also across a switch, since the kernel's \
                 SCHED_DEADLINE admits no other period; {remedy}"
            );
            Diagnostic::new(place_of(draft, partition, period), found, allowed)
        }
        PeriodError::Ends { .. } => {
            let found = format!("on CPU {} {error}", cpu.0);
            let allowed = format!(
                "{PERIOD_MIN} or more, also across a switch: to end a window takes a budget, which \
                 the kernel's SCHED_DEADLINE gives no more often"
            );
            match closest_ends(draft, cpu) {
                Some([before, after]) => Diagnostic::new(after.duration.span(), found, allowed)
                    .and(before.duration.span(), "the window that ends before it"),
                None => Diagnostic::new(draft.header.clone(), found, allowed),
            }
        }
        PeriodError::Slack { partition, .. } => {
            let windows = windows_of(draft, partition);
            let longest = windows.max_by_key(|raw| raw.duration.get_ref().0);
            let place = longest.map_or(draft.header.clone(), |raw| raw.duration.span());
            let found = format!("of {}, {error}", name(partition));
            let allowed = format!(
                "more than {PERIOD_MIN}: a thread that ends windows has no shorter deadline, and \
                 would not preempt this one; a shorter window, or a longer `period`"
            );
            Diagnostic::new(place, found, allowed)
        }
    })
}

fn windows_of<'a>(
    draft: &'a Draft<'_>,
    owner: PartitionId,
) -> impl Iterator<Item = &'a raw::Window> {
    draft.schedules.iter().flat_map(move |lines| {
        let owned = lines.windows.iter().zip(&lines.raw).filter(move |(w, _)| w.partition == owner);
        owned.map(|(_, raw)| &raw.get_ref().0)
    })
}

/// The value that says `period`, if there is one, or else where the partition's last window starts.
fn place_of(draft: &Draft<'_>, owner: PartitionId, period: Nanos) -> Span {
    let periods = windows_of(draft, owner).filter_map(|raw| raw.period.as_ref());
    let (frame, mut written) = (draft.frame, periods.filter(|p| p.get_ref().0 == period));
    match (written.next(), windows_of(draft, owner).last()) {
        (Some(written), _) => written.span(),
        (None, _) if frame.get_ref().0 == period => frame.span(),
        (None, Some(last)) => last.offset.span(),
        (None, None) => draft.header.clone(),
    }
}

/// The two windows of a CPU whose ends lie closest together, also across a switch.
fn closest_ends<'a>(draft: &'a Draft<'_>, cpu: Cpu) -> Option<[&'a raw::Window; 2]> {
    let frame = draft.frame.get_ref().0;
    let mut schedules = Vec::new();
    for lines in &draft.schedules {
        let mut ends = Vec::new();
        for (window, raw) in lines.windows.iter().zip(&lines.raw) {
            if draft.partitions[window.partition.0].partition.cpu != cpu {
                continue;
            }
            let repetitions = frame.0 / window.period.0.max(1);
            let end = |n: u64| window.end().plus(Nanos(n * window.period.0));
            ends.extend((0..repetitions).map(|n| (end(n), &raw.get_ref().0)));
        }
        ends.sort_by_key(|(end, _)| *end);
        schedules.push(ends);
    }
    let within = schedules.iter().flat_map(|ends| ends.windows(2).map(|two| (two[0], two[1])));
    let lasts = schedules.iter().filter_map(|ends| ends.last());
    let across = lasts.flat_map(|last| {
        let firsts = schedules.iter().filter_map(|ends| ends.first());
        firsts.map(move |first| (*last, (frame.plus(first.0), first.1)))
    });
    let (before, after) = within.chain(across).min_by_key(|(a, b)| b.0.less(a.0))?;
    Some([before.1, after.1])
}
