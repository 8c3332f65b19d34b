//! Against a file system that is made up and holds the record of a host. That the kernel's own does the same is tested
//! in a whole machine (`tests/tests/nested/hardware.rs`).

#[path = "fake_tests.rs"]
mod fake;

use takt_host::resctrl::ResctrlError;
use takt_scheduler::table::Cpu;

use super::*;
use crate::kernel_tree::Tree;
use fake::Fake;

const XEON: &str = include_str!("../../host/tests/hosts/resctrl-xeon.host");
const CDP: &str = include_str!("../../host/tests/hosts/resctrl-xeon-cdp.host");
const EPYC: &str = include_str!("../../host/tests/hosts/resctrl-epyc.host");
/// What Debian's kernel 6.1 has on a processor of Bochs's that only says that it divides.
const EMULATED: &str = include_str!("../../host/tests/hosts/resctrl-emulated.host");

fn fake() -> Fake {
    Fake::of(XEON)
}

/// The lines of a file, without the space that the kernel aligns them by.
fn lines(kernel: &Fake, path: &str) -> Vec<String> {
    kernel.read(path).unwrap().lines().map(|line| line.trim().to_owned()).collect()
}

fn asked(partition: &str, ways: Option<u32>, percent: Option<u32>) -> Asked {
    Asked { partition: partition.into(), cpu: Cpu(3), domain: Some(0), ways, percent }
}

fn usual() -> [Asked; 2] {
    [asked("plc", Some(4), None), asked("linux", None, Some(30))]
}

#[test]
fn groups_are_made_in_order_and_all_is_undone() {
    let kernel = fake();
    let before = kernel.files();
    let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
    let steps = [
        "make takt-plc",
        "takt-plc/schemata = L3:0=f",
        "make takt-linux",
        "takt-linux/schemata = L3:0=7f0",
        "takt-linux/schemata = MB:0=30",
        "schemata = L3:0=7f0",
    ];
    assert_eq!(kernel.log(), steps);
    assert_eq!(lines(&kernel, "takt-plc/schemata"), ["MB:0=100;1=100", "L3:0=00f;1=7ff"]);
    assert_eq!(lines(&kernel, "takt-linux/schemata"), ["MB:0= 30;1=100", "L3:0=7f0;1=7ff"]);
    let tasks = setup.entry("linux").map(|entry| format!("{entry:?}")).unwrap();
    assert!(tasks.contains("/sys/fs/resctrl/takt-linux/tasks"), "{tasks}");
    assert!(setup.entry("other").is_none());
    setup.undo().unwrap();
    let undone = ["schemata = L3:0=7ff", "remove takt-linux", "remove takt-plc"];
    assert_eq!(kernel.log()[steps.len()..], undone);
    assert_eq!(kernel.files(), before);
    setup.undo().unwrap();
    assert_eq!(kernel.log().len(), steps.len() + undone.len());
}

/// A test of whole machines asserts that the kernel shows the same (`tests/tests/nested/hardware.rs`).
#[test]
fn the_groups_are_what_a_kernel_made_of_the_same_shares() {
    let kernel = Fake::of(EMULATED);
    let before = kernel.files();
    let on_cpu_0 = usual().map(|asked| Asked { cpu: Cpu(0), ..asked });
    let mut setup = Setup::make(kernel.clone(), &on_cpu_0).unwrap();
    let of = |path: &str| kernel.read(path).unwrap();
    assert_eq!(of("schemata"), "    MB:0= 100\n    L3:0=fff0\n");
    assert_eq!(of("takt-linux/schemata"), "    MB:0=  30\n    L3:0=fff0\n");
    assert_eq!(of("takt-plc/schemata"), "    MB:0= 100\n    L3:0=000f\n");
    setup.undo().unwrap();
    assert_eq!(kernel.files(), before);
}

#[test]
fn whichever_step_is_refused_all_is_as_before() {
    for step in 0..6 {
        let kernel = fake();
        let before = kernel.files();
        kernel.refuse(step);
        let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
        assert!(error.to_string().contains("info/last_cmd_status"), "{error}");
        assert_eq!(kernel.files(), before, "step {step}: {:?}", kernel.log());
    }
}

#[test]
fn undoing_goes_on_after_a_step_that_is_refused() {
    for step in 6..9 {
        let kernel = fake();
        let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
        kernel.refuse(step);
        assert!(setup.undo().is_err());
        assert_eq!(kernel.log().len(), 8, "step {step}: {:?}", kernel.log());
    }
}

#[test]
fn what_a_killed_takt_has_left_is_removed_wherever_it_was_killed() {
    for killed_after in 1..=6 {
        let kernel = fake();
        let before = kernel.files();
        // Nothing is undone: the process is gone.
        let setup = Setup::make(kernel.clone(), &usual()).unwrap();
        let steps = kernel.log();
        drop(setup);
        let killed = fake();
        for step in &steps[..killed_after] {
            match step.split_once(" = ") {
                Some((path, line)) => killed.write(path, line).unwrap(),
                None => killed.make(step.strip_prefix("make ").unwrap()).unwrap(),
            }
        }
        let found = remove_left_over(&killed).unwrap();
        assert_eq!(found, if killed_after < 3 { 1 } else { 2 });
        assert_eq!(killed.files(), before, "{:?}", killed.log());
        assert_eq!(remove_left_over(&killed).unwrap(), 0);
    }
}

