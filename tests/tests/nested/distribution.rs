//! A whole Debian with systemd and ssh beside a PLC that keeps its time: the shipped partition file, with a disk
//! that `scripts/guest-image --debian-tests` makes.

mod everyday;
mod page;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

use takt_tests::{Host, Outcome, Value, parse, root, save_bytes, target};

use crate::carried::build_clients;

const ADDRESS: &str = "192.168.50.2";

/// apt with the repository that is on the disk, and no other.
const LOCAL_APT: &str =
    "apt-get -q -o Dir::Etc::SourceList=/srv/local.list -o Dir::Etc::SourceParts=-";

/// The folder for what a run leaves has one name for all of them.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// The disk of the tests, and what visits it.
fn folder() -> PathBuf {
    let folder = target("debian-tests").canonicalize();
    folder.expect("scripts/guest-image --debian-tests has run")
}

/// A partition file of `configs` with the disk in this folder, and without all that Linux says, and what it tests of
/// its own cryptography, while it starts.
fn file(shipped: &str, folder: &Path) -> PathBuf {
    let text = fs::read_to_string(root().join(format!("configs/{shipped}.toml"))).unwrap();
    let text = text
        .replace(&format!("../target/{shipped}/"), &format!("{}/", folder.display()))
        .replace("root=/dev/vda ", "root=/dev/vda quiet cryptomgr.notests ");
    assert!(text.contains(" quiet ") && !text.contains("../target"), "{text}");
    save_bytes("distribution.toml", text.as_bytes())
}

/// [`live_of`] `configs/debian.toml`.
fn live(lives: usize, commands: &[&str], folder: &Path, options: &[[&str; 2]]) -> Vec<Outcome> {
    live_of("debian", lives, commands, folder, options)
}

/// What all the lives of the Debian in a folder left, in their order, in a machine with these options too.
/// `tests/host/distribution` says where a command is executed.
fn live_of(
    shipped: &str,
    lives: usize,
    commands: &[&str],
    folder: &Path,
    options: &[[&str; 2]],
) -> Vec<Outcome> {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let file = file(shipped, folder);
    let (disk, visitors) = (folder.join("disk.img"), self::folder().join("visitors"));
    let path = |path: &Path| path.to_string_lossy().into_owned();
    let (disk_path, visitors_path, number) = (path(&disk), path(&visitors), lives.to_string());
    let partition_file = file.to_string_lossy().into_owned();
    let arguments: Vec<&str> = [&*partition_file, &*disk_path, &*visitors_path, ADDRESS, &*number]
        .into_iter()
        .chain(commands.iter().copied())
        .collect();
    build_clients();
    let shell = root().join("target/x86_64-unknown-linux-gnu/debug/takt-shell");
    let host = Host::new()
        .given_up_after(6_000 + 300 * lives as u32)
        .with("--module", "tun")
        .with("--module", "vhost_net")
        .with("--module", "vhost_vsock")
        .with("--program", &shell.to_string_lossy())
        .with("--memory", "640")
        .with_file(&file);
    let files = [folder.join("vmlinuz"), folder.join("initrd.img"), disk, visitors];
    let host = files.iter().fold(host, |host, file| host.with_file(file));
    let host = options.iter().fold(host, |host, [option, value]| host.with(option, value));
    let left = target("tests/distribution.out");
    let _ = fs::remove_dir_all(&left);
    let machine = host.run("distribution", &arguments);
    assert_eq!(machine.status, 0, "{}", machine.output);
    let life = |number| {
        let report = fs::read_to_string(left.join(format!("{number}.json")));
        let report = report.map_or(Value::Null, |text| parse(&text));
        Outcome { status: 0, output: machine.output.clone(), report, trace: Value::Null }
    };
    (1..=lives).map(life).collect()
}

