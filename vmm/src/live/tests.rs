//! Takt's ends against a guest that behaves, and one that writes anything into its pages.

use takt_abi::live::{
    ANSWERS, Answer, Area, MESSAGE_BYTES, ORDERS, ORDERS_DEPTH, Order, ProgramRecord, ProgramState,
    Range, decode_order,
};
use takt_abi::program::PROGRAMS_MAX;
use takt_channel::{Load, Policy, QueuingDestination, QueuingSource, Store, Tsc};
use takt_plan::Admission;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::Nanos;

use super::limits::ProgramLimits;
use super::watching::Watching;
use super::{Link, NotSent, ProgramChanges, Running, Turn};
use crate::channels::Channels;
use crate::config::{Channel, ChannelKind, End, Owner, WhenFull};
use crate::host_ports::pages::{Own, Peer};

/// The regions of a partition's queues, and Takt's ends.
pub(super) struct Case {
    pub(super) running: Running,
    channels: Channels<'static>,
}

impl Case {
    pub(super) fn new() -> Self {
        let guest = Owner::Partition(PartitionId(0));
        let channel = |name: &str, depth, from, to| Channel {
            name: name.to_owned(),
            kind: ChannelKind::Queuing { depth, when_full: WhenFull::Refuse },
            message_bytes: MESSAGE_BYTES as u32,
            source: End { owner: from, port: name.to_owned() },
            destinations: vec![End { owner: to, port: name.to_owned() }],
            doorbell: None,
            host: None,
        };
        let all = [
            channel(ORDERS, ORDERS_DEPTH, Owner::Host, guest),
            channel(ANSWERS, 64, guest, Owner::Host),
        ];
        let channels = Channels::new(&[]).unwrap().with_live(Box::leak(Box::new(all))).unwrap();
        let [orders, answers] = channels.live() else { panic!("two queues") };
        let mut region = Own::map(orders.destination.as_ref().unwrap()).unwrap();
        orders.geometry.format_destination(&mut region).unwrap();
        let mut region = Own::map(&answers.source).unwrap();
        answers.geometry.format_source(&mut region).unwrap();
        let link = Link::open(orders, answers).unwrap();
        Self {
            running: Running::new(link, Vec::new(), ProgramChanges::of(&[], Admission::default())),
            channels,
        }
    }

    fn tick(&mut self, now: Nanos) -> Turn {
        let mut turn = Turn::default();
        self.running.on_tick(now, 0, None, &mut turn, &mut Vec::new());
        turn
    }

    /// The ends of a guest that behaves.
    pub(super) fn guest(&self) -> (QueuingDestination<Peer, Own>, QueuingSource<Own, Peer>) {
        let [orders, answers] = self.channels.live() else { panic!("two queues") };
        let own = Own::map(orders.destination.as_ref().unwrap()).unwrap();
        let peer = Peer::map(&orders.source).unwrap();
        let destination = QueuingDestination::open(peer, own, &orders.geometry).unwrap();
        let peer = Peer::map(answers.destination.as_ref().unwrap()).unwrap();
        let own = Own::map(&answers.source).unwrap();
        assert_eq!(answers.geometry.source_bytes() % 8, 0);
        (destination, QueuingSource::open(own, peer, &answers.geometry).unwrap())
    }
}

fn at(ms: u64) -> Nanos {
    Nanos::from_millis(ms)
}

#[test]
fn nothing_is_sent_to_a_guest_that_is_not_there_and_no_more_than_it_takes() {
    let mut case = Case::new();
    let order = Order::Status { part: 0 };
    assert_eq!(case.running.link.send(&order), Err(NotSent::NoGuest));
    let (mut orders, _answers) = case.guest();
    // One that has just started is noticed first.
    assert_eq!(case.running.link.send(&order), Err(NotSent::NoGuest));
    assert!(case.running.link.has_restarted());
    for number in 1..=ORDERS_DEPTH {
        assert_eq!(case.running.link.send(&order), Ok(number));
    }
    assert_eq!(case.running.link.send(&order), Err(NotSent::Full));
    let mut buffer = [0; MESSAGE_BYTES];
    let message = orders.receive(&mut buffer).unwrap();
    assert_eq!(decode_order(message.bytes), Ok((1, order)));
    assert_eq!(case.running.link.send(&order), Ok(ORDERS_DEPTH + 1));
}

