//! What people run in their Linux all day, in a Debian beside a PLC: a database that is asked over the network, and a
//! clock that follows the host's.

use takt_tests::Outcome;

use super::{ADDRESS, assert_lived_well, debian_with, live_of};
use crate::linux_guest::{MILLISECOND, ahead, stamp};

/// What the Debian of these tests has besides, and how large its disk is.
const PACKAGES: &str = "postgresql,stress-ng,chrony";
const SIZE: &str = "900M";
/// The disk is a file in the host's memory, beside the memory of the guests.
const MEMORY: &str = "1800";
/// Seconds that the database is asked.
const ASKED: u32 = 60;

/// One life of that Debian, in which these commands are executed.
fn live(commands: &[&str], options: &[[&str; 2]]) -> Outcome {
    let folder = debian_with("debian-database", PACKAGES, SIZE);
    let options = [options, &[["--memory", MEMORY]]].concat();
    let lives = live_of("debian", 1, commands, &folder, &options);
    assert_lived_well(&lives);
    lives.into_iter().next().expect("a life")
}

/// The first number behind `before`.
fn number(outcome: &Outcome, before: &str) -> f64 {
    let rest = outcome.output.split_once(before).map_or("", |(_, rest)| rest).trim_start();
    let digits = rest.split(|c: char| !c.is_ascii_digit() && c != '.').next();
    let number = digits.and_then(|digits| digits.parse().ok());
    number.unwrap_or_else(|| panic!("no number behind {before:?}\n{}", outcome.output))
}

/// What stress-ng's stressors have done, by its own figures: those of them that did anything.
fn stressed(outcome: &Outcome) -> Vec<(&str, u64)> {
    let figures = outcome.output.lines().filter_map(|line| line.split_once("stress-ng: metrc: ["));
    figures
        .filter_map(|(_, rest)| {
            let mut words = rest.split_once("] ")?.1.split_whitespace();
            let (name, done) = (words.next()?, words.next()?.parse().ok()?);
            (done > 0).then_some((name, done))
        })
        .collect()
}

/// pgbench is PostgreSQL's own. It runs on the host from the disk that Debian has it on, and asks over the tap device.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_database_is_asked_over_the_network_under_stress_and_no_release_is_late() {
    // A Debian with a database is some 250 MB of packages, and a minute of this load takes most of an hour.
    let listen = format!(
        "1:cd /etc/postgresql/*/main && echo \"listen_addresses = '*'\" > conf.d/network.conf && \
         echo 'host all all 192.168.50.1/32 trust' >> pg_hba.conf && systemctl restart postgresql && \
         until pg_isready -q -h {ADDRESS}; do sleep 0.2; done"
    );
    let bench = format!(
        "chroot /debian /$(cd /debian && echo usr/lib/postgresql/*/bin/pgbench) -h {ADDRESS} -U postgres"
    );
    let fill = format!("1@{bench} -q -i postgres");
    let ask = format!("1@{bench} -T {ASKED} -P 10 -c 4 postgres");
    let commands = [
        // The kernel stops for microseconds where it loads a module.
        "0@modprobe -a loop ext4; mkdir /debian; mount -t ext4 -o loop,ro,noload $disk /debian",
        &*listen,
        &fill,
        // Each stressor of the class for some seconds, one after the other.
        "1:systemd-run -q --unit stress stress-ng --class network --sequential 1 --timeout 3 --metrics-brief",
        &ask,
        "1:systemctl stop stress; journalctl -q --no-pager -o cat -u stress; ip -s link show eth0",
    ];
    let outcome = live(&commands, &[["--module", "loop"], ["--module", "ext4"]]);
    let done = number(&outcome, "number of transactions actually processed:");
    let failed = number(&outcome, "number of failed transactions:");
    assert!(done > 100.0 && failed < 1.0, "{done} {failed}\n{}", outcome.output);
    let stressed = stressed(&outcome);
    println!("{done} transactions in {ASKED} s, beside {stressed:?}");
    // The others want what this kernel or this user lacks.
    assert!(stressed.len() > 5, "{stressed:?}\n{}", outcome.output);
}

/// chrony steers the guest's clock by the PTP clock of KVM's, while the host's is steered by 200 ppm: 12 ms in
/// a minute.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_guest_with_chrony_stays_within_a_millisecond_of_a_host_whose_clock_is_steered() {
    const SAMPLES: usize = 10;
    let program = env!("CARGO_BIN_EXE_stamp");
    let samples = format!(
        "1@for n in $(seq {SAMPLES}); do stamp host-$n; on_debian \"/stamp guest-$n\"; sleep 3; done"
    );
    let commands = [
        "1@on_debian 'cat > /stamp && chmod +x /stamp' < /bin/stamp",
        "1@adjtimex -q -t 10002",
        "1:modprobe ptp_kvm && echo 'refclock PHC /dev/ptp0 poll 2' > /etc/chrony/conf.d/takt.conf && \
         systemctl restart chrony && chronyc -n waitsync 30 0.001 0 1",
        "1@sleep 30",
        &*samples,
        "1:chronyc -n tracking; chronyc -n sources",
        "1@adjtimex -q -t 10000",
    ];
    let outcome = live(&commands, &[["--program", program], ["--clock", "steered"]]);
    let of = |name: &str, number: usize| format!("{name}-{number}");
    let [first, last] = [1, SAMPLES].map(|number| stamp(&outcome, &of("host", number)));
    // In the lab the TSC counts nanoseconds.
    let gained = (last.1 - first.1) - (last.0 - first.0);
    assert!(gained > 5 * MILLISECOND, "the host's clock was not steered: {gained} ns");
    let off: Vec<i128> = (1..=SAMPLES)
        .map(|number| ahead(&outcome, &of("host", number), &of("guest", number)))
        .collect();
    println!("the host's clock gained {gained} ns; the guest's was ahead of it by {off:?} ns");
    assert!(off.iter().all(|off| off.abs() < MILLISECOND), "{off:?}\n{}", outcome.output);
}
