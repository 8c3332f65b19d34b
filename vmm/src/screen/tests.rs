//! The screen beside floods, and before readers that stop.

use std::io;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};

use super::*;
use crate::outlet::Sink;

const PLC: PartitionId = PartitionId(0);
const OTHER: PartitionId = PartitionId(1);
const LONG: Duration = Duration::from_secs(60);

/// Keeps what is written, and waits for a word before each piece if it has been stopped.
struct Paper {
    seen: Arc<Mutex<Vec<u8>>>,
    stopped: Option<Receiver<()>>,
}

impl Sink for Paper {
    fn put(&mut self, piece: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
        if let Some(stopped) = &self.stopped {
            // It flows again once the other end is dropped.
            let _ = stopped.recv();
        }
        self.seen.lock().unwrap().extend_from_slice(piece);
        written(piece.len());
        Ok(())
    }

    fn goes_on(&self) -> bool {
        true
    }
}

struct Shown {
    screen: Screen,
    outlet: Arc<Outlet>,
    seen: Arc<Mutex<Vec<u8>>>,
}

impl Shown {
    fn new(raw: bool, stopped: Option<Receiver<()>>) -> Self {
        let seen: Arc<Mutex<Vec<u8>>> = Arc::default();
        let (outlet, work) = Outlet::new(&quotas(2), Paper { seen: seen.clone(), stopped });
        std::thread::spawn(work);
        let outlet = Arc::new(outlet);
        Self { screen: Screen::new(outlet.clone(), raw, 2), outlet, seen }
    }

    /// All that was shown, once it is.
    fn text(&self) -> String {
        assert!(self.outlet.settle(LONG, LONG));
        String::from_utf8(self.seen.lock().unwrap().clone()).unwrap()
    }
}

#[test]
fn a_line_never_starts_in_the_middle_of_another() {
    let mut shown = Shown::new(true, None);
    shown.screen.line("takt", "start");
    assert_eq!(shown.screen.raw(OTHER, b"linux# "), 0);
    assert_eq!(shown.screen.guest_line(PLC, "plc", "cycle 1"), 0);
    shown.screen.raw(OTHER, b"x\r\n");
    shown.screen.guest_line(PLC, "plc", "cycle 2");
    assert_eq!(shown.text(), "[takt] start\r\nlinux# \r\n[plc] cycle 1\r\nx\r\n[plc] cycle 2\r\n");
}

#[test]
fn a_flood_ends_at_its_budget_and_takes_nothing_of_the_others() {
    let mut shown = Shown::new(false, None);
    let mut now = shown.screen.now;
    let (mut flood, mut lost) = (0, 0);
    // Ten seconds of ticks. Each time the flood shows what it can, and the others one line each.
    for tick in 0..500 {
        for _ in 0..200 {
            let dropped = shown.screen.guest_line(PLC, "plc", "flood");
            assert!(matches!(dropped, 0 | 5), "a part of a line was shown: {dropped}");
            flood += u64::from(dropped == 0);
            lost += dropped;
        }
        assert_eq!(shown.screen.guest_line(OTHER, "other", &format!("tick {tick}")), 0);
        shown.screen.line("takt", "a line of its own");
        shown.screen.tell_losses(PLC, "plc", lost);
        assert!(shown.outlet.settle(LONG, LONG));
        now += Duration::from_millis(20);
        shown.screen.tick(now);
    }
    // A second's worth at once and ten seconds' worth after that, but for the last tick.
    assert!((10_900..=11_000).contains(&flood), "{flood}");
    let text = shown.text();
    assert_eq!(text.matches("[plc] flood\n").count() as u64, flood);
    assert_eq!(text.matches("[other] tick ").count(), 500);
    assert_eq!(text.matches("[takt] a line of its own\n").count(), 500);
    // What was lost was said once a second, and the sum is what was lost until the last time.
    let told: Vec<u64> = text
        .lines()
        .filter_map(|line| {
            line.strip_prefix("[takt] console: ")?.strip_suffix(" bytes of plc dropped")
        })
        .map(|bytes| bytes.parse().unwrap())
        .collect();
    assert!((9..=11).contains(&told.len()), "{told:?}");
    assert_eq!(told.iter().sum::<u64>(), shown.screen.told[0].bytes);
    shown.screen.tell_last_losses([("plc", lost), ("other", 0)].into_iter());
    assert_eq!(shown.screen.told[0].bytes, lost);
}

