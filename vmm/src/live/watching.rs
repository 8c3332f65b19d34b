//! What clients look at in one partition: one list for its kernel, made of the lists of all clients.
//!
//! A range that two clients want is copied once. The kernel's samples come in parts; a whole one is cut up again for
//! each client. What does not fit into the budgets of the partition file is refused when it is asked for, so that what
//! has been accepted always fits.

use takt_abi::live::{Order, RANGES_EACH, Range, Ranges, SAMPLE_BYTES, SampleHead, WATCHED_RANGES};
use takt_scheduler::time::Nanos;

use super::limits::ProgramLimits;
use super::link::Link;

/// From here on clients are Takt itself, which looks at what programs retain: the partition file's budgets are not for it.
pub const OWN_CLIENTS: u64 = u64::MAX - 255;

/// What one client looks at.
struct Subscription {
    client: u64,
    ranges: Vec<Range>,
    /// Where each range begins in a sample.
    places: Vec<usize>,
    interval: Nanos,
    /// The kernel's time of the last line, as it tells it.
    last: Option<Nanos>,
    /// Samples that the kernel gave up since the last line.
    missed: u64,
}

/// Values for a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sampled {
    /// The client.
    pub client: u64,
    /// What precedes the bytes.
    pub head: SampleHead,
    /// Samples of its list that were given up before this one.
    pub missed: u64,
    /// The bytes of its ranges.
    pub bytes: Vec<u8>,
}

/// All that is looked at.
#[derive(Default)]
pub struct Watching {
    subscriptions: Vec<Subscription>,
    /// For the kernel: in order, and none touches another.
    layout: Vec<Range>,
    serial: u32,
    /// How many orders of the list the kernel has been sent, if it does not have all of them.
    unsent: Option<usize>,
    /// The sample that is coming.
    sample: Vec<u8>,
    parts: u16,
}