#[test]
fn a_list_that_finds_no_room_goes_on_where_it_has_stopped() {
    let mut case = Case::new();
    let (mut orders, _answers) = case.guest();
    let link = &mut case.running.link;
    assert!(link.has_restarted());
    let areas = [100_000, 0, 0, 0];
    let limits = [ProgramLimits { name: "a".into(), watch: 60_000, force: true, areas }];
    let piece = |number: u32| Range { program: 0, area: Area::State, offset: 8 * number, bytes: 4 };
    let pieces: Vec<Range> = (0..1000).map(piece).collect();
    let mut watching = Watching::default();
    watching.watch(1, pieces.clone(), at(0), &limits).unwrap();
    let (mut buffer, mut kinds, mut told) = ([0; MESSAGE_BYTES], Vec::new(), Vec::new());
    for _ in 0..6 {
        // Others fill the queue, and the kernel takes some of it only.
        while link.send(&Order::Status { part: 0 }).is_ok() {}
        watching.send(link);
        for _ in 0..4 {
            let message = orders.receive(&mut buffer).unwrap();
            assert_eq!(decode_order(message.bytes).unwrap().1, Order::Status { part: 0 });
        }
        watching.send(link);
        for _ in 4..ORDERS_DEPTH {
            orders.receive(&mut buffer).unwrap();
        }
        while let Ok(message) = orders.receive(&mut buffer) {
            match decode_order(message.bytes).unwrap().1 {
                Order::WatchAdd(ranges) => told.extend(ranges.iter()),
                order => kinds.push(order),
            }
        }
    }
    assert_eq!(told, pieces);
    assert!(matches!(kinds[..], [Order::WatchClear, Order::WatchBegin { .. }]), "{kinds:?}");
}

#[test]
fn what_a_kernel_answers_is_known_until_it_starts_anew() {
    let mut case = Case::new();
    let (mut orders, mut answers) = case.guest();
    case.tick(at(0));
    let mut buffer = [0; MESSAGE_BYTES];
    let message = orders.receive(&mut buffer).unwrap();
    assert_eq!(decode_order(message.bytes), Ok((1, Order::Status { part: 0 })));
    let program = ProgramRecord { state: ProgramState::Running, hash: [3; 32] };
    let programs = [program; PROGRAMS_MAX];
    let answer = Answer::Programs { programs, count: 1, tasks: 9, forced: 0, dropped: 0 };
    answers.send(answer.encode(1, &mut buffer).unwrap(), Tsc(1)).unwrap();
    case.tick(at(20));
    assert_eq!(case.running.figures.programs, [program]);
    // The next time it is asked for both parts of its tasks.
    case.tick(at(1000));
    let parts: Vec<u16> = std::iter::from_fn(|| {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = orders.receive(&mut buffer).ok()?;
        let Ok((_, Order::Status { part })) = decode_order(message.bytes) else { return None };
        Some(part)
    })
    .collect();
    assert_eq!(parts, [0, 1, 2]);
    let _new = case.guest();
    case.tick(at(1020));
    assert!(case.running.figures.programs.is_empty());
}

#[test]
fn a_guest_that_writes_anything_into_its_pages_costs_a_number() {
    let mut case = Case::new();
    let (_orders, mut answers) = case.guest();
    for message in [&[0; 1][..], &[0xff; MESSAGE_BYTES], &[2, 0, 0, 0, 1, 0, 0, 0, 255]] {
        answers.send(message, Tsc(0)).unwrap();
    }
    case.tick(at(0));
    assert_eq!(case.running.link.hostile(), 3);
    let [orders, answers] = case.channels.live() else { panic!("two queues") };
    let mut pages = [
        Own::map(&answers.source).unwrap(),
        Own::map(orders.destination.as_ref().unwrap()).unwrap(),
    ];
    let mut state = 0x1234_5678_9abc_def1_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    for turn in 0..20_000 {
        for page in &mut pages {
            let words = page.words() as u64;
            // More often where the counters lie.
            let word = random() % if turn % 2 == 0 { 40 } else { words };
            let value = if turn % 3 == 0 { random() % 64 } else { random() };
            page.store(word as usize, value);
        }
        case.tick(at(turn));
        assert!(case.running.figures.tasks.len() <= 255);
        assert!(case.running.figures.programs.len() <= PROGRAMS_MAX);
    }
    assert_eq!(WhenFull::Refuse.policy(), Policy::Refuse);
}