#[test]
fn a_group_with_threads_is_left_alone() {
    let kernel = fake();
    kernel.make("takt-plc").unwrap();
    kernel.set("takt-plc/tasks", "71\n72\n");
    let before = kernel.files();
    let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
    assert!(matches!(&error, GroupError::InUse { threads, .. } if threads == "71, 72"), "{error}");
    assert_eq!(kernel.files(), before);
}

#[test]
fn groups_of_others_stay_and_are_in_the_way_where_they_use_the_same_ways() {
    let kernel = fake();
    kernel.make("database").unwrap();
    let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
    let taken = matches!(&error, GroupError::Refused { source: ResctrlError::Taken { group, .. } } if group == "database");
    assert!(taken && error.to_string().contains("rmdir the group database"), "{error}");
    kernel.write("database/schemata", "L3:0=7f0").unwrap();
    let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
    setup.undo().unwrap();
    assert_eq!(kernel.folders().unwrap(), ["database", "info", "mon_data"]);
    assert_eq!(lines(&kernel, "database/schemata"), ["MB:0=100;1=100", "L3:0=7f0;1=7ff"]);
}

#[test]
fn amds_cache_is_divided_and_its_bandwidth_is_no_percentage() {
    let kernel = Fake::of(EPYC);
    let before = kernel.files();
    let plc = Asked { domain: Some(2), ..asked("plc", Some(5), None) };
    let mut setup = Setup::make(kernel.clone(), &[plc]).unwrap();
    let steps = ["make takt-plc", "takt-plc/schemata = L3:2=1f", "schemata = L3:2=ffe0"];
    assert_eq!(kernel.log(), steps);
    let untouched = ["SMBA:0=2048;1=2048;2=2048;3=2048", "MB:0=2048;1=2048;2=2048;3=2048"];
    let cache = ["L3:0=ffff;1=ffff;2=001f;3=ffff", "L3:0=ffff;1=ffff;2=ffe0;3=ffff"];
    for (path, cache) in ["takt-plc/schemata", "schemata"].iter().zip(cache) {
        assert_eq!(lines(&kernel, path), [untouched[0], untouched[1], cache]);
    }
    setup.undo().unwrap();
    assert_eq!(kernel.files(), before);
    for (killed_after, left) in [(1, 1), (2, 1), (3, 1)] {
        let killed = Fake::of(EPYC);
        killed.make("takt-plc").unwrap();
        for line in [("takt-plc/schemata", "L3:2=1f"), ("schemata", "L3:2=ffe0")]
            .iter()
            .take(killed_after - 1)
        {
            killed.write(line.0, line.1).unwrap();
        }
        assert_eq!(remove_left_over(&killed).unwrap(), left);
        assert_eq!(killed.files(), before, "{:?}", killed.log());
    }
    let error = Setup::make(kernel.clone(), &[asked("linux", None, Some(30))]).err().unwrap();
    let text = error.to_string();
    assert!(
        text.contains("eighths of a GB/s") && text.ends_with("leave `memory_bandwidth` out"),
        "{text}"
    );
    assert_eq!(kernel.files(), before);
}

#[test]
fn a_cache_with_code_and_data_apart_is_left_as_it_is() {
    let kernel = Fake::of(CDP);
    let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
    assert!(error.to_string().contains("no info/L3"), "{error}");
    assert_eq!(kernel.log(), [""; 0]);
    // Bandwidth is divided apart from the cache.
    let mut setup = Setup::make(kernel.clone(), &[asked("linux", None, Some(30))]).unwrap();
    assert_eq!(kernel.log(), ["make takt-linux", "takt-linux/schemata = MB:0=30"]);
    setup.undo().unwrap();
}

#[test]
fn what_the_kernel_would_refuse_is_refused_here_too() {
    let [xeon, epyc] = [XEON, EPYC].map(Fake::of);
    for line in
        ["L3:0=505", "L3:0=fff", "L3:0=0", "L3:2=1", "L2:0=1", "MB:0=5", "MB:0=101", "MB:0=x"]
    {
        assert!(xeon.write("schemata", line).is_err(), "{line}");
    }
    // The kernel rounds up what is between two steps, which the plan therefore refuses.
    xeon.write("schemata", "MB:0=31;1=10").unwrap();
    assert_eq!(lines(&xeon, "schemata")[0], "MB:0= 40;1= 10");
    epyc.write("schemata", "L3:1=f00f").unwrap();
    epyc.write("schemata", "MB:1=16").unwrap();
    assert_eq!(lines(&epyc, "schemata")[1], "MB:0=2048;1=  16;2=2048;3=2048");
    // The default group is one of the eight that the processor tells apart for bandwidth.
    let made = (0..20).take_while(|n| xeon.make(&format!("g{n}")).is_ok()).count();
    assert_eq!(made, 7);
    let many: Vec<_> = (0..8).map(|n| asked(&format!("p{n}"), None, Some(30))).collect();
    let error = Setup::make(fake(), &many).err().unwrap();
    assert!(error.to_string().contains("8 groups apart"), "{error}");
}