impl Watching {
    /// Lets a client look at these ranges instead of what it looked at before. Nothing changes if it is refused.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn watch(
        &mut self,
        client: u64,
        ranges: Vec<Range>,
        interval: Nanos,
        limits: &[ProgramLimits],
    ) -> Result<u64, String> {
        ranges.iter().try_for_each(|range| ProgramLimits::find(limits, range).map(drop))?;
        // The layout has each byte once, but a client gets a byte as often as it has named it.
        let bytes: u64 = ranges.iter().map(|range| u64::from(range.bytes)).sum();
        if bytes > SAMPLE_BYTES as u64 {
            return Err(format!(
                "the ranges have {bytes} bytes together, and a client gets at most {SAMPLE_BYTES} in a cycle; bytes \
                 that are in several ranges count in each"
            ));
        }
        let all = |of: fn(&u64) -> bool| {
            let others = self.subscriptions.iter().map(|s| (s.client, &s.ranges));
            let others = others.filter(|(other, _)| *other != client).chain([(client, &ranges)]);
            let counted = others.filter(|(client, _)| of(client));
            merged(counted.flat_map(|(_, ranges)| ranges).copied().collect())
        };
        fits_budgets(&all(|client| *client < OWN_CLIENTS), limits)?;
        let layout = all(|_| true);
        fits_kernel(&layout)?;
        self.subscriptions.retain(|s| s.client != client);
        if !ranges.is_empty() {
            let places = Vec::new();
            let last = None;
            let new = Subscription { client, ranges, places, interval, last, missed: 0 };
            self.subscriptions.push(new);
        }
        self.use_layout(layout);
        Ok(bytes)
    }

    /// Forgets clients that are gone.
    pub fn keep(&mut self, is_there: impl Fn(u64) -> bool) {
        let is_there = |s: &Subscription| s.client >= OWN_CLIENTS || is_there(s.client);
        self.drop_others(is_there);
    }

    fn drop_others(&mut self, stays: impl Fn(&Subscription) -> bool) {
        if self.subscriptions.iter().all(&stays) {
            return;
        }
        self.subscriptions.retain(stays);
        self.use_layout(merged(
            self.subscriptions.iter().flat_map(|s| &s.ranges).copied().collect(),
        ));
    }

    /// Ends the watches that look at a program, whose places are about to hold no longer. Returns whose they were.
    pub fn leave(&mut self, program: u8) -> Vec<u64> {
        let is_of = |s: &Subscription| s.ranges.iter().any(|range| range.program == program);
        let clients: Vec<u64> =
            self.subscriptions.iter().filter(|s| is_of(s)).map(|s| s.client).collect();
        self.drop_others(|s| !clients.contains(&s.client));
        clients
    }

    fn use_layout(&mut self, layout: Vec<Range>) {
        for subscription in &mut self.subscriptions {
            let place = |range: &Range| place(&layout, range);
            subscription.places = subscription.ranges.iter().filter_map(place).collect();
        }
        self.layout = layout;
        self.send_again();
    }

    /// The kernel has to be told the list: it is new, or the kernel is.
    pub fn send_again(&mut self) {
        let is_news = !self.subscriptions.is_empty() || self.serial != 0;
        self.unsent = is_news.then_some(0);
        self.sample.clear();
        self.parts = 0;
    }

    /// Tells the kernel the list, if it has to. What finds no room follows at the next turn: a list may be longer than the
    /// queue has room, and than the kernel takes in a window.
    pub fn send(&mut self, link: &mut Link) {
        let Some(sent) = self.unsent else { return };
        let serial = self.serial.wrapping_add(1).max(1);
        let interval = self.subscriptions.iter().map(|s| s.interval.0).min().unwrap_or(0);
        let adds = self.layout.chunks(RANGES_EACH).map(|part| Order::WatchAdd(Ranges::new(part)));
        let told = if self.subscriptions.is_empty() { 0 } else { serial };
        let begin = Order::WatchBegin { serial: told, interval_ns: interval };
        let orders = std::iter::once(Order::WatchClear).chain(adds).chain([begin]);
        for (number, order) in orders.enumerate().skip(sent) {
            if link.send(&order).is_err() {
                self.unsent = Some(number);
                return;
            }
        }
        (self.serial, self.unsent) = (serial, None);
    }

    /// Takes a part of a sample; calls `deliver` for each client for which a whole one is due.
    pub fn take(&mut self, head: &SampleHead, payload: &[u8], mut deliver: impl FnMut(Sampled)) {
        if head.serial != self.serial || self.unsent.is_some() {
            return;
        }
        if head.part == 0 {
            self.sample.clear();
            self.parts = 0;
        }
        let length: usize = self.layout.iter().map(|range| usize::from(range.bytes)).sum();
        let fits = self.sample.len() + payload.len() <= length;
        if head.part != self.parts || !fits {
            // A part is missing, or was never one. The next sample begins with part 0.
            self.parts = u16::MAX;
            return;
        }
        self.sample.extend_from_slice(payload);
        self.parts = self.parts.saturating_add(1);
        if !head.last || self.sample.len() != length {
            return;
        }
        let time = Nanos(head.time_ns);
        for subscription in &mut self.subscriptions {
            subscription.missed = subscription.missed.saturating_add(head.missed.into());
            // By the kernel's time: that at which a sample is taken from the queue varies, and a client would miss each second
            // one of a kernel that keeps to its interval. A kernel that started anew has an earlier time.
            let too_early = |last: Nanos| time >= last && time < last.plus(subscription.interval);
            if subscription.last.is_some_and(too_early) {
                continue;
            }
            subscription.last = Some(time);
            let missed = std::mem::take(&mut subscription.missed);
            let bytes = subscription.cut(&self.sample);
            deliver(Sampled { client: subscription.client, head: *head, missed, bytes });
        }
    }
}

impl Subscription {
    fn cut(&self, sample: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (range, place) in self.ranges.iter().zip(&self.places) {
            let piece = sample.get(*place..place + usize::from(range.bytes));
            bytes.extend_from_slice(piece.unwrap_or_default());
        }
        bytes
    }
}

/// The same bytes in order, each once.
fn merged(mut ranges: Vec<Range>) -> Vec<Range> {
    ranges.sort_unstable();
    let mut merged: Vec<Range> = Vec::with_capacity(ranges.len());
    for range in ranges {
        let end = |range: &Range| u64::from(range.offset) + u64::from(range.bytes);
        match merged.last_mut() {
            Some(last)
                if (last.program, last.area) == (range.program, range.area)
                    && u64::from(range.offset) <= end(last)
                    && end(&range) - u64::from(last.offset) <= u64::from(u16::MAX) =>
            {
                let bytes = end(&range).max(end(last)) - u64::from(last.offset);
                last.bytes = u16::try_from(bytes).unwrap_or(u16::MAX);
            }
            _ => merged.push(range),
        }
    }
    merged
}