/// Debian was up without a service that failed, and off by itself when it was asked, with a clean disk. The PLC
/// kept its time.
fn assert_lived_well(lives: &[Outcome]) {
    for (outcome, number) in lives.iter().zip(1..) {
        outcome.assert_shows(&format!("[host] life {number}: running"));
        // sshd knows no addresses of this kind.
        outcome.assert_shows(&format!("[host] life {number}: by vsock from UNKNOWN"));
        outcome.assert_shows(&format!("[host] life {number}: takt has ended with 0"));
        outcome.assert_shows(&format!("[host] life {number}: file system: 0"));
        assert_eq!(outcome.partition("debian")["end"], "powered off", "{}", outcome.output);
        outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
        outcome.assert_punctual("plc");
    }
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_debian_starts_serves_ssh_and_switches_itself_off_with_its_file_system_clean() {
    let commands = ["1:cat /etc/os-release", "1:ip -brief address show eth0"];
    let lives = live(1, &commands, &folder(), &[]);
    assert_lived_well(&lives);
    lives[0].assert_shows("[debian] ID=debian");
    // No name server answers here. Looking for the name of who logs in by vsock, sshd would take 20 s and more.
    assert!(lives[0].cycles(1_000) < 25_000, "{}", lives[0].output);
    lives[0].assert_shows(&format!("{ADDRESS}/24"));
}

/// The first life installs a package, the second and the last find it.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_debian_that_starts_a_hundred_times_keeps_what_apt_installed_and_a_clean_file_system() {
    const LIVES: usize = 100;
    let source = "1:echo 'deb [trusted=yes] file:/srv/packages ./' > /srv/local.list";
    let update = format!("1:{LOCAL_APT} update");
    let install = format!("1:{LOCAL_APT} -y install hello");
    let last = format!("{LIVES}:hello");
    let commands = [source, &*update, &*install, "1:hello", "2:hello", &*last];
    let lives = live(LIVES, &commands, &folder(), &[]);
    assert_lived_well(&lives);
    let greetings = lives[0].output.matches("[debian] Hello, world!").count();
    assert_eq!(greetings, 3, "{}", lives[0].output);
}

/// A Debian with these packages too, as a user makes it. Takes minutes the first time.
fn debian_with(name: &str, packages: &str, size: &str) -> PathBuf {
    let folder = target(name);
    let mut script = Command::new(root().join("scripts/guest-image"));
    script.args(["--debian", "--no-password", "--include", packages, "--size", size]);
    if let Ok(suite) = std::env::var("TAKT_SUITE") {
        script.arg(suite);
    }
    script.arg("--ssh-key").arg(self::folder().join("visitors/key.pub"));
    let made = script.arg("--out").arg(&folder).status().expect("the script starts");
    assert!(made.success(), "{made}");
    folder.canonicalize().expect("it is made")
}

/// `scripts/guest-image --debian-kernel` with the disk in this folder.
fn copy_kernel(folder: &Path) -> Output {
    let mut script = Command::new(root().join("scripts/guest-image"));
    script.args(["--debian-kernel", "--out"]).arg(folder).output().expect("the script starts")
}

#[test]
fn a_kernel_that_debian_has_updated_comes_out_of_its_disk() {
    let folder = target("tests/debian-kernel");
    let _ = fs::remove_dir_all(&folder);
    let (tree, disk) = (folder.join("tree"), folder.join("disk.img"));
    fs::create_dir_all(tree.join("boot")).unwrap();
    for (name, link) in [("vmlinuz-6.1-new", "vmlinuz"), ("initrd.img-6.1-new", "initrd.img")] {
        fs::write(tree.join("boot").join(name), name).unwrap();
        std::os::unix::fs::symlink(format!("boot/{name}"), tree.join(link)).unwrap();
        fs::write(folder.join(link), "before").unwrap();
    }
    fs::File::create(&disk).unwrap().set_len(4 << 20).unwrap();
    let mut mke2fs = Command::new("mke2fs");
    mke2fs.args(["-q", "-t", "ext4", "-d"]).arg(&tree).arg(&disk);
    assert!(mke2fs.status().expect("mke2fs starts").success());

    // As a Linux leaves it that is stopped without warning.
    let debugfs = |request: &str| {
        let mut debugfs = Command::new("debugfs");
        debugfs.args(["-w", "-R", request]).arg(&disk);
        assert!(debugfs.output().expect("debugfs starts").status.success());
    };
    debugfs("feature needs_recovery");
    let refused = copy_kernel(&folder);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("was not unmounted"), "{said}");
    assert_eq!(fs::read_to_string(folder.join("vmlinuz")).unwrap(), "before");

    debugfs("feature -needs_recovery");
    let copied = copy_kernel(&folder);
    let said = String::from_utf8_lossy(&copied.stderr).into_owned();
    assert!(copied.status.success() && said.contains("kernel 6.1-new"), "{said}");
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!((read("vmlinuz"), read("vmlinuz.old")), ("vmlinuz-6.1-new".into(), "before".into()));
    assert_eq!(read("initrd.img"), "initrd.img-6.1-new");
    assert_eq!(read("initrd.img.old"), "before");
}
