//! What the process may do with its host, as the kernel sees it, and what follows if it tries more.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::{File, Host, Value, long, parse, plc_image, root, target, timeout_s};

use crate::devices::PRINTER;

/// What a script of `tests/host` has left.
struct Looked {
    folder: PathBuf,
}

impl Looked {
    /// Runs the script on a partition file, with what that names.
    fn by(
        script: &str,
        name: &str,
        file: &Path,
        files: &[PathBuf],
        arguments: &[&str],
        options: &[&str],
    ) -> Self {
        let file = file.canonicalize().expect("it is there");
        let folder = target("tests").join(format!("{name}.out"));
        let _ = fs::remove_dir_all(&folder);
        let mut command = Command::new(root().join("scripts/host"));
        for path in files.iter().chain([&file]) {
            command.arg("--file").arg(path);
        }
        command.args(options).arg("--out").arg(&folder);
        command.arg(root().join("tests/host").join(script)).arg(&file).args(arguments);
        let output = command.env("TAKT_TIMEOUT", timeout_s(0)).output();
        let output = output.expect("scripts/host starts");
        let this = Self { folder };
        let told =
            String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{told}\n{}", this.read("console"));
        this
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.folder.join(name)).unwrap_or_default()
    }

    /// All calls of threads from the one on that shuts their doors, in order, by the threads' names. Several may have one
    /// name, and each shuts its own doors.
    fn calls(&self) -> BTreeMap<String, Vec<Call>> {
        let mut threads: BTreeMap<String, Vec<Call>> = BTreeMap::new();
        for line in self.read("calls").lines() {
            let call = Call::of(line).unwrap_or_else(|| panic!("no call: {line}"));
            threads.entry(call.0).or_default().push(call.1);
        }
        let mut behind_doors: BTreeMap<String, Vec<Call>> = BTreeMap::new();
        let mut without = BTreeSet::new();
        for (thread, calls) in threads {
            let (name, _) = thread.rsplit_once('-').expect("a name, and a number");
            let mut calls = calls.into_iter();
            if calls.any(|call| call.number == libc::SYS_seccomp) {
                behind_doors.entry(name.to_owned()).or_default().extend(calls);
            } else {
                without.insert(name.to_owned());
            }
        }
        // Before a thread has its name, it has that of the one that started it.
        without.remove("takt");
        let odd = behind_doors.keys().find(|name| without.contains(*name));
        assert_eq!(odd, None, "no thread does without a filter");
        behind_doors
    }
}

/// A system call: number and arguments.
#[derive(Clone, Debug, PartialEq)]
struct Call {
    number: i64,
    arguments: Vec<u64>,
}

impl Call {
    /// From a line of the kernel's tracer, and the name of the thread with its number:
    /// `   plc-97    [000] .......     1.228700: sys_enter: NR 33 (b, 1, 0, 0, 0, 0)`
    fn of(line: &str) -> Option<(String, Call)> {
        let (thread, rest) = line.trim_start().split_once(" [")?;
        let (_, call) = rest.split_once("sys_enter: NR ")?;
        let (number, arguments) = call.trim_end().strip_suffix(')')?.split_once(" (")?;
        let arguments = arguments.split(", ").map(|hex| u64::from_str_radix(hex, 16));
        let arguments = arguments.collect::<Result<_, _>>().ok()?;
        Some((thread.trim_end().to_owned(), Call { number: number.parse().ok()?, arguments }))
    }

    /// Whether a rule of a list is about this call.
    fn fits(&self, rule: &Value) -> bool {
        let conditions = rule["args"].as_array().map(Vec::as_slice).unwrap_or_default();
        number(rule["syscall"].as_str().unwrap_or_default()) == self.number
            && conditions.iter().all(|condition| {
                let index = condition["index"].as_u64().unwrap_or(u64::MAX) as usize;
                let mask = condition["op"]["masked_eq"].as_u64().unwrap_or(u64::MAX);
                // The lists compare 32 bits.
                let found = self.arguments[index] as u32 & mask as u32;
                Some(found) == condition["val"].as_u64().map(|value| value as u32)
            })
    }
}