/// Where a range begins in a sample of this layout.
fn place(layout: &[Range], range: &Range) -> Option<usize> {
    let mut at = 0;
    for whole in layout {
        let inside = (whole.program, whole.area) == (range.program, range.area)
            && whole.offset <= range.offset
            && u64::from(range.offset) + u64::from(range.bytes)
                <= u64::from(whole.offset) + u64::from(whole.bytes);
        if inside {
            return Some(at + (range.offset - whole.offset) as usize);
        }
        at += usize::from(whole.bytes);
    }
    None
}

fn fits_budgets(layout: &[Range], limits: &[ProgramLimits]) -> Result<(), String> {
    for (program, limits) in limits.iter().enumerate() {
        let own = layout.iter().filter(|range| usize::from(range.program) == program);
        let needed: u64 = own.map(|range| u64::from(range.bytes) + ProgramLimits::EACH_RANGE).sum();
        if needed > limits.watch {
            return Err(format!(
                "all clients together would watch {needed} bytes of the program {} in a cycle ({} of them \
                 for each separate piece of memory); its `watch` in the partition file allows {}",
                limits.name,
                ProgramLimits::EACH_RANGE,
                limits.watch
            ));
        }
    }
    Ok(())
}

fn fits_kernel(layout: &[Range]) -> Result<(), String> {
    let bytes: usize = layout.iter().map(|range| usize::from(range.bytes)).sum();
    if layout.len() > WATCHED_RANGES || bytes > SAMPLE_BYTES {
        return Err(format!(
            "all clients together would watch {} separate pieces of memory with {bytes} bytes, with what the programs \
             retain; a PLC has at most {WATCHED_RANGES} with {SAMPLE_BYTES} bytes",
            layout.len()
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::live::Area;

    fn range(program: u8, offset: u32, bytes: u16) -> Range {
        Range { program, area: Area::State, offset, bytes }
    }

    fn limits(watch: u64) -> [ProgramLimits; 2] {
        let areas = [100_000, 0, 8, 0];
        let program = |name: &str| ProgramLimits { name: name.into(), watch, force: true, areas };
        [program("a"), program("b")]
    }

    #[test]
    fn pieces_that_touch_or_overlap_are_one() {
        let ranges = vec![range(1, 0, 4), range(0, 8, 4), range(0, 0, 4), range(0, 2, 6)];
        let layout = merged(ranges);
        assert_eq!(layout, [range(0, 0, 12), range(1, 0, 4)]);
        assert_eq!(place(&layout, &range(0, 8, 4)), Some(8));
        assert_eq!(place(&layout, &range(1, 2, 2)), Some(14));
        assert_eq!(place(&layout, &range(1, 2, 4)), None);
        let long = vec![range(0, 0, 60_000), range(0, 60_000, 60_000)];
        assert_eq!(merged(long.clone()), long);
    }

    #[test]
    fn more_than_the_file_allows_is_refused_and_changes_nothing() {
        let mut all = Watching::default();
        let limits = limits(100);
        assert_eq!(all.watch(1, vec![range(0, 0, 92)], Nanos::ZERO, &limits), Ok(92));
        let refused = all.watch(2, vec![range(0, 200, 1)], Nanos::ZERO, &limits).unwrap_err();
        assert!(refused.contains("109 bytes of the program a"), "{refused}");
        assert_eq!(
            all.watch(2, vec![range(0, 4, 8), range(1, 0, 4)], Nanos::ZERO, &limits),
            Ok(12)
        );
        assert_eq!(all.layout, [range(0, 0, 92), range(1, 0, 4)]);
        let refused = all.watch(2, vec![range(0, 99_999, 2)], Nanos::ZERO, &limits);
        assert!(refused.unwrap_err().contains("100000 bytes"));
        assert!(all.watch(2, vec![range(2, 0, 1)], Nanos::ZERO, &limits).is_err());
        all.keep(|client| client == 2);
        assert_eq!(all.layout, [range(0, 4, 8), range(1, 0, 4)]);
    }

    #[test]
    fn a_client_that_names_the_same_bytes_again_and_again_gets_no_more_than_a_sample() {
        let mut all = Watching::default();
        let limits = limits(2000);
        let same = |count| vec![range(0, 0, 1024); count];
        assert_eq!(all.watch(1, same(60), Nanos::ZERO, &limits), Ok(SAMPLE_BYTES as u64));
        let refused = all.watch(1, same(61), Nanos::ZERO, &limits).unwrap_err();
        assert!(refused.contains("62464 bytes together"), "{refused}");
        assert_eq!(all.subscriptions[0].ranges.len(), 60, "the watch before goes on");
    }

    #[test]
    fn who_watches_a_program_that_changes_watches_no_longer() {
        let mut all = Watching::default();
        all.watch(1, vec![range(0, 0, 4), range(1, 0, 4)], Nanos::ZERO, &limits(100)).unwrap();
        all.watch(2, vec![range(1, 8, 4)], Nanos::ZERO, &limits(100)).unwrap();
        (all.serial, all.unsent) = (5, None);
        assert_eq!(all.leave(0), [1]);
        assert_eq!((&all.layout[..], all.unsent), (&[range(1, 8, 4)][..], Some(0)));
        assert!(taken(&mut all, head(5, 0, true), &[0; 12], 0).is_empty(), "the list before");
        assert!(all.leave(0).is_empty());
    }

    fn head(serial: u32, part: u16, last: bool) -> SampleHead {
        SampleHead { serial, part, last, ..SampleHead::default() }
    }

    fn taken(all: &mut Watching, head: SampleHead, payload: &[u8], ms: u64) -> Vec<(u64, Vec<u8>)> {
        let mut told = Vec::new();
        let head = SampleHead { time_ns: ms * 1_000_000, ..head };
        all.take(&head, payload, |sampled| told.push((sampled.client, sampled.bytes)));
        told
    }

    #[test]
    fn a_sample_is_cut_up_for_each_client_and_no_part_of_one_is_told() {
        let mut all = Watching::default();
        all.watch(1, vec![range(0, 2, 2), range(0, 0, 2)], Nanos::ZERO, &limits(100)).unwrap();
        all.watch(2, vec![range(0, 1, 1)], Nanos::from_millis(100), &limits(100)).unwrap();
        (all.serial, all.unsent) = (5, None);
        assert!(taken(&mut all, head(4, 0, true), &[1, 2, 3, 4], 0).is_empty(), "another list");
        assert!(taken(&mut all, head(5, 1, true), &[1, 2, 3, 4], 0).is_empty(), "no first part");
        assert!(taken(&mut all, head(5, 0, true), &[1, 2, 3], 0).is_empty(), "too short");
        assert!(taken(&mut all, head(5, 0, true), &[1, 2, 3, 4, 5], 0).is_empty(), "too long");
        assert!(taken(&mut all, head(5, 0, false), &[1, 2], 0).is_empty());
        let told = taken(&mut all, head(5, 1, true), &[3, 4], 0);
        assert_eq!(told, [(1, vec![3, 4, 1, 2]), (2, vec![2])]);
        let told = taken(&mut all, head(5, 0, true), &[5, 6, 7, 8], 99);
        assert_eq!(told, [(1, vec![7, 8, 5, 6])], "the other one is not due");
    }

    #[test]
    fn a_client_misses_no_sample_of_a_kernel_that_keeps_to_its_interval() {
        let mut all = Watching::default();
        all.watch(1, vec![range(0, 0, 1)], Nanos::from_millis(100), &limits(100)).unwrap();
        (all.serial, all.unsent) = (5, None);
        let mut at = |ms| taken(&mut all, head(5, 0, true), &[7], ms).len();
        assert_eq!([20, 120, 221, 321].map(&mut at), [1; 4]);
        // From a kernel that sends one each ms for another client it has one each 100 ms.
        assert_eq!((322..1322).map(&mut at).sum::<usize>(), 10);
        // The kernel starts anew.
        assert_eq!([1, 2, 100, 101].map(at), [1, 0, 0, 1]);
    }
}
