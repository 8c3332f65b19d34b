//! What a good partition file says of its channels, how `takt check` shows it, and that each bound
//! of a channel is inside what is allowed. The defects are in `partition_files.rs`.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use takt_abi::PORTS_MAX;
use takt_plan as config;
use takt_plan::check;
use takt_plan::{CHANNELS_MAX, Channel, ChannelKind, HostPort, Owner, PartitionFile, WhenFull};
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::Nanos;

fn good() -> PartitionFile {
    let path = Path::new("tests/partition_files/good/channels.toml");
    config::load(path, Some(2)).unwrap_or_else(|error| panic!("{error}"))
}

/// The part of the report that is about channels.
fn listed(file: &PartitionFile) -> String {
    let report = check::report(file);
    report.split_once("\nchannels\n").map_or(String::new(), |(_, rest)| rest.to_owned())
}

/// The partitions at the ends of a channel, and the ports; of the host, 99.
fn ends(channel: &Channel) -> Vec<(usize, &str)> {
    let ends = std::iter::once(&channel.source).chain(&channel.destinations);
    let number = |owner| match owner {
        Owner::Partition(id) => id.0,
        Owner::Host => 99,
    };
    ends.map(|end| (number(end.owner), &*end.port)).collect()
}

#[test]
fn a_good_file_says_what_its_channels_are() {
    let file = good();
    let [setpoints, orders, alarms, state] = file.channels() else { panic!("{file:?}") };
    assert_eq!((&*setpoints.name, setpoints.message_bytes), ("setpoints", 512));
    assert_eq!(setpoints.kind, ChannelKind::Sampling { refresh: Nanos::from_millis(10) });
    assert_eq!(ends(setpoints), [(0, "setpoints"), (1, "setpoints"), (2, "setpoints")]);
    let overwrite = ChannelKind::Queuing { depth: 8, when_full: WhenFull::Overwrite };
    assert_eq!((orders.kind, ends(orders)), (overwrite, vec![(0, "orders"), (1, "orders")]));
    // Without the key, nothing is lost.
    let refuse = ChannelKind::Queuing { depth: 4, when_full: WhenFull::Refuse };
    assert_eq!((alarms.kind, ends(alarms)), (refuse, vec![(1, "alarms"), (0, "alarms")]));
    assert_eq!(ends(state), [(2, "state"), (1, "climate-state")]);
}

#[test]
fn the_report_ends_with_the_channels() {
    let expected = "  setpoints: sampling, up to 512 bytes, refresh 10ms
    cell:setpoints
      -> axis:setpoints
      -> climate:setpoints
  orders: queuing, up to 64 bytes, depth 8, overwrite when full
    cell:orders
      -> axis:orders
  alarms: queuing, up to 65536 bytes, depth 4, refuse when full
    axis:alarms
      -> cell:alarms
  state: sampling, up to 1 bytes, refresh 60s
    climate:state
      -> axis:climate-state
";
    assert_eq!(listed(&good()), expected);
}

#[test]
fn a_linux_may_be_at_either_end_and_a_doorbell_is_reported() {
    let path = Path::new("tests/partition_files/good/linux-channels.toml");
    let file = config::load(path, Some(2)).unwrap_or_else(|error| panic!("{error}"));
    let [setpoints, orders] = file.channels() else { panic!("{file:?}") };
    assert_eq!(ends(setpoints), [(0, "setpoints"), (1, "setpoints"), (2, "setpoints")]);
    assert_eq!(ends(orders), [(2, "orders"), (0, "orders")]);
    let linux = file.partitions().iter().find(|p| p.name() == "linux").unwrap();
    assert_eq!((setpoints.doorbell, orders.doorbell), (Some(linux.id()), None));
    let text = listed(&file);
    assert!(text.contains("\n    cell:setpoints, with a doorbell\n"), "{text}");
    assert!(text.contains("\n    linux:orders\n"), "{text}");
}

#[test]
fn ends_on_the_host_say_where_they_lead() {
    let path = Path::new("tests/partition_files/good/host-ports.toml");
    let file = config::load(path, Some(2)).unwrap_or_else(|error| panic!("{error}"));
    let folder = Path::new("tests/partition_files/good").canonicalize().unwrap();
    let [setpoints, state, orders, alarms] = file.channels() else { panic!("{file:?}") };
    assert_eq!(ends(setpoints), [(0, "setpoints"), (1, "setpoints"), (99, "setpoints")]);
    assert_eq!(setpoints.host, Some(HostPort::Socket(folder.join("setpoints.sock"))));
    assert_eq!(state.host, Some(HostPort::File(folder.join("state.records"))));
    assert_eq!(ends(orders), [(99, "orders"), (1, "orders")]);
    assert_eq!(alarms.host, Some(HostPort::Socket("/run/takt/alarms.sock".into())));

    let shown = format!("      -> host:state\n    host file {}/state.records\n", folder.display());
    assert!(listed(&file).contains(&shown), "{}", listed(&file));
    assert!(listed(&file).contains("    host:alarms\n      -> cell:alarms\n    host socket /run/"));
    let needs = check::needs(&file);
    let (_, files) = needs.split_once(".toml\n").unwrap();
    let (state, image) = (folder.join("state.records"), folder.with_file_name("dummy-image"));
    let expected = format!("record state {}\nfile {}\n", state.display(), image.display());
    assert_eq!(files, expected);
}

