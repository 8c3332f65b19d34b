//! A Linux with a network interface beside a PLC that keeps its time. The kernel of the appliance is at the other
//! end of the cable.

use takt_tests::{File, Host, Outcome, initrd_with, long};

const HOST: &str = "192.168.50.1";
const GUEST: &str = "192.168.50.2";

/// A PLC each millisecond, and a Linux with an interface that executes this when it has an address.
fn file(exec: &str) -> File {
    let programs = [env!("CARGO_BIN_EXE_packets"), env!("CARGO_BIN_EXE_hostile-virtio")];
    let initrd = initrd_with("network", &programs.map(str::as_ref));
    let up = format!("ifconfig eth0 {GUEST} up; packets serve & {exec}");
    let net = format!(
        "[[partition.net]]\ntap = \"takt0\"\nmac = \"02:00:00:00:00:07\"\naddress = \"{HOST}/24\""
    );
    File::new("1ms")
        .plc("plc", None, "release_guard = \"20us\"")
        .linux_with(&initrd, &up)
        .lines(&net)
        .schedule("normal")
        .window("plc", 0, 200)
}

/// Runs it with a peer that executes these commands when the guest is reached.
fn run(name: &str, file: &File, commands: &[&str]) -> Outcome {
    let file = file.save(name);
    let packets = env!("CARGO_BIN_EXE_packets");
    let path = file.to_string_lossy().into_owned();
    let arguments: Vec<&str> =
        [&*path, "takt0", GUEST].into_iter().chain(commands.iter().copied()).collect();
    let folder = takt_tests::target("");
    let host = Host::new()
        .with("--module", "tun")
        .with("--module", "vhost_net")
        .with("--program", packets)
        .with_file(&file);
    let host = ["guest/vmlinuz", "tests/network.img"]
        .iter()
        .fold(host, |host, image| host.with_file(&folder.join(image)));
    let outcome = host.run_as(name, "network", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome
}

/// A number of the only interface's entry in the report.
fn count(outcome: &Outcome, key: &str) -> u64 {
    let net = &outcome.partition("linux")["nets"][0];
    let value = key.split('.').fold(net, |value, part| &value[part]);
    value.as_u64().unwrap_or_else(|| panic!("{key}: {net}\n{}", outcome.output))
}

fn assert_plc_untouched(outcome: &Outcome) {
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[test]
fn a_linux_talks_with_its_network_both_ways_and_the_plc_keeps_its_time() {
    // 2 MiB there and back, and datagrams of all lengths.
    let exec = format!(
        "ping -c 3 {HOST} && echo pinged; packets tcp {HOST} 2097152 && echo streamed; \
         packets udp {HOST} 200 && echo echoed; cat /sys/class/net/eth0/address; \
         ethtool -k eth0; echo guest done"
    );
    let commands = ["ping -c 3 %", "packets tcp % 2097152", "packets udp % 200"];
    let outcome = run("network", &file(&exec), &commands);
    for line in ["pinged", "streamed", "echoed", "02:00:00:00:00:07"] {
        outcome.assert_shows(&format!("\n{line}"));
    }
    for command in commands {
        outcome.assert_shows(&format!("[host] {command}: 0"));
    }
    outcome.assert_shows("[host] the tap device is gone");
    outcome.assert_shows("\nrouter advertisements: 0");
    outcome.assert_shows(&format!("{HOST}/24"));
    outcome.assert_shows("\nworker: 0, policy 0");
    for direction in ["to_guest", "from_guest"] {
        assert!(count(&outcome, &format!("{direction}.bytes")) > 4 << 20, "{}", outcome.output);
        assert_eq!(count(&outcome, &format!("{direction}.dropped")), 0, "{}", outcome.output);
    }
    assert_eq!(count(&outcome, "refused_queues"), 0);
    assert_plc_untouched(&outcome);
}

/// Datagrams as fast as they can be sent, both ways at once.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_flood_from_either_end_moves_no_release() {
    let floods = if long() { 400_000 } else { 10_000 };
    let exec = format!("packets flood {HOST} {floods}; echo guest done");
    let command = format!("packets flood % {floods}");
    let outcome = run("network-flood", &file(&exec), &[&command]);
    outcome.assert_shows(&format!("[host] {command}: 0"));
    let sent = |direction: &str| {
        let of = |key: &str| count(&outcome, &format!("{direction}.{key}"));
        of("packets") + of("dropped")
    };
    assert!(sent("to_guest") >= floods, "{}", outcome.output);
    // What the guest's own queue had no room for, it never sent.
    assert!(sent("from_guest") >= floods / 10, "{}", outcome.output);
    assert_plc_untouched(&outcome);
}

/// A driver that hands over queues that lie nowhere, loop and wrap, and resets the interface while the host floods
/// it. Then Linux's own driver finds it as at power-on.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_hostile_driver_breaks_only_its_own_interface() {
    let steps = if long() { 20_000 } else { 1_000 };
    let driver = "/sys/bus/platform/drivers/virtio-mmio";
    let exec = format!(
        "sleep 1; echo LNRO0005:00 > {driver}/unbind; \
         for seed in 1 2 3; do hostile-virtio 0 $seed {steps}; done; echo hostile over; \
         echo LNRO0005:00 > {driver}/bind; ifconfig eth0 {GUEST} up; \
         packets tcp {HOST} 65536 && echo streamed; echo guest done"
    );
    // Its address is told to the host, which could not ask for it meanwhile.
    let flood = "arp -s % 02:00:00:00:00:07; floods=0; until grep -q '^hostile over' /out/console; \
                 do kill -0 $takt || break; packets flood % 1000; floods=$((floods + 1)); done; \
                 echo \"[host] $floods floods\" >>/out/console";
    let outcome = run("network-hostile", &file(&exec), &[flood]);
    let told = outcome
        .output
        .lines()
        .find_map(|line| line.strip_prefix("[host] ")?.strip_suffix(" floods"));
    let floods: u64 = told.and_then(|number| number.parse().ok()).unwrap_or(0);
    assert!(floods > 2, "{told:?}\n{}", outcome.output);
    let reached = count(&outcome, "to_guest.packets") + count(&outcome, "to_guest.dropped");
    // What does not fit into a buffer that the driver has made up, the kernel counts nowhere.
    assert!(reached >= 900 * floods, "{reached} of {floods} floods\n{}", outcome.output);
    assert_eq!(outcome.output.matches("\nhostile-virtio: slot 0, seed ").count(), 3);
    outcome.assert_shows("\nstreamed");
    assert!(count(&outcome, "refused_queues") > 10, "{}", outcome.output);
    outcome.assert_not_grown(2 << 20);
    assert_plc_untouched(&outcome);
}
