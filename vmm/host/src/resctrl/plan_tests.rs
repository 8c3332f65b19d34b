//! Against records of hosts (`tests/hosts/resctrl-*.host`). Three were written by hand from the kernel's documentation
//! and from what owners of such processors have published: one of Intel's with eleven ways, of which devices share the
//! upper two, and sixteen groups for the cache but eight for bandwidth; the same with code and data apart; and one of
//! AMD's with sixteen ways in each of four caches. One more was recorded: Debian's kernel 6.1 on a processor of Bochs's that
//! only says that it divides.

use std::collections::BTreeMap;
use std::io;

use super::*;
use crate::resctrl::{BandwidthInfo, info};

const XEON: &str = include_str!("../../tests/hosts/resctrl-xeon.host");
const CDP: &str = include_str!("../../tests/hosts/resctrl-xeon-cdp.host");
const EPYC: &str = include_str!("../../tests/hosts/resctrl-epyc.host");
const EMULATED: &str = include_str!("../../tests/hosts/resctrl-emulated.host");

/// The files of a record below the file system's root.
fn recorded(record: &str) -> BTreeMap<String, String> {
    let parts = record.split("== ").filter_map(|part| part.split_once('\n'));
    let below = parts.filter_map(|(path, text)| {
        Some((path.strip_prefix("sys/fs/resctrl/")?.to_owned(), text.to_owned()))
    });
    below.collect()
}

fn host_of(vendor: &str, record: &str) -> (Info, Schemata) {
    let files = recorded(record);
    let read = |path: &str| files.get(path).cloned().ok_or(io::ErrorKind::NotFound.into());
    (info(vendor, read).unwrap(), Schemata::new(&files["schemata"]))
}

fn host() -> (Info, Schemata) {
    host_of("GenuineIntel", XEON)
}

fn asked(partition: &str, cpu: usize, ways: Option<u32>, percent: Option<u32>) -> Asked {
    let domain = Some(u32::from(cpu >= 8));
    Asked { partition: partition.into(), cpu: Cpu(cpu), domain, ways, percent }
}

fn of(asked: &[Asked]) -> Result<Plan, ResctrlError> {
    let (info, default) = host();
    plan(asked, info, &default, &[])
}

/// The error, and its remedy.
fn refused(asked: &[Asked]) -> (String, String) {
    let error = of(asked).unwrap_err();
    (error.to_string(), error.remedy())
}

#[test]
fn the_records_say_what_can_be_divided() {
    let (info, _) = host();
    let cache = CacheInfo { groups: 16, all: 0x7ff, least: 1, shared: 0x600 };
    let bandwidth = Some(BandwidthInfo { groups: 8, least: 10, step: 10 });
    assert_eq!(info, Info { cache: Some(cache), bandwidth, absolute: false });
    // Where code and data are divided apart there is no cache that is divided as a whole.
    let (info, _) = host_of("GenuineIntel", CDP);
    assert_eq!(info, Info { cache: None, bandwidth, absolute: false });
    let (info, schemata) = host_of("AuthenticAMD", EPYC);
    let cache = CacheInfo { groups: 16, all: 0xffff, least: 1, shared: 0 };
    let bandwidth = BandwidthInfo { groups: 16, least: 0, step: 1 };
    assert_eq!(info, Info { cache: Some(cache), bandwidth: Some(bandwidth), absolute: true });
    let whole = (0..4).map(|domain| (domain, 0xffff));
    assert!(schemata.of(Resource::Cache).eq(whole));
    let (info, schemata) = host_of("GenuineIntel", EMULATED);
    let cache = CacheInfo { groups: 16, all: 0xffff, least: 1, shared: 0xc000 };
    let bandwidth = Some(BandwidthInfo { groups: 8, least: 10, step: 10 });
    assert_eq!(info, Info { cache: Some(cache), bandwidth, absolute: false });
    assert!(schemata.of(Resource::Cache).eq([(0, 0xffff)]));
}

