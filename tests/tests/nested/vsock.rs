//! A Linux that programs of the host reach without a network, beside a PLC that keeps its time. The kernel of the
//! appliance is the host.

use std::path::Path;

use takt_tests::{File, Host, Outcome, initrd_with, long, root};

use crate::carried::build_clients;

/// The driver that finds the Linux's virtio devices.
const DRIVER: &str = "/sys/bus/platform/drivers/virtio-mmio";

/// A PLC each millisecond, and a Linux with this number that executes this.
fn file(cid: &str, exec: &str) -> File {
    let programs = [env!("CARGO_BIN_EXE_vsock"), env!("CARGO_BIN_EXE_hostile-virtio")];
    let initrd = initrd_with("vsock", &programs.map(str::as_ref));
    File::new("1ms")
        .plc("plc", None, "release_guard = \"20us\"")
        .linux_with(&initrd, exec)
        .lines(&format!("vsock = {cid}"))
        .schedule("normal")
        .window("plc", 0, 200)
}

/// A machine with the partition file, what that names, and what the script needs.
fn host(file: &Path) -> Host {
    let folder = takt_tests::target("");
    let host = Host::new()
        .with("--module", "vhost_vsock")
        .with("--program", env!("CARGO_BIN_EXE_vsock"))
        .with_file(file);
    ["guest/vmlinuz", "tests/vsock.img"]
        .iter()
        .fold(host, |host, image| host.with_file(&folder.join(image)))
}

/// Runs it, and goes in once in each life of the guest with so many bytes.
fn run(name: &str, file: &File, [cid, lives, bytes]: [&str; 3]) -> Outcome {
    build_clients();
    let file = file.save(name);
    let shell = root().join("target/x86_64-unknown-linux-gnu/debug/takt-shell");
    let host = host(&file).with("--program", &shell.to_string_lossy());
    let outcome = host.run_as(name, "vsock", &[&file.to_string_lossy(), cid, lives, bytes]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
    outcome
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_is_reached_without_a_network_again_after_its_restart_and_the_plc_keeps_its_time() {
    let exec = "vsock serve 7 & vsock await 8; reboot -f";
    let outcome = run("vsock", &file("4294967293", exec), ["4294967293", "2", "1048576"]);
    assert_eq!(outcome.output.matches("\n[host] port 7: 0").count(), 2, "{}", outcome.output);
    assert_eq!(outcome.partition("linux")["restarts"], 1, "{}", outcome.output);
    outcome.assert_shows("takt-shell: cannot reach port 9 of the guest with CID 4294967293");
    outcome.assert_shows("no program of the guest listens there");
    outcome.assert_shows("takt-shell: cannot reach port 7 of the guest with CID 4294967294");
    outcome.assert_shows("does Takt run this file");
    outcome.assert_shows("\n[host] worker: 0, policy 0");
    let vsock = &outcome.partition("linux")["vsock"];
    assert_eq!((&vsock["cid"], &vsock["refused_queues"]), (&4_294_967_293_u32.into(), &0.into()));
}

/// A driver that hands over queues that lie nowhere, loop and wrap. Then Linux's own driver finds the device as at
/// power-on.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_hostile_driver_breaks_only_its_own_sockets() {
    let steps = if long() { 20_000 } else { 1_000 };
    let exec = format!(
        "echo LNRO0005:00 > {DRIVER}/unbind; \
         for seed in 1 2 3; do hostile-virtio 0 $seed {steps}; done; \
         echo LNRO0005:00 > {DRIVER}/bind; vsock serve 7"
    );
    let outcome = run("vsock-hostile", &file("3", &exec), ["3", "1", "65536"]);
    assert_eq!(outcome.output.matches("\nhostile-virtio: slot 0, seed ").count(), 3);
    outcome.assert_shows("\n[host] port 7: 0");
    let refused = outcome.partition("linux")["vsock"]["refused_queues"].as_u64();
    assert!(refused > Some(10), "{}", outcome.output);
    outcome.assert_not_grown(2 << 20);
}

/// Runs it, and ends the run while a program of the host holds up the kernel's worker, and the worker these threads of Takt's.
fn end_while_held_up(name: &str, exec: &str, threads: &[&str]) -> Outcome {
    let file = file("3", exec).save(name);
    let path = file.to_string_lossy();
    let arguments: Vec<&str> = [&*path, "3"].into_iter().chain(threads.iter().copied()).collect();
    let outcome = host(&file).run_as(name, "vsock-held", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let looks = outcome.output.lines().find_map(|line| {
        line.strip_prefix("[host] takt: Z after ")?.strip_suffix(" looks")?.parse::<u32>().ok()
    });
    // Each is 20 ms and what the script takes.
    assert!(looks.is_some_and(|looks| looks < 250), "{}", outcome.output);
    outcome.assert_shows("\n[host] the report is there");
    outcome.assert_shows("\n[host] the worker still waits");
    outcome.assert_shows("\n[takt] linux: a program of the host holds up its network or socket");
    assert_eq!(outcome.partition("linux")["held_up"], true);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
    outcome
}

/// Connections to port 7 have ended when the next command comes, which is when somebody has connected to port 8.
const CLOSES: &str = "vsock serve 7 & vsock await 8; kill $!; wait $!";

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_program_that_holds_up_the_worker_does_not_hold_up_the_end_of_the_run() {
    let outcome = end_while_held_up("vsock-held", CLOSES, &[]);
    outcome.assert_shows("\n[host] takt's status: 0");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_guest_whose_reset_is_held_up_does_not_hold_up_the_end_of_the_run() {
    let exec = format!("{CLOSES}; echo LNRO0005:00 > {DRIVER}/unbind");
    let outcome = end_while_held_up("vsock-held-reset", &exec, &["linux"]);
    // The guest has not left its processor, and the report says so.
    outcome.assert_shows("\n[host] takt's status: 4");
    assert_eq!(outcome.partition("linux")["end"], "its thread waits for the kernel");
}
