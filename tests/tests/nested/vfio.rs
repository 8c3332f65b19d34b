//! A device that masters the bus behind an IOMMU: it reaches the memory of its partition and nothing
//! else, and is given back. All of it is long: it needs machines of its own.

use std::path::Path;

use takt_tests::{File, Host, Outcome, plc_image};

use super::passthrough::numbers;

/// The registers of QEMU's `edu` and its interrupt; more of them than there is, in the broken one.
fn edu(size: &str) -> String {
    format!(
        r#"
[[partition.mmio]]
name = "edu"
address = "0xd0000000"
size = "{size}"
pci = "0000:00:06.0"
bar = 0
unbind = true
vfio = true

[[partition.interrupt]]
vector = 64
pci = "0000:00:06.0"
"#
    )
}

fn file(size: &str) -> File {
    File::new("1ms")
        .plc("drive", Some(plc_image("dma")), &edu(size))
        .plc("neighbour", Some(plc_image("pattern")), "")
        .health("drive", "partition-ended", "cold-start")
        .schedule("normal")
        .window("drive", 0, 200)
        .window("neighbour", 300, 300)
}

fn run(name: &str, devices: &[&str]) -> Outcome {
    let (broken, good) = (file("2MiB").save("vfio-broken"), file("4KiB").save("vfio"));
    let mut host = Host::new().with("--device", "edu");
    for device in devices {
        host = host.with("--device", device);
    }
    for module in ["pci-stub", "vfio-pci", "vfio_iommu_type1"] {
        host = host.with("--module", module);
    }
    for path in [&broken, &good, &plc_image("dma"), &plc_image("pattern")] {
        host = host.with_file(path);
    }
    let text = |path: &Path| path.to_string_lossy().into_owned();
    host.run_as(name, "vfio", &[&text(&broken), &text(&good), "4s"])
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_device_behind_an_iommu_reaches_its_partitions_memory_and_nothing_else() {
    let outcome = run("vfio", &["iommu"]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // A start that fails after the device was taken.
    outcome.assert_shows("register 0 of 0000:00:06.0 has 0x100000 bytes");
    outcome.assert_shows("the broken file ends with 3");

    outcome.assert_shows("it may master the bus and reaches the memory of its partition");
    // The second guest is one that the first has left a copy under way for.
    assert_eq!(outcome.number("drive", "restarts"), 1, "{}", outcome.output);
    let words = ["good", "bad", "outside", "leaked", "wrong"];
    let [good, bad, outside, leaked, wrong] = numbers(&outcome, "drive", words);
    assert!(good >= 6 && bad == 0 && wrong == 0, "{}", outcome.output);
    assert!(outside >= 12 && leaked == 0, "{}", outcome.output);
    let refused = {
        let line = outcome.output.lines().find_map(|l| l.split_once("refused transfers told of: "));
        let (_, count) = line.unwrap_or_else(|| panic!("no count\n{}", outcome.output));
        count.trim().parse::<u64>().expect("a number")
    };
    assert!(refused >= 1, "{}", outcome.output);

    let [passes, changed] = numbers(&outcome, "neighbour", ["passes", "changed"]);
    assert!(passes >= 40 && changed == 0, "{}", outcome.output);
    outcome.assert_kept_its_time("neighbour", 3_900);
    outcome.assert_punctual("neighbour");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn without_an_iommu_no_device_is_let_master_the_bus() {
    let outcome = run("vfio-no-iommu", &[]);
    assert_eq!(outcome.status, 3, "{}", outcome.output);
    outcome.assert_shows("0000:00:06.0 is behind no IOMMU");
}