fn number(name: &str) -> i64 {
    macro_rules! numbers {
        ($($name:ident $number:ident),* $(,)?) => {
            match name {
                $(stringify!($name) => libc::$number,)*
                _ => panic!("the test does not know the number of {name}"),
            }
        };
    }
    numbers! {
        accept4 SYS_accept4, brk SYS_brk, clock_gettime SYS_clock_gettime,
        clock_nanosleep SYS_clock_nanosleep, close SYS_close, epoll_create1 SYS_epoll_create1,
        epoll_ctl SYS_epoll_ctl, getrandom SYS_getrandom, getsockopt SYS_getsockopt, newfstatat SYS_newfstatat, epoll_wait SYS_epoll_wait, exit SYS_exit,
        exit_group SYS_exit_group, fallocate SYS_fallocate, fcntl SYS_fcntl, fstat SYS_fstat, ftruncate SYS_ftruncate,
        futex SYS_futex, ioperm SYS_ioperm, getdents64 SYS_getdents64, getpid SYS_getpid, gettid SYS_gettid,
        ioctl SYS_ioctl, lseek SYS_lseek, madvise SYS_madvise, mmap SYS_mmap,
        mremap SYS_mremap, pwrite64 SYS_pwrite64,
        fdatasync SYS_fdatasync, munmap SYS_munmap, openat SYS_openat, poll SYS_poll,
        pread64 SYS_pread64, read SYS_read, recvfrom SYS_recvfrom,
        restart_syscall SYS_restart_syscall, rmdir SYS_rmdir,
        rt_sigprocmask SYS_rt_sigprocmask, rt_sigreturn SYS_rt_sigreturn, sched_yield SYS_sched_yield, sendto SYS_sendto,
        sigaltstack SYS_sigaltstack, statx SYS_statx, tgkill SYS_tgkill,
        timerfd_settime SYS_timerfd_settime, unlink SYS_unlink, wait4 SYS_wait4, write SYS_write,
    }
}

/// A list of `vmm/seccomp`.
fn list(name: &str) -> Vec<Value> {
    let path = root().join(format!("vmm/seccomp/{name}.json"));
    let text = fs::read_to_string(path).expect("the list is there");
    parse(&text).as_array().cloned().expect("a list is an array")
}

/// The list of a kind of thread, and the common one.
fn rules(kind: &str) -> Vec<Value> {
    [list(kind), list("common")].concat()
}

#[test]
fn the_doors_are_shut_and_trying_them_ends_the_process_with_safe_values() {
    let printed = target("tests").join("sandbox.printed");
    let _ = fs::remove_file(&printed);
    let device = format!("parallel={}", printed.display());
    let file = File::new("1ms")
        .plc("drive", Some(plc_image("outputs")), PRINTER)
        .plc("demo", None, "")
        .schedule("normal")
        .window("drive", 0, 200)
        .window("demo", 300, 300);
    // Those that a test has to be content with: one with safe values, and one that has no guest.
    let threads: &[&str] =
        if long() { &["drive", "demo", "kicker", "main"] } else { &["drive", "main"] };
    let looked = Looked::by(
        "sandbox",
        "sandbox",
        &file.save("sandbox"),
        &[plc_image("outputs")],
        &[&["ticks of a write", "1"], threads].concat(),
        &["--hooks", "--device", &device],
    );

    let guardian = looked.read("guardian");
    for line in ["CapPrm:\t0000000000020000", "CapEff:\t0000000000020000", "Seccomp:\t2"] {
        assert!(guardian.contains(line), "{guardian}");
    }
    // For want of memory the kernel ends all others first, then takt, then who writes its safe values.
    assert!(guardian.contains("\noom_score_adj: -1000\n"), "{guardian}");
    assert_eq!(looked.read("oom"), "-999\n");
    let all = ["main", "drive", "demo", "kicker-0", "plc-loader", "plc-loader", "console"];
    check_process(&looked.read("process"), &all);
    let calls = looked.calls();
    check_cycles(&calls["demo"]);
    // Process 1 keeps what it takes to use a port and to switch the machine off.
    let first = looked.read("first");
    for line in ["CapPrm:\t0000000000420000", "CapEff:\t0000000000420000", "NoNewPrivs:\t1"] {
        assert!(first.contains(line), "{first}");
    }

    // Where calls are only logged, this is the only one that the kernel has to tell of.
    assert_eq!(looked.read("log.status"), "0\n", "{}", looked.read("log"));
    let audit = looked.read("audit");
    let told = [" comm=\"drive\" ".to_owned(), format!(" syscall={} ", libc::SYS_getppid)];
    assert!(told.iter().all(|told| audit.contains(told)), "{audit}");
    assert_eq!(audit.lines().count(), 1, "{audit}");

    // Each thread was ended at the first call, and the last that was printed is the safe value.
    let printed = fs::read(&printed).expect("QEMU has written the file");
    let mut runs = printed.split(|byte| *byte == 0xa5).collect::<Vec<_>>();
    for thread in threads {
        let console = looked.read(thread);
        assert_eq!(looked.read(&format!("{thread}.status")), "5\n", "{console}");
        let who = if *thread == "kicker" { "kicker-0" } else { thread };
        let said = format!("takt: thread {who} made the system call {} at ", libc::SYS_getppid);
        assert!(console.contains(&said), "{console}");
        assert!(console.contains("safe values are written"), "{console}");
        assert!(console.contains("ticks of a write"), "the outputs were driven: {console}");
    }
    // Scans count from 0 in each of the runs, one of which is looked at and one logged, and their bytes pass 0xa5 every
    // 256.
    assert_eq!(runs.pop(), Some(&[][..]), "the last byte is the safe value");
    let starts = runs.iter().filter(|run| run.starts_with(&[0, 1, 2])).count();
    assert_eq!(
        starts,
        threads.len() + 2,
        "{:?}",
        runs.iter().map(|run| run.len()).collect::<Vec<_>>()
    );
}

