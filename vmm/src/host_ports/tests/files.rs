//! Recordings, and files that are sent from.

use super::*;

fn records(path: &Path) -> Vec<(Header, Vec<u8>)> {
    let bytes = fs::read(path).unwrap();
    let mut rest = &bytes[..];
    let mut all = Vec::new();
    while !rest.is_empty() {
        let length = Header::from_bytes(rest.first_chunk().unwrap()).length as usize;
        let (record, behind) = rest.split_at(HEADER + length);
        all.push(parse(record));
        rest = behind;
    }
    all
}

#[test]
fn a_file_gets_each_message_once_and_the_last_ones_at_the_end() {
    let kind = queuing(1_000, WhenFull::Refuse);
    let mut bench = Bench::new(kind, MAXIMUM, HostPort::File, false);
    let mut ports = bench.open();
    let mut guest = bench.queuing_source();
    for n in 0..1_000 {
        guest.send(&number(n), bench.stamp()).unwrap();
    }
    bench.tick(&mut ports);
    assert_eq!(records(&bench.path()).len(), 64);
    ports.finish(&bench.clock, &|| Tsc(EPOCH.0 + 50));
    let all = records(&bench.path());
    let messages: Vec<[u8; 4]> =
        all.iter().map(|(_, message)| message[..].try_into().unwrap()).collect();
    assert_eq!(messages, (0..1_000).map(number).collect::<Vec<_>>());
    let last = Header { taken_ns: 50_000, age_ns: 50_000, flags: 0, length: 4 };
    assert_eq!(all[999].0, last);
    let mode = fs::metadata(bench.path()).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o600);

    // A second run appends.
    drop(ports);
    let mut ports = bench.open();
    bench.queuing_source().send(b"more", bench.stamp()).unwrap();
    bench.tick(&mut ports);
    assert_eq!(records(&bench.path()).len(), 1_001);
}

#[test]
fn at_the_end_what_cannot_be_believed_is_skipped_and_the_rest_is_written() {
    let kind = queuing(10, WhenFull::Refuse);
    let bench = Bench::new(kind, MAXIMUM, HostPort::File, false);
    let mut ports = bench.open();
    let mut guest = bench.queuing_source();
    for n in 0..10 {
        guest.send(&number(n), bench.stamp()).unwrap();
    }
    // The sequences of the first two messages; a slot is 128 bytes long.
    let mut own = bench.own();
    [0, 1].into_iter().for_each(|n| own.store((offset::SLOT + 128 * n) / 8, 0));
    ports.finish(&bench.clock, &|| EPOCH);
    let all: Vec<_> = records(&bench.path()).into_iter().map(|(_, message)| message).collect();
    assert_eq!(all, (2..10).map(|n| number(n).to_vec()).collect::<Vec<_>>());
    assert_eq!((account(&mut ports).hostile, ports.take_news().len()), (2, 0));
}

#[test]
fn a_file_gets_a_sample_when_it_is_new() {
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::File, false);
    let mut ports = bench.open();
    let mut guest = bench.sampling_source();
    for text in [&b"a"[..], b"bb"] {
        guest.write(text, bench.stamp()).unwrap();
        bench.tick(&mut ports);
        bench.tick(&mut ports);
    }
    let all: Vec<_> = records(&bench.path()).into_iter().map(|(_, message)| message).collect();
    assert_eq!(all, [&b"a"[..], b"bb"]);
    assert_eq!(account(&mut ports).messages, 2);
}

#[test]
fn only_a_regular_file_is_appended_to() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::File, false);
    for target in ["/dev/full", "/dev/null", "/"] {
        symlink(target, bench.path()).unwrap();
        let opened = HostPorts::open(bench.channels, bench.clock.frequency, None, &spawn);
        let error = opened.err().unwrap();
        assert!(error.to_string().starts_with("channel levels: cannot open /"), "{error}");
        fs::remove_file(bench.path()).unwrap();
    }
}

