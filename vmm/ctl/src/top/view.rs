//! What the screen shows, without the screen.

use std::collections::{BTreeMap, VecDeque};

use takt_points::Point;
use takt_protocol::{Event, Status, Values, VersionStatus};

/// Half seconds that are kept: more than a screen is wide.
const SAMPLES: usize = 256;
/// Events that are kept: more than a screen is high.
const EVENTS: usize = 128;

/// What is known of the run.
#[derive(Debug, Default)]
pub struct View {
    /// The latest.
    pub status: Option<Status>,
    /// The oldest first.
    pub events: VecDeque<Event>,
    /// Mean release latency between two answers in nanoseconds, by partition; the oldest first. `None` where there was no
    /// release in between.
    pub latencies: BTreeMap<String, VecDeque<Option<u64>>>,
    /// Versions of programs, by partition.
    pub versions: BTreeMap<String, Vec<VersionStatus>>,
    /// Why the status is old.
    pub problem: Option<String>,
    /// Which page is shown.
    pub page: Page,
    /// What is watched, if the user has named values.
    pub watched: Vec<Watched>,
    /// Why the values are old.
    pub values_problem: Option<String>,
    /// Lines of the values that are above the screen.
    pub scrolled: usize,
}

/// What the screen shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Page {
    /// How the run stands.
    #[default]
    Overview,
    /// The values that the user has named.
    Values,
}

/// The values of a partition that the user has named.
#[derive(Debug, Default)]
pub struct Watched {
    /// Whose.
    pub partition: String,
    /// Which.
    pub points: Vec<Point>,
    /// The latest line, and each of its values as text.
    pub latest: Option<(Values, Vec<String>)>,
}

impl View {
    /// A new status has come.
    pub fn status(&mut self, new: Status) {
        self.problem = None;
        // Another run may be up for longer than the last answer of the one before; and in an appliance every Takt is
        // process 1.
        let another = |old: &Status| old.pid != new.pid || old.uptime_ns > new.uptime_ns;
        if self.status.as_ref().is_some_and(another) {
            self.latencies.clear();
            self.versions.clear();
            self.status = None;
        }
        for partition in &new.partitions {
            let Some(now) = &partition.releases else { continue };
            let old = self.status.as_ref().and_then(|old| {
                old.partitions.iter().find(|p| p.name == partition.name)?.releases.as_ref()
            });
            let (count, sum) = old.map_or((0, 0), |old| (old.happened, old.latency_sum_ns));
            let count = now.happened.saturating_sub(count);
            let samples = self.latencies.entry(partition.name.clone()).or_default();
            let mean = now.latency_sum_ns.saturating_sub(sum).checked_div(count);
            push(samples, mean, SAMPLES);
        }
        self.status = Some(new);
    }

    /// These are the latest events.
    pub fn events(&mut self, events: Vec<Event>) {
        self.events.clear();
        events.into_iter().for_each(|event| self.event(event));
    }

    /// Another event has come.
    pub fn event(&mut self, event: Event) {
        push(&mut self.events, event, EVENTS);
    }

    /// Shows the other page.
    pub fn turn(&mut self) {
        self.page = match self.page {
            Page::Overview => Page::Values,
            Page::Values => Page::Overview,
        };
    }

    /// Takt does not answer any more.
    pub fn lost(&mut self, why: String) {
        self.problem = Some(why);
    }
}

fn push<T>(queue: &mut VecDeque<T>, value: T, most: usize) {
    if queue.len() >= most {
        queue.pop_front();
    }
    queue.push_back(value);
}