#[test]
fn the_documentation_shows_two_of_these_channels_as_they_are_written_and_reported() {
    let page = fs::read_to_string("../../docs/partition-file.md").unwrap();
    let written = fs::read_to_string("tests/partition_files/good/channels.toml").unwrap();
    let tables = written.split("\n\n").filter(|table| table.starts_with("[[channel]]"));
    let tables: Vec<&str> = tables.take(2).collect();
    assert!(page.contains(&format!("```toml\n{}\n```", tables.join("\n\n"))), "{tables:?}");
    let report = listed(&good());
    let (shown, _) = report.split_once("  alarms").unwrap();
    assert!(page.contains(&format!("```text\nchannels\n{shown}```")), "{shown}");
}

#[test]
fn the_report_says_nothing_of_channels_where_there_are_none() {
    let path = Path::new("tests/partition_files/good/plc-alone.toml");
    let file = config::load(path, Some(2)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(file.channels(), []);
    assert!(!check::report(&file).contains("channel"));
}

/// A file with as much of everything as there may be: the channels, the ports of its first
/// partition and the 500 pages that they take, the depth, and the length of every name.
fn full() -> String {
    let partition = |i: usize| format!("{}-{i:03}", "p".repeat(28));
    let mut text = "version = 1\n[system]\nname = \"full\"\nmajor_frame = \"8ms\"\n".to_owned();
    for i in 0..8 {
        let _ = write!(
            text,
            "[[partition]]\nname = \"{}\"\nkind = \"plc\"\ncpu = 0\nmemory = \"4MiB\"\n",
            partition(i)
        );
    }
    for i in 0..CHANNELS_MAX {
        let end = |partition: String| format!("\"{partition}:{}-{i:03}\"", "e".repeat(28));
        let (from, to) = if i < PORTS_MAX { (0, 1 + i % 7) } else { (1 + i % 7, 1 + (i + 1) % 7) };
        // 451 pages in the first channel, 2 in each of the next 8, 1 in the other 33.
        let shape = match i {
            0 => {
                "kind = \"queuing\"\nmessage_bytes = 1768\ndepth = 1024\nwhen_full = \"overwrite\""
            }
            1..=8 => "kind = \"sampling\"\nmessage_bytes = 937\nrefresh_period = \"59999999999ns\"",
            _ => "kind = \"sampling\"\nmessage_bytes = 1\nrefresh_period = \"1ns\"",
        };
        let _ = write!(
            text,
            "[[channel]]\nname = \"{}-{i:03}\"\n{shape}\nsource = {}\ndestinations = [{}]\n",
            "c".repeat(28),
            end(partition(from)),
            end(partition(to))
        );
    }
    text.push_str("[[schedule]]\nname = \"normal\"\n");
    for i in 0..8 {
        let _ = write!(
            text,
            "[[schedule.window]]\npartition = \"{}\"\noffset = \"{i}ms\"\nduration = \"500us\"\n",
            partition(i)
        );
    }
    text
}

/// Loads a file of this test's own.
fn load(name: &str, text: &str) -> Result<PartitionFile, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("channels");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    config::load(&path, None).map_err(|error| error.to_string())
}

#[test]
fn a_file_may_have_as_much_of_everything_as_is_allowed() {
    let file = load("full.toml", &full()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(file.channels().len(), 128);
    let first =
        file.channels().iter().filter(|c| c.source.owner == Owner::Partition(PartitionId(0)));
    assert_eq!(first.clone().count(), 42);
    let bytes: u64 = first.map(|c| config::region_bytes(c.kind, c.message_bytes)).sum();
    assert_eq!(bytes, config::CHANNEL_AREA_PAGES * 4096);
}

#[test]
fn one_page_more_than_the_area_has_is_refused() {
    let text = full().replacen("message_bytes = 1\n", "message_bytes = 937\n", 1);
    let error = load("too-full.toml", &text).unwrap_err();
    assert!(error.contains("need 501 pages of 4KiB"), "{error}");
}

#[test]
fn the_longest_names_and_numbers_fit_100_columns() {
    let file = load("wide.toml", &full()).unwrap_or_else(|error| panic!("{error}"));
    let text = listed(&file);
    assert_eq!(text.matches(" -> ").count(), 128);
    for line in text.lines() {
        // The longest message has a digit more than the one here.
        assert!(line.is_ascii() && line.len() < 100, "{line}");
    }
}