#[test]
fn a_recording_can_be_sent_again_and_waits_for_room_even_where_a_queue_overwrites() {
    for when_full in [WhenFull::Refuse, WhenFull::Overwrite] {
        let mut bench = Bench::new(queuing(3, when_full), MAXIMUM, HostPort::File, true);
        let record = |n| {
            let header = Header { length: 4, ..Header::default() };
            [&header.to_bytes()[..], &number(n)].concat()
        };
        fs::write(bench.path(), (0..10).flat_map(record).collect::<Vec<u8>>()).unwrap();
        let mut ports = bench.open();
        bench.tick(&mut ports);
        let mut guest = bench.queuing_destination();
        let mut all = Vec::new();
        while !is_over(&ports) {
            let before = all.len();
            bench.tick(&mut ports);
            all.extend(received(&mut guest));
            assert!(all.len() - before <= 3, "a message was overwritten");
        }
        assert_eq!(all, (0..10).collect::<Vec<_>>());
        assert_eq!(account(&mut ports).messages, 10);
        assert!(ports.take_news().is_empty());
    }
}

#[test]
fn a_sampling_file_is_sent_a_record_a_tick() {
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::File, true);
    let record = |n| {
        let header = Header { length: 4, ..Header::default() };
        [&header.to_bytes()[..], &number(n)].concat()
    };
    fs::write(bench.path(), (0..3).flat_map(record).collect::<Vec<u8>>()).unwrap();
    let mut ports = bench.open();
    let region = Peer::map(&bench.regions().source).unwrap();
    let geometry = &bench.regions().geometry;
    let mut guest = SamplingDestination::open(region, geometry, Ticks(100)).unwrap();
    let mut buffer = [0; MAXIMUM as usize];
    let mut seen = Vec::new();
    while !is_over(&ports) {
        let before = account(&mut ports).messages;
        bench.tick(&mut ports);
        let sent = account(&mut ports).messages - before;
        assert!(sent <= 1);
        if sent == 1 {
            seen.push(guest.read(&mut buffer, bench.stamp()).unwrap().bytes.to_vec());
        }
    }
    assert_eq!(seen, [0, 1, 2].map(|n| number(n).to_vec()));
    assert_eq!(guest.read(&mut buffer, bench.stamp()).unwrap().bytes, number(2));
}

#[test]
fn a_file_of_nonsense_is_told_of_once() {
    let mut bench = Bench::new(queuing(3, WhenFull::Refuse), MAXIMUM, HostPort::File, true);
    fs::write(bench.path(), [0xff; 100]).unwrap();
    let mut ports = bench.open();
    let _guest = bench.queuing_destination();
    while !is_over(&ports) {
        bench.tick(&mut ports);
    }
    bench.tick(&mut ports);
    let expected = "channel levels: record 1 says that its message has 4294967295 bytes; \
                    allowed are 1 to 64";
    assert_eq!(ports.take_news(), [expected]);
    assert_eq!(account(&mut ports).messages, 0);
}

#[test]
fn in_the_appliance_a_recording_goes_to_the_results_and_there_are_no_sockets() {
    let results = TempDir::new().unwrap();
    let open = |bench: &Bench| {
        let frequency = bench.clock.frequency;
        HostPorts::open(bench.channels, frequency, Some(results.as_path()), &spawn)
            .unwrap()
            .unwrap()
    };
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::File, false);
    let mut ports = open(&bench);
    bench.sampling_source().write(b"a", bench.stamp()).unwrap();
    bench.tick(&mut ports);
    assert_eq!(records(&results.as_path().join("levels.records")).len(), 1);
    assert!(!bench.path().exists());

    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let mut ports = open(&bench);
    assert!(!bench.path().exists());
    assert!(ports.take_news()[0].contains("no socket in the appliance"));
    assert!(ports.accounts().is_empty());
}

#[test]
fn without_an_end_on_the_host_there_is_nothing_to_serve() {
    let channels = Channels::new(&[]).unwrap();
    let frequency = TscFrequency::from_khz(KHZ).unwrap();
    assert!(HostPorts::open(&channels, frequency, None, &spawn).unwrap().is_none());
}