/// With the wait of a processor whose Linux has ended the kernel goes on by a call of its own.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_takt_that_was_stopped_for_a_moment_goes_on() {
    let file = File::new("10ms")
        .plc("plc", None, "")
        .linux("poweroff -f")
        .schedule("normal")
        .window("plc", 0, 200)
        .save("stop-and-go");
    let outcome = [file.as_path(), &target("guest/vmlinuz"), &target("guest/initrd.img")]
        .iter()
        .fold(Host::new(), |host, path| host.with_file(path))
        .run("stop-and-go", &[&file.to_string_lossy(), "linux: partition-ended", "6"]);
    let console = fs::read_to_string(target("tests/stop-and-go.out/console")).unwrap_or_default();
    assert_eq!(outcome.status, 0, "{}\n{console}", outcome.output);
    // It lost what it was stopped for, a look of the script's, and no more.
    let [releases, lost] = ["releases", "lost"].map(|key| outcome.number("plc", key));
    let cycles = outcome.cycles(10_000);
    println!("{releases} releases, {lost} lost, of {cycles} cycles");
    assert!(lost <= 20 && releases + lost + 10 >= cycles, "{releases} {lost}\n{console}");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn nothing_is_in_a_list_without_being_called_or_a_reason() {
    let disk = target("tests/sandbox-lists.img");
    fs::create_dir_all(target("tests")).expect("the target folder is writable");
    fs::write(&disk, [0; 4096]).expect("the disk can be made");
    // A PLC that reaches for what is not its own, one that is started again, and so is Linux.
    let file = File::new("4ms")
        .plc("drive", Some(plc_image("outputs")), PRINTER)
        .plc("sweep", Some(plc_image("sweep")), "")
        .plc(
            "warm",
            Some(plc_image("failing-starts")),
            "restarts = { at_most = 1, within = \"60s\" }",
        )
        .linux(
            "dd if=/dev/vda of=/dev/null count=8; \
             dd if=/dev/zero of=/dev/vda count=8 conv=fsync; blkdiscard -l 4096 /dev/vda; reboot -f",
        )
        .lines("restarts = { at_most = 1, within = \"60s\" }")
        .lines(&format!("[[partition.disk]]\npath = {disk:?}\nread_only = false"))
        .health("warm", "numeric-error", "warm-start")
        .plc("never-done", Some(plc_image("never-done")), "")
        .health("linux", "partition-reset", "cold-start")
        .health("linux", "illegal-request", "log")
        .schedule("normal")
        .window("drive", 0, 200)
        .window("sweep", 400, 400)
        .window("warm", 1_000, 200)
        .window("never-done", 1_400, 100);
    let looked = Looked::by(
        "sandbox",
        "sandbox-lists",
        &file.save("sandbox-lists"),
        &["outputs", "sweep", "failing-starts", "never-done"]
            .map(plc_image)
            .into_iter()
            .chain(["guest/vmlinuz", "guest/initrd.img"].map(target))
            .chain([disk.clone()])
            .collect::<Vec<_>>(),
        &["ticks of a write", "8"],
        &[
            "--device",
            "parallel=/dev/null",
            "--memory",
            "512",
            "--program",
            env!("CARGO_BIN_EXE_talk"),
        ],
    );
    let calls = looked.calls();
    let threads = [
        ("main", &["takt"][..]),
        ("plc", &["drive", "sweep", "warm", "never-done"]),
        ("linux", &["linux"]),
        ("loader", &["loader"]),
        ("plc-loader", &["plc-loader"]),
        ("writer", &["console"]),
        ("reader", &[]),
        ("closer", &[]),
        ("saver", &[]),
        ("kicker", &["kicker-0"]),
        ("disk", &["disk-0"]),
        ("guardian", &["takt-guardian"]),
    ];
    let mut seen_of_common: Vec<Value> = Vec::new();
    let mut wrong = Vec::new();
    for (kind, names) in threads {
        let made: Vec<&Call> = names.iter().flat_map(|name| &calls[*name]).collect();
        let rules = rules(kind);
        let odd = made.iter().find(|call| !rules.iter().any(|rule| call.fits(rule)));
        assert_eq!(odd, None, "{kind}: in no list");
        for rule in rules {
            let seen = made.iter().any(|call| call.fits(&rule));
            let common = list("common").contains(&rule);
            if seen && common {
                seen_of_common.push(rule);
            } else if !seen && !common && !has_reason(&rule) {
                wrong.push(format!("{kind}: {rule}"));
            }
        }
    }
    for rule in list("common") {
        if !seen_of_common.contains(&rule) && !has_reason(&rule) {
            wrong.push(format!("common: {rule}"));
        }
    }
    assert!(wrong.is_empty(), "never called, and no reason:\n{}", wrong.join("\n"));
}