#[test]
fn amds_caches_are_divided_each_by_itself() {
    let (info, default) = host_of("AuthenticAMD", EPYC);
    let all = [asked("plc", 3, Some(4), None), asked("far", 9, Some(15), None)];
    let plan = plan(&all, info, &default, &[]).unwrap();
    assert_eq!(plan.groups[0].lines, ["L3:0=f", "L3:1=8000"]);
    assert_eq!(plan.groups[1].lines, ["L3:0=fff0", "L3:1=7fff"]);
    assert_eq!(plan.taken, ["L3:0=fff0", "L3:1=8000"]);
}

#[test]
fn partitions_have_their_ways_for_themselves_and_the_rest_is_the_hosts() {
    let all = [
        asked("plc", 3, Some(4), None),
        asked("linux", 2, None, Some(30)),
        asked("cell", 5, Some(2), Some(50)),
        asked("far", 9, Some(3), None),
    ];
    let plan = of(&all).unwrap();
    let lines: Vec<_> =
        plan.groups.iter().map(|g| (g.folder.as_str(), g.lines.join(" "))).collect();
    let expected = [
        ("takt-plc", "L3:0=f L3:1=7f8"),
        ("takt-linux", "L3:0=7c0 L3:1=7f8 MB:0=30"),
        ("takt-cell", "L3:0=30 L3:1=7f8 MB:0=50"),
        ("takt-far", "L3:0=7c0 L3:1=7"),
    ];
    assert_eq!(lines, expected.map(|(folder, lines)| (folder, lines.to_owned())));
    assert_eq!(plan.taken, ["L3:0=7c0", "L3:1=7f8"]);
    assert_eq!(plan.given_back, ["L3:0=7ff", "L3:1=7ff"]);
}

#[test]
fn a_linux_beside_another_cache_has_no_way_that_a_plc_has_there() {
    let plan = of(&[asked("plc", 9, Some(4), None), asked("linux", 2, None, Some(30))]).unwrap();
    assert_eq!(plan.groups[0].lines, ["L3:1=f"]);
    assert_eq!(plan.groups[1].lines, ["L3:1=7f0", "MB:0=30"]);
}

#[test]
fn bandwidth_alone_changes_nothing_for_others() {
    let plan = of(&[asked("linux", 2, None, Some(30))]).unwrap();
    assert_eq!(plan.groups[0].lines, ["MB:0=30"]);
    assert!(plan.taken.is_empty() && plan.given_back.is_empty());
}

#[test]
fn ways_that_devices_share_are_left_to_them() {
    let (mut info, default) = host();
    let mut lowest = info.cache.unwrap();
    lowest.shared = 3;
    info.cache = Some(lowest);
    let plan = plan(&[asked("plc", 3, Some(4), None)], info, &default, &[]).unwrap();
    assert_eq!((plan.groups[0].lines[0].as_str(), plan.taken[0].as_str()), ("L3:0=780", "L3:0=7f"));
    let (found, remedy) = refused(&[asked("plc", 3, Some(10), None)]);
    assert!(found.contains("ways 0x600 of 0x7ff"), "{found}");
    assert_eq!(remedy, "at most 9 ways for all partitions together");
    assert!(of(&[asked("plc", 3, Some(9), None)]).is_ok());
}

#[test]
fn what_the_processor_cannot_divide_is_refused_with_what_it_can() {
    let (found, remedy) = refused(&[asked("a", 3, Some(8), None), asked("b", 4, Some(3), None)]);
    assert!(found.contains("ask for 11 ways of L3 cache 0, which has 11"), "{found}");
    assert_eq!(remedy, "at most 10 ways for all partitions together");
    for (percent, remedy) in [(35, 30), (5, 10), (99, 90)] {
        let of = refused(&[asked("linux", 2, None, Some(percent))]);
        assert!(of.0.contains("steps of 10 % from 10 % on"), "{}", of.0);
        assert_eq!(of.1, format!("memory_bandwidth = {remedy}"));
    }
    // Eight groups, the default one among them.
    let many: Vec<_> = (0..8).map(|n| asked(&format!("p{n}"), 3, Some(1), None)).collect();
    let (found, _) = refused(&many);
    assert_eq!(found, "the processor tells 8 groups apart; 1 are there, and Takt needs 8 more");
    assert!(of(&many[..7]).is_ok());
    let nowhere = Asked { domain: None, ..asked("plc", 3, Some(1), None) };
    assert!(refused(&[nowhere]).0.contains("which L3 cache CPU 3 has"));
}