#[test]
fn bytes_are_bounded_like_lines() {
    let mut shown = Shown::new(false, None);
    let now = shown.screen.now;
    let mut raw = |bytes: usize| bytes as u64 - shown.screen.raw(OTHER, &vec![b'x'; bytes]);
    // Bounded by the lane first, since the reader is not waited for.
    let first = raw(1 << 20);
    assert!(first <= LANE as u64, "{first}");
    let mut all = first;
    loop {
        assert!(shown.outlet.settle(LONG, LONG));
        let more = 1000 - shown.screen.raw(OTHER, &[b'x'; 1000]);
        all += more;
        if more < 1000 {
            break;
        }
    }
    assert_eq!(all, 64 << 10);
    assert!(shown.outlet.settle(LONG, LONG));
    shown.screen.tick(now + Duration::from_millis(500));
    assert_eq!(shown.screen.allowance(OTHER).bytes, (32 << 10) - 64);
    assert_eq!(shown.screen.raw(OTHER, &[b'x'; 1000]), 0);
}

#[test]
fn takts_own_lines_have_room_beside_guests_that_are_not_read() {
    let (go, stopped) = channel();
    let mut shown = Shown::new(false, Some(stopped));
    let mut lost = [0; 2];
    for _ in 0..10_000 {
        lost[0] += shown.screen.guest_line(PLC, "plc", "flood");
        lost[1] += shown.screen.raw(OTHER, b"flood\n");
    }
    assert!(lost.iter().all(|lost| *lost > 0));
    for n in 0..100 {
        shown.screen.line("takt", &format!("line {n}"));
    }
    assert_eq!(shown.screen.own_dropped(), 0);
    // Nothing is said of losses while there is no room.
    shown.screen.tell_losses(PLC, "plc", lost[0]);
    assert_eq!(shown.screen.told[0].bytes, 0);
    drop(go);
    let text = shown.text();
    assert_eq!(text.matches("[takt] line ").count(), 100);
    assert!(!text.contains("dropped"));
    // It flows again.
    shown.screen.tell_losses(PLC, "plc", lost[0]);
    assert!(shown.text().ends_with(&format!("[takt] console: {} bytes of plc dropped\n", lost[0])));
    // Every byte of the guests' was shown or counted.
    let text = shown.text();
    assert_eq!(text.matches("[plc] flood\n").count() * 5 + lost[0] as usize, 50_000);
    let whole = text.lines().filter(|line| *line == "flood").count();
    assert_eq!(whole * 6 + lost[1] as usize, 60_000);
}

#[test]
fn takts_own_lines_are_bounded_and_counted_too() {
    let (_go, stopped) = channel();
    let mut shown = Shown::new(false, Some(stopped));
    for _ in 0..10_000 {
        shown.screen.line("takt", "twelve bytes");
    }
    let kept = 10_000 - shown.screen.own_dropped() / b"[takt] twelve bytes\n".len() as u64;
    assert!((150..=200).contains(&kept), "{kept}");
}

#[test]
fn a_guest_that_can_wait_is_held_up_only_while_somebody_reads() {
    let (_go, stopped) = channel();
    let mut shown = Shown::new(false, Some(stopped));
    let now = shown.screen.now;
    while shown.screen.allowance(OTHER).bytes > 0 {
        let allowed = shown.screen.allowance(OTHER).bytes;
        assert_eq!(shown.screen.raw(OTHER, &vec![b'x'; allowed]), 0);
    }
    shown.screen.tick(now + PATIENCE);
    assert_eq!(shown.screen.allowance(OTHER).bytes, 0);
    shown.screen.tick(now + PATIENCE + Duration::from_millis(1));
    assert_eq!(shown.screen.allowance(OTHER), Allowance::ALL);
    assert_eq!(shown.screen.raw(OTHER, b"lost"), 4);
}