/// Whether a rule says why it is there though no test has it called.
fn has_reason(rule: &Value) -> bool {
    rule["comment"].as_str().is_some_and(|comment| comment.starts_with("Unseen: "))
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_start_that_fails_at_any_step_leaves_the_machine_as_it_was() {
    let file = root().join("configs/separate-cpus.toml");
    let files = ["vmlinuz", "initrd.img"].map(|name| root().join("target/guest").join(name));
    let options = ["--hooks", "--lane", "emulated", "--cpus", "2", "--memory", "768"];
    fail_at_each_step("failing-starts", &file, &files, &[], &options);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_start_that_fails_at_any_step_gives_devices_back() {
    // The card is its driver's, which has to give it away and gets it back.
    const CARD: &str = r#"
[[partition.port_io]]
ports = "0x2400-0x247f"
pci = "0000:00:10.0"
bar = 0
unbind = true

[[partition.interrupt]]
vector = 64
pci = "0000:00:10.0"
"#;
    const CHANNEL: &str = r#"
[[channel]]
name = "level"
kind = "sampling"
message_bytes = 8
source = "drive:level"
destinations = ["host:level"]
refresh_period = "1s"
host_socket = "/tmp/level.sock"
"#;
    let disk = target("tests/failing-starts.img");
    fs::create_dir_all(target("tests")).expect("the target folder is writable");
    fs::write(&disk, [0; 4096]).expect("the disk can be made");
    let file = File::new("1ms")
        .watchdog("5s")
        .plc("drive", Some(plc_image("outputs")), &format!("{CARD}{PRINTER}"))
        .linux("")
        .lines(&format!("[[partition.disk]]\npath = {disk:?}\nread_only = false"))
        .lines(CHANNEL)
        .schedule("normal")
        .window("drive", 0, 200)
        .save("failing-devices");
    let files = [plc_image("outputs"), disk, target("guest/vmlinuz"), target("guest/initrd.img")];
    let modules = ["kvaser_pci", "uio_pci_generic", "i6300esb"];
    let mut options = vec!["--hooks", "--memory", "512", "--device", "parallel=/dev/null"];
    options.extend(["--device", "can", "--device", "watchdog"]);
    options.extend(modules.iter().flat_map(|module| ["--module", module]));
    fail_at_each_step("failing-devices", &file, &files, &modules, &options);
}

/// Fails unless each start that fails leaves the machine as it was, and so does the run that does not.
fn fail_at_each_step(
    name: &str,
    file: &Path,
    files: &[PathBuf],
    modules: &[&str],
    options: &[&str],
) {
    let looked = Looked::by("failing-starts", name, file, files, modules, options);
    let steps = looked.read("steps");
    let (failed, status) = steps.trim().split_once(' ').expect("two numbers");
    assert_eq!(status, "0", "{}", looked.read(failed));
    let failed: u32 = failed.parse().expect("a number");
    assert!(failed >= 12, "{failed}");
    for step in 1..=failed {
        let shown = looked.read(&step.to_string());
        assert!(shown.contains("TEST: a step of the start has failed"), "{step}: {shown}");
        // No guest has said a word.
        assert!(!shown.contains("[plc]") && !shown.contains("Linux version"), "{step}: {shown}");
    }
}

/// What `/proc` tells of the process at work.
fn check_process(text: &str, threads: &[&str]) {
    let of = |key: &str| -> Vec<String> {
        let values = text.lines().filter_map(|line| line.strip_prefix(key));
        values.map(|value| value.trim().to_owned()).collect()
    };
    assert_eq!(of("Name:").len(), threads.len(), "{text}");
    for set in ["CapInh:", "CapPrm:", "CapEff:", "CapAmb:"] {
        assert!(of(set).iter().all(|set| set == "0000000000000000"), "{text}");
    }
    assert!(of("NoNewPrivs:").iter().all(|value| value == "1"), "{text}");
    // 2 is "by a filter".
    assert!(of("Seccomp:").iter().all(|value| value == "2"), "{text}");
    assert_eq!(of("Seccomp_filters:"), vec!["1"; threads.len()], "{text}");
    // 6 is SCHED_DEADLINE, for who has windows and who ends them. The supervisor thread was of a real-time
    // class while it prepared the run, and is of the ordinary one.
    let mut policies = of("policy:");
    policies.sort();
    assert_eq!(policies, ["0", "0", "0", "0", "6", "6", "6"], "{text}");
    assert!(text.contains("Max core file size        0                    0"), "{text}");

    // Another user can change neither, and cannot use the socket.
    assert_eq!(of("file:"), ["600 0 /tmp/takt.sock", "644 0 /out/report.json"], "{text}");

    let memory = of("guest memory: VmFlags:");
    assert!(!memory.is_empty() && memory.iter().all(|f| f.split(' ').any(|f| f == "dd")), "{text}");

    let mut descriptors: BTreeMap<String, usize> = BTreeMap::new();
    for descriptor in of("descriptor:") {
        let kind = descriptor.split([':', ' ']).take(2).collect::<Vec<_>>().join(":");
        let numbered = ["socket", "pipe"].into_iter().find(|kind| descriptor.starts_with(kind));
        let kind = numbered.map_or(kind, str::to_owned);
        *descriptors.entry(kind).or_default() += 1;
    }
    let expected = [
        ("/dev/null", 1),
        ("/out/console", 2),
        ("/out/report.json", 1),
        ("/sys/devices/system/clocksource/clocksource0/current_clocksource", 1),
        ("anon_inode:[eventfd]", 3),
        ("anon_inode:[eventpoll]", 1),
        ("anon_inode:[signalfd]", 1),
        ("anon_inode:[timerfd]", 2),
        ("anon_inode:kvm-vcpu", 2),
        ("anon_inode:kvm-vcpu-stats", 2),
        ("pipe", 1),
        ("socket", 1),
    ];
    let expected = expected.map(|(kind, count)| (kind.to_owned(), count));
    assert_eq!(descriptors, BTreeMap::from(expected), "{text}");
}

/// What a PLC's thread calls from one sleep to the next: only its guest, KVM's count, and the
/// next sleep, each once. Four times a second it also asks whether the guest's counter is the host's.
fn check_cycles(calls: &[Call]) {
    let of = |number: i64| calls.iter().filter(move |call| call.number == number);
    let sleeps = of(libc::SYS_clock_nanosleep).count();
    assert!(sleeps > 900, "{sleeps}");
    let cycles: Vec<&[Call]> =
        calls.split(|call| call.number == libc::SYS_clock_nanosleep).collect();
    // Before the first sleep the thread waits for the start, after the last for its end. The first sleep
    // is one in pieces, since the thread does not know the clock yet.
    let steady = &cycles[1..cycles.len() - 1];
    let pieces = steady.iter().take_while(|cycle| cycle.is_empty()).count();
    assert!(pieces <= 4, "{pieces}");
    const KVM_GET_DEVICE_ATTR: u64 = 0x4018_aee2;
    let asks =
        |call: &Call| call.number == libc::SYS_ioctl && call.arguments[1] == KVM_GET_DEVICE_ATTR;
    let (mut steady, mut asked) = (steady[pieces..].to_vec(), 0);
    for cycle in &mut steady {
        if let Some((_, before)) = cycle.split_last().filter(|(last, _)| asks(last)) {
            (*cycle, asked) = (before, asked + 1);
        }
    }
    assert!((1..=steady.len() / 250 + 1).contains(&asked), "{asked} of {}", steady.len());
    let plain = [libc::SYS_ioctl, libc::SYS_pread64];
    let is_plain = |cycle: &[Call]| {
        let numbers: Vec<i64> = cycle.iter().map(|call| call.number).collect();
        let (last, runs) = numbers.split_last().expect("a cycle has calls");
        // A console line is an exit more.
        *last == plain[1] && !runs.is_empty() && runs.iter().all(|number| *number == plain[0])
    };
    let odd = steady.iter().find(|cycle| !is_plain(cycle));
    assert_eq!(odd, None);
    let exactly_three = steady.iter().filter(|cycle| cycle.len() == 2).count();
    assert!(exactly_three * 100 > steady.len() * 98, "{exactly_three} of {}", steady.len());
}