#[test]
fn a_processor_without_the_one_or_the_other_is_refused_what_it_lacks() {
    let (whole, default) = host();
    let with = |info, asked| plan(&[asked], info, &default, &[]).map_err(|e| e.to_string());
    let no_cache = Info { cache: None, ..whole };
    assert!(with(no_cache, asked("p", 3, Some(1), None)).unwrap_err().contains("no info/L3"));
    assert!(with(no_cache, asked("p", 3, None, Some(30))).is_ok());
    let no_bandwidth = Info { bandwidth: None, ..whole };
    let error = with(no_bandwidth, asked("p", 3, None, Some(30))).unwrap_err();
    assert!(error.contains("no info/MB"), "{error}");
    assert!(with(no_bandwidth, asked("p", 3, Some(1), None)).is_ok());
    let amd = Info { absolute: true, ..whole };
    assert!(with(amd, asked("p", 3, None, Some(30))).unwrap_err().contains("eighths"));
    let wide = CacheInfo { least: 2, ..whole.cache.unwrap() };
    let wide = Info { cache: Some(wide), ..whole };
    assert!(with(wide, asked("p", 3, Some(1), None)).unwrap_err().contains("divides off 2"));
}

#[test]
fn what_others_have_divided_is_left_to_them() {
    let (info, default) = host();
    let plc = [asked("plc", 3, Some(4), None)];
    let other = |ways| [("db".to_owned(), Schemata::new(&format!("L3:0={ways};1=7ff")))];
    let error = plan(&plc, info, &default, &other("3c")).unwrap_err();
    assert_eq!(error.remedy(), "rmdir the group db, or give its schemata other ways");
    assert!(plan(&plc, info, &default, &other("7f0")).is_ok());
    let divided = Schemata::new("L3:0=7f0;1=7ff");
    let error = plan(&plc, info, &divided, &[]).unwrap_err();
    assert_eq!(error.remedy(), "echo L3:0=7ff > /sys/fs/resctrl/schemata");
    let seven: Vec<_> = (0..7).map(|n| (format!("g{n}"), Schemata::default())).collect();
    assert!(matches!(plan(&plc, info, &default, &seven), Err(ResctrlError::TooManyGroups { .. })));
}

#[test]
fn nonsense_of_a_kernel_is_an_error_and_no_panic() {
    for text in ["", "x", "-1", "99999999999", "7ff7ff7ff"] {
        let read = |path: &str| match path {
            "info/L3/num_closids" => Ok("16".to_owned()),
            "info/L3/cbm_mask" => Ok(text.to_owned()),
            _ => Err(io::ErrorKind::NotFound.into()),
        };
        assert!(info("", read).is_err(), "{text}");
    }
    let (whole, default) = host();
    for all in [0, 1, u32::MAX] {
        let cache = CacheInfo { groups: u32::MAX, all, least: u32::MAX, shared: all };
        let odd = Info { cache: Some(cache), ..whole };
        for ways in [1, 32, u32::MAX] {
            let _ = plan(&[asked("p", 3, Some(ways), None)], odd, &default, &[]);
            let narrow = Info { cache: Some(CacheInfo { least: 1, ..cache }), ..whole };
            let _ = plan(&[asked("p", 3, Some(ways), None)], narrow, &default, &[]);
        }
    }
}
