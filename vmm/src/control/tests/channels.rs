//! Channels as an operator sees them, through mappings as Takt has them.

use takt_channel::{QueuingDestination, QueuingSource, SamplingSource, offset};
use takt_channel::{Store, Tsc as Stamp};
use takt_scheduler::time::{Tsc, TscFrequency};

use super::super::channels::Views;
use super::super::protocol::{ChannelStatus, Contents};
use super::Folder;
use crate::channels::{Channels, Regions};
use crate::config::{self, PartitionFile};
use crate::host_ports::pages::{Own, Peer};

const FILE: &str = r#"
version = 1
[system]
name = "s"
major_frame = "1ms"
[[partition]]
name = "one"
kind = "plc"
cpu = 0
memory = "4MiB"
[[partition]]
name = "two"
kind = "plc"
cpu = 0
memory = "4MiB"
[[schedule]]
name = "normal"
[[schedule.window]]
partition = "one"
offset = "0us"
duration = "100us"
[[schedule.window]]
partition = "two"
offset = "500us"
duration = "100us"
[[channel]]
name = "level"
kind = "sampling"
message_bytes = 8
refresh_period = "5ms"
source = "one:level"
destinations = ["two:level", "host:level"]
host_file = "level"
[[channel]]
name = "orders"
kind = "queuing"
message_bytes = 8
depth = 2
when_full = "overwrite"
source = "two:orders"
destinations = ["one:orders"]
"#;

/// A tick is a microsecond, and this is now.
const NOW: Tsc = Tsc(1_000_000);

fn at(ms_ago: u64) -> Stamp {
    Stamp(NOW.0 - 1_000 * ms_ago)
}

fn look(views: &Views) -> [ChannelStatus; 2] {
    let frequency = TscFrequency::from_khz(1_000).unwrap();
    let lost = |name: &str| Some(if name == "level" { 7 } else { panic!("{name}") });
    views.look(|| NOW, frequency, lost).try_into().unwrap()
}

/// The file, for as long as the test lasts.
fn file(folder: &Folder) -> &'static PartitionFile {
    let path = folder.0.join("plant.toml");
    std::fs::write(&path, FILE).unwrap();
    Box::leak(Box::new(config::load(&path, None).unwrap()))
}

fn source(regions: &Regions<'_>) -> Own {
    let mut own = Own::map(&regions.source).unwrap();
    regions.geometry.format_source(&mut own).unwrap();
    own
}

fn acknowledgement(regions: &Regions<'_>) -> Own {
    let mut own = Own::map(regions.destination.as_ref().unwrap()).unwrap();
    regions.geometry.format_destination(&mut own).unwrap();
    own
}

#[test]
fn a_sample_has_an_age_which_makes_it_valid() {
    let folder = Folder::new();
    let file = file(&folder);
    let channels = Channels::new(file.channels()).unwrap();
    let views = Views::new(file, &channels).unwrap();
    let regions = channels.all().next().unwrap();
    let contents = |written, age_ns, valid| {
        let contents =
            Contents { written, waiting: None, overwritten: None, age_ns, valid: Some(valid) };
        ChannelStatus {
            name: "level".into(),
            kind: "sampling".into(),
            source: "one:level".into(),
            destinations: vec!["two:level".into(), "host:level".into()],
            depth: None,
            refresh_ns: Some(5_000_000),
            contents: Some(contents),
            lost: Some(7),
            problem: None,
        }
    };
    assert_eq!(look(&views)[0], contents(0, None, false));
    let mut port = SamplingSource::open(source(regions), &regions.geometry).unwrap();
    port.write(b"x", at(5)).unwrap();
    assert_eq!(look(&views)[0], contents(1, Some(5_000_000), true));
    port.write(b"x", at(6)).unwrap();
    assert_eq!(look(&views)[0], contents(2, Some(6_000_000), false));
    port.write(b"x", Stamp(NOW.0 + 5_000)).unwrap();
    assert_eq!(look(&views)[0], contents(3, Some(0), true));
    port.write(b"x", Stamp(NOW.0 + 5_001)).unwrap();
    let status = &look(&views)[0];
    assert_eq!(status.contents, None);
    assert!(status.problem.as_ref().unwrap().contains("in the future"), "{status:?}");
}

#[test]
fn a_queue_fills_and_what_its_guests_claim_is_not_believed() {
    let folder = Folder::new();
    let file = file(&folder);
    let channels = Channels::new(file.channels()).unwrap();
    let views = Views::new(file, &channels).unwrap();
    let regions = channels.all().nth(1).unwrap();
    let peer = Peer::map(&regions.source).unwrap();
    let (own, acknowledged) = (source(regions), acknowledgement(regions));
    let mut destination = QueuingDestination::open(peer, acknowledged, &regions.geometry).unwrap();
    let peer = Peer::map(regions.destination.as_ref().unwrap()).unwrap();
    let mut port = QueuingSource::open(own, peer, &regions.geometry).unwrap();
    let sees = || {
        let status = look(&views)[1].clone();
        assert_eq!((status.lost, status.depth, status.refresh_ns), (None, Some(2), None));
        status.contents.map(|c| (c.written, c.waiting, c.overwritten, c.age_ns, c.valid))
    };
    assert_eq!(sees(), Some((0, Some(0), Some(0), None, None)));
    (1..=5).for_each(|n| port.send(b"x", at(n)).unwrap());
    assert_eq!(sees(), Some((5, Some(2), Some(3), Some(5_000_000), None)));
    destination.receive(&mut [0; 8]).unwrap();
    assert_eq!(sees(), Some((5, Some(1), Some(0), Some(5_000_000), None)));
    source(regions).store(offset::WRITTEN / 8, u64::MAX);
    assert_eq!(sees(), None);
    let problem = look(&views)[1].problem.clone().unwrap();
    assert!(problem.contains("impossible claim"), "{problem}");
}
