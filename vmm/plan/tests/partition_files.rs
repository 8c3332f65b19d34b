//! Each file below `partition_files/` has one defect, is named after it, and ends with the exact message
//! (`fixtures/mod.rs`). The examples in `configs/` and those in `good/` must be good.
//!
//! `UPDATE_EXPECT=1 cargo test -p takt-plan --test partition_files` writes the messages anew; read the difference
//! before you keep it.

mod fixtures;
mod guest_images;

use std::fs;
use std::path::{Path, PathBuf};

use fixtures::{Defect, FOLDER, defects, toml_files};
use takt_plan::{self as config, HugePages, Kind, ScheduleChange};
use takt_plan::{PartitionFile, check};
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::Nanos;

/// CPUs of the machine that the fixtures are for.
const HOST_CPUS: Option<usize> = Some(2);

/// The message, without what differs from checkout to checkout.
fn message(path: &Path) -> Option<String> {
    let absolute = Path::new(FOLDER).canonicalize().unwrap();
    let error = config::load(path, HOST_CPUS).err()?;
    Some(format!("{error}\n").replace(absolute.to_str().unwrap(), "$FOLDER"))
}

#[test]
fn each_defect_has_its_message() {
    let update = std::env::var_os("UPDATE_EXPECT").is_some();
    let mut failures = Vec::new();
    let defects = defects(Path::new(FOLDER));
    for defect in &defects {
        let path = defect.path.display();
        let Some(found) = message(&defect.path) else {
            failures.push(format!("{path}: no defect found"));
            continue;
        };
        if update {
            defect.expect(&found);
            continue;
        }
        let expected = defect.message();
        if found != expected {
            failures.push(format!("{path}\nexpected:\n{expected}found:\n{found}"));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert!(defects.len() >= 300, "the fixtures are gone: {} left", defects.len());
}

#[test]
fn good_files_are_good() {
    let good = toml_files(&Path::new(FOLDER).join("good"));
    assert!(good.len() >= 10, "the fixtures are gone: {} left", good.len());
    for path in good {
        assert_eq!(message(&path), None);
    }
}

#[test]
fn no_expectation_is_left_without_its_file() {
    let defects = defects(Path::new(FOLDER));
    for topic in fs::read_dir(FOLDER).unwrap().map(|entry| entry.unwrap().path()) {
        let files = topic.read_dir().into_iter().flatten().map(|entry| entry.unwrap().path());
        for path in files.filter(|path| path.extension().is_some_and(|e| e == "err")) {
            let of = path.with_extension("toml");
            assert!(defects.iter().any(|defect| defect.path == of), "{}", path.display());
        }
    }
}

#[test]
fn each_message_shows_the_place_and_what_is_allowed() {
    for Defect { path, .. } in defects(Path::new(FOLDER)) {
        let found = message(&path).unwrap();
        let lines: Vec<&str> = found.lines().collect();
        assert!(lines[0].starts_with(&format!("error: {}:", path.display())), "{found}");
        assert!(lines.iter().any(|line| line.contains('^')), "{found}");
        assert!(lines.last().unwrap().contains(" = allowed: "), "{found}");
        assert!(!found.contains(|c: char| c.is_control() && c != '\n'), "{found:?}");
    }
}

#[test]
fn a_cpu_is_only_looked_for_on_the_machine_that_the_file_is_for() {
    let path = Path::new(FOLDER).join("partitions/cpu-that-this-machine-lacks.toml");
    assert!(config::load(&path, Some(2)).is_err());
    assert!(config::load(&path, Some(3)).is_ok());
    assert!(config::load(&path, None).is_ok());
}

#[test]
fn what_is_not_a_small_regular_file_is_not_read() {
    let error = |path: &Path| config::load(path, None).unwrap_err().to_string();
    assert!(
        error(Path::new("/no/such.toml")).starts_with("error: /no/such.toml: cannot be read: ")
    );
    assert!(error(Path::new(FOLDER)).contains("not a regular file"));
    let folder = scratch("large");
    let large = folder.join("large.toml");
    fs::write(&large, "#".repeat(config::FILE_MAX as usize + 1)).unwrap();
    assert!(error(&large).contains("at most 1048576 bytes"), "{}", error(&large));
}

#[test]
fn the_budget_that_is_proposed_for_a_late_task_is_the_largest_that_is_in_time() {
    let text = fs::read_to_string(Path::new(FOLDER).join("tasks/task-misses.toml")).unwrap();
    let with = |budget: &str| {
        let path = scratch(budget).join("case.toml");
        fs::write(&path, text.replace("500us", budget)).unwrap();
        config::load(&path, None).err().map(|error| error.to_string())
    };
    assert!(with("500us").unwrap().contains("a budget of at most 376us;"));
    assert_eq!(with("376us"), None);
    assert!(with("377us").unwrap().contains("misses its deadline"));
}

#[test]
fn the_number_of_schedules_and_of_tasks_is_looked_at_before_their_names() {
    for (file, last, first, expected) in [
        ("schedule/seventeen-schedules.toml", "\"s16\"", "\"s0\"", "there are 17 schedules"),
        ("tasks/sixty-five-tasks.toml", "\"t64\"", "\"t0\"", "this is task 65 of 65"),
    ] {
        let text = fs::read_to_string(Path::new(FOLDER).join(file)).unwrap();
        let path = scratch("names").join("case.toml");
        fs::write(&path, text.replace(last, first)).unwrap();
        let error = config::load(&path, None).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// An empty folder of this test's own: tests run side by side, each in a thread of its name.
fn scratch(name: &str) -> PathBuf {
    let test = std::thread::current().name().unwrap_or("main").to_owned();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn the_images_beside_the_fixtures_are_those_of_the_tests() {
    let images = [
        ("dummy-kernel", guest_images::kernel()),
        ("dummy-plc", guest_images::plc()),
        ("dummy-program", guest_images::program(&[])),
        ("dummy-caller", guest_images::program(&["called"])),
    ];
    for (name, bytes) in images {
        let path = Path::new(FOLDER).join(name);
        if std::env::var_os("UPDATE_EXPECT").is_some() {
            fs::write(&path, &bytes).unwrap();
        }
        assert!(fs::read(&path).unwrap() == bytes, "{name}");
    }
}

/// An example, with dummies where it expects the images that `scripts/guest-image` makes, and those of the PLC guests,
/// programs with the points of the examples', and disks of one sector for that of `scripts/load-image` and a Debian's.
/// The folder's name is short, as a control socket's path has to be.
fn example(name: &str) -> (tempfile::TempDir, PartitionFile) {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let images = folder.join("target/guest");
    let plc_images = folder.join("plc-guest/target/x86_64-unknown-linux-gnu/release");
    fs::create_dir_all(&images).unwrap();
    fs::create_dir_all(&plc_images).unwrap();
    fs::create_dir(folder.join("configs")).unwrap();
    fs::write(images.join("vmlinuz"), guest_images::kernel()).unwrap();
    fs::write(images.join("initrd.img"), "").unwrap();
    fs::write(images.join("load.img"), [0; 512]).unwrap();
    for debian in ["target/debian", "target/hmi"].map(|name| folder.join(name)) {
        fs::create_dir_all(&debian).unwrap();
        fs::write(debian.join("vmlinuz"), guest_images::kernel()).unwrap();
        fs::write(debian.join("initrd.img"), "").unwrap();
        fs::write(debian.join("disk.img"), [0; 512]).unwrap();
    }
    fs::write(plc_images.join("can"), guest_images::plc()).unwrap();
    fs::write(plc_images.join("outputs"), guest_images::plc()).unwrap();
    let examples = folder.join("target/examples");
    fs::create_dir_all(&examples).unwrap();
    fs::write(examples.join("tank.plc"), guest_images::tank()).unwrap();
    fs::write(examples.join("plant.plc"), guest_images::plant()).unwrap();
    fs::write(examples.join("drive.plc"), guest_images::drive()).unwrap();
    fs::write(examples.join("motor.plc"), guest_images::motor()).unwrap();
    let path = folder.join("configs").join(name);
    fs::copy(Path::new("../../configs").join(name), &path).unwrap();
    let file = config::load(&path, None).unwrap_or_else(|error| panic!("{error}"));
    (temporary, file)
}

#[test]
fn every_example_is_good_and_says_what_it_shows() {
    for path in toml_files(Path::new("../../configs")) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let (_, file) = example(name);
        assert_eq!(format!("{}.toml", file.name()), name);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# "), "{name} does not open with what it shows");
    }
}

#[test]
fn a_good_file_says_what_is_in_it() {
    let (folder, file) = example("plc-and-linux.toml");
    let folder = folder.path().canonicalize().unwrap();
    assert_eq!(file.path(), folder.join("configs/plc-and-linux.toml"));
    assert_eq!(file.schedule_names(), ["normal"]);
    let [plc, linux] = file.partitions() else { panic!("{file:?}") };
    assert_eq!((plc.id().0, plc.name(), plc.cpu().0), (0, "plc", 0));
    assert_eq!((plc.memory_bytes(), plc.kind()), (4 << 20, &Kind::Plc { image: None }));
    assert_eq!((linux.id().0, linux.name(), linux.memory_bytes()), (1, "linux", 256 << 20));
    let kind = Kind::Linux {
        kernel: folder.join("target/guest/vmlinuz"),
        initrd: Some(folder.join("target/guest/initrd.img")),
        cmdline: "console=ttyS0".to_owned(),
    };
    assert_eq!(linux.kind(), &kind);
    let own: Vec<u64> =
        file.partitions().iter().map(|p| file.schedules().guaranteed(p.id()).0).collect();
    assert_eq!(own, [300_000, 650_000]);
}

#[test]
fn a_good_file_says_what_its_tasks_and_schedules_are() {
    let path = Path::new(FOLDER).join("good/schedules-and-tasks.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(file.schedule_names(), ["day", "night"]);
    let counts = |id: ScheduleId| {
        let table = &file.schedules().tables()[id.0];
        let windows = file.partitions().iter().map(|p| table.windows_of(p.id()).count());
        windows.collect::<Vec<_>>()
    };
    let (day, night) = (ScheduleId(0), ScheduleId(1));
    assert_eq!((counts(day), counts(night)), (vec![4, 1, 0, 1], vec![8, 0, 0, 0]));

    let [fast, slow, linux, other] = file.partitions() else { panic!("{file:?}") };
    let changes = [fast, slow, linux, other].map(|p| p.on_schedule_change());
    use ScheduleChange as C;
    assert_eq!(changes, [C::Warm, C::Cold, C::Ignore, C::Ignore]);
    let names: Vec<&str> = fast.tasks().iter().map(|task| &*task.name).collect();
    assert_eq!(names, ["control", "logging"]);
    assert_eq!(fast.tasks()[0].task.priority, 255);
    assert!(other.tasks().is_empty() && other.met_in(day).is_none());
    assert!(slow.met_in(day).is_some() && slow.met_in(night).is_none());
    // Each window of 200 us loses the 5 us of the allowance that the guard of 15 us leaves, and 48 us for
    // interrupts: one of the tick, two of the Linux beside it, two of the window enforcer and the thread of `slow`, and a look at the
    // clock, since the window of `slow` follows one of these closely.
    assert_eq!(fast.met_in(day).unwrap().load.permille(), 647);
    assert_eq!(fast.met_in(night).unwrap().schedule, night);
}

#[test]
fn a_good_file_says_what_of_its_programs_is_seen_and_forced_from_outside() {
    let path = Path::new(FOLDER).join("good/watch-and-force.toml");
    let file = config::load(&path, HOST_CPUS).unwrap();
    let programs = file.partitions()[0].programs().iter();
    let outside: Vec<_> = programs.map(|p| (p.watch.0, p.allow_force)).collect();
    assert_eq!(outside, [(60 << 10, true), (0, false), (1 << 10, false)]);
    let report = check::report(&file);
    let told: Vec<&str> = report.lines().filter(|line| line.contains("from outside")).collect();
    assert_eq!(told.len(), 4, "{report}");
    assert!(told[0].contains("60KiB in a cycle, may be written and forced"), "{}", told[0]);
    assert!(told[1].contains("0 bytes in a cycle, read only"), "{}", told[1]);
    assert!(told[2].contains("1KiB in a cycle, read only"), "{}", told[2]);
    // 62,464 bytes, 952 in a step.
    assert!(told[3].contains("61KiB in a cycle, in at most 66 steps"), "{}", told[3]);
}

#[test]
fn a_schedule_in_which_a_partition_has_no_time_is_not_analysed() {
    let (_, file) = example("two-schedules.toml");
    let report = check::report(&file);
    assert_eq!(report.matches("tasks of mixer").count(), 2, "{report}");
    assert_eq!(report.matches("tasks of packer").count(), 1, "{report}");
}

#[test]
fn the_report_fits_a_terminal_of_100_columns_and_is_ascii() {
    for path in toml_files(Path::new("../../configs")) {
        let (_, file) = example(path.file_name().unwrap().to_str().unwrap());
        for line in check::report(&file).lines() {
            assert!(line.is_ascii() && line.len() <= 100, "{}: {line}", file.name());
        }
    }
}

#[test]
fn the_report_says_where_the_clock_cannot_be_looked_at() {
    let said = |name: &str| {
        let file = config::load(&Path::new(FOLDER).join(name), HOST_CPUS).unwrap();
        check::report(&file).contains("no room to look at the clock")
    };
    assert!(said("good/plc-with-little-room.toml") && !said("good/plc-alone.toml"));
}

#[test]
fn the_report_shows_which_linuxes_are_reached_without_a_network() {
    let path = Path::new(FOLDER).join("good/vsock.toml");
    let file = config::load(&path, HOST_CPUS).unwrap();
    let numbers: Vec<Option<u32>> =
        file.partitions().iter().map(|p| p.vsock().map(|cid| cid.0)).collect();
    assert_eq!(numbers, [None, Some(4_294_967_294), Some(3)]);
    let report = check::report(&file);
    let shown = "\nsockets to the host (vsock)\n  linux: CID 4294967294\n  other: CID 3\n";
    assert!(report.contains(shown), "{report}");
    let (_, without) = example("plc-and-linux.toml");
    assert!(!check::report(&without).contains("vsock"));
}

#[test]
fn the_report_draws_the_schedule_and_says_what_each_partition_gets() {
    let (_, file) = example("plc-and-linux.toml");
    let expected = r#"plc-and-linux: major frame 1ms

Schedule "normal"

CPU 0
         0us             250us           500us           750us           1ms
         |               |               |               |               |
  plc    ####################                                          <<
  linux                     --------------------------------------------

# window   < release guard   - background

partition  runs        own time per frame  share
plc        1 window    300us               30.0 %
linux      background  650us               65.0 %

tasks of plc: they may ask for 200us of the 276us that its windows give in 1ms: 72.5 %
  6us of each window are kept for the host's tick (1 x 6us)
  12us of each window are kept for timers of a Linux that Takt cannot place (2 x 6us)
  6us of each window are kept for the kernel's timers for the bandwidth of threads (1 x 6us)
  task     period  budget  priority  worst response  verdict
  control  1ms     200us   1         224us           meets, 776us of 1ms to spare (exact)

partition  kind   cpu  memory  guard  switch  least own time  SCHED_DEADLINE
plc        plc    0    4MiB    20us   ignore  300us, 30.0 %   370us every 1ms
linux      linux  0    256MiB  -      -       650us, 65.0 %   -

CPU 0: 42.9 % reserved, of at most 90.0 %; 20us every 340us to end windows
"#;
    assert_eq!(check::report(&file), expected);
}

#[test]
fn each_processor_of_a_linux_is_drawn_on_its_cpu_and_has_its_share() {
    let (_, file) = example("several-processors.toml");
    let report = check::report(&file);
    for line in [
        "  linux  ----------------------------------------------------------------",
        "linux on CPU 0  background  650us               65.0 %",
        "linux on CPU 1  background  1ms                 100.0 %",
        "linux      linux  0, 1  256MiB  -      -       1650us, 165.0 %  -",
    ] {
        assert!(report.lines().any(|shown| shown == line), "{line}\n{report}");
    }
    let needs = check::needs(&file);
    assert!(needs.lines().any(|line| line == "cpus 2"), "{needs}");
    // What they share with another Linux they have a part of.
    let path = Path::new(FOLDER).join("good/linux-with-two-processors.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let report = check::report(&file);
    for line in [
        "linux on CPU 1  background of 2  500us               50.0 %",
        "second          background of 2  500us               50.0 %",
        "CPU 1: linux, second share what windows leave; each of their 2 threads weighs the same",
    ] {
        assert!(report.lines().any(|shown| shown == line), "{line}\n{report}");
    }
}

#[test]
fn a_guard_that_follows_the_host_is_as_wide_as_the_gaps_allow_and_loses_what_its_shortest_does() {
    let path = Path::new(FOLDER).join("good/auto-guard.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let report = check::report(&file);
    let guards = [
        "narrow     plc   0    4MiB    auto, 15us  ",
        "wide       plc   0    4MiB    auto, 40us  ",
    ];
    for line in guards {
        assert!(report.contains(line), "{report}");
    }
    assert!(report.contains("  12us of each window are kept for a wake-up"), "{report}");
}

#[test]
fn the_report_shows_every_cpu_and_windows_shorter_than_a_column() {
    let path = Path::new(FOLDER).join("good/two-cpus.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let expected = r#"two-cpus: major frame 10ms

Schedule "normal"

CPU 0
         0us             2500us          5ms             7500us          10ms
         |               |               |               |               |
  fast   #                              <#                              <
  linux  ----------------------------------------------------------------

CPU 1
         0us             2500us          5ms             7500us          10ms
         |               |               |               |               |
  slow                    <<#################

# window   < release guard   - background

partition  runs        own time per frame  share
fast       2 windows   100us               1.0 %
slow       1 window    2500us              25.0 %
linux      background  9800us              98.0 %

partition  kind   cpu  memory   guard  switch  least own time  SCHED_DEADLINE
fast       plc    0    1028KiB  20us   ignore  100us, 1.0 %    120us every 5ms
slow       plc    1    4MiB     200us  ignore  2500us, 25.0 %  2750us every 10ms
linux      linux  0    64MiB    -      -       9800us, 98.0 %  -

CPU 0: 4.5 % reserved, of at most 90.0 %; 50us every 2465us to end windows
CPU 1: 28.9 % reserved, of at most 90.0 %; 50us every 3650us to end windows
fast: no tasks given: not analysed
slow: no tasks given: not analysed
"#;
    assert_eq!(check::report(&file), expected);
}

#[test]
fn the_report_shows_what_of_shared_hardware_the_host_must_have() {
    let path = Path::new(FOLDER).join("good/hardware.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let expected = "
shared hardware, without which the run does not start
  plc
    memory: 2 huge pages of 2MiB
    cache: 4 ways of the L3 cache of CPU 0 for itself
  linux
    memory: 2 huge pages of 1GiB
    memory bandwidth: 30 % at most
    bus locks: at most 10 times within 1s
";
    let report = check::report(&file);
    assert!(report.ends_with(expected), "{report}");
    // What is had if the host has it is nothing that a host must have.
    let (_, usual) = example("plc-and-linux.toml");
    assert_eq!(usual.partitions()[0].hardware().huge_pages, HugePages::None);
    assert_eq!(usual.partitions()[1].hardware().huge_pages, HugePages::Auto);
}

#[test]
fn the_report_shows_every_schedule_and_how_its_tasks_fare() {
    let path = Path::new(FOLDER).join("good/schedules-and-tasks.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let expected = r#"schedules-and-tasks: major frame 4ms

Schedule "day", which holds at the start

CPU 0
         0us             1ms             2ms             3ms             4ms
         |               |               |               |               |
  fast   ####           <####           <####           <####           <
  slow                                      <#####
  linux     -------------   -------------        --------   -------------

CPU 1
         0us             1ms             2ms             3ms             4ms
         |               |               |               |               |
  other                 <################

# window   < release guard   - background

partition  runs        own time per frame  share
fast       4 windows   800us               20.0 %
slow       1 window    260us               6.5 %
linux      background  2710us              67.7 %
other      1 window    1ms                 25.0 %

tasks of fast: they may ask for 8208001ms of the 12700800ms that its windows give in 86400s: 64.7 %
  6us of each window are kept for the host's tick (1 x 6us)
  12us of each window are kept for timers of a Linux that Takt cannot place (2 x 6us)
  12us of each window are kept for the kernel's timers for the bandwidth of threads (2 x 6us)
  18us of each window are kept for looks of the window enforcer at the clock (3 x 6us)
  5us of each window are kept for a wake-up that the guard has no room for
  task     period  budget  priority  worst response  verdict
  control  1ms     95us    255       996us           meets, 4us of 1ms to spare (bound)
  logging  86400s  1ms     0         20956us         meets, 86399979044us of 86400s to spare (bound)

tasks of slow: they may ask for 450us of the 460us that its windows give in 8ms: 97.9 %
  6us of each window are kept for the host's tick (1 x 6us)
  12us of each window are kept for timers of a Linux that Takt cannot place (2 x 6us)
  12us of each window are kept for the kernel's timers for the bandwidth of threads (2 x 6us)
  task     period  budget  priority  worst response  verdict
  heating  8ms     450us   7         6500us          meets, 1500us of 8ms to spare (exact)

Schedule "night"

CPU 0
         0us             1ms             2ms             3ms             4ms
         |               |               |               |               |
  fast   ###    <###    <###    <###    <###    <###    <###    <###    <
  slow
  linux    ------  ------  ------  ------  ------  ------  ------  ------

CPU 1
         0us             1ms             2ms             3ms             4ms
         |               |               |               |               |
  other

# window   < release guard   - background

partition  runs        own time per frame  share
fast       8 windows   1200us              30.0 %
slow       not at all  0us                 0.0 %
linux      background  2440us              61.0 %
other      not at all  0us                 0.0 %

tasks of fast: they may ask for 8208001ms of the 16761600ms that its windows give in 86400s: 49.0 %
  6us of each window are kept for the host's tick (1 x 6us)
  12us of each window are kept for timers of a Linux that Takt cannot place (2 x 6us)
  12us of each window are kept for the kernel's timers for the bandwidth of threads (2 x 6us)
  18us of each window are kept for looks of the window enforcer at the clock (3 x 6us)
  5us of each window are kept for a wake-up that the guard has no room for
  task     period  budget  priority  worst response  verdict
  control  1ms     95us    255       546us           meets, 454us of 1ms to spare (bound)
  logging  86400s  1ms     0         10959us         meets, 86399989041us of 86400s to spare (bound)

Whichever schedule holds

partition  kind   cpu  memory  guard  switch  least own time  SCHED_DEADLINE
fast       plc    0    4MiB    15us   warm    800us, 20.0 %   265us every 500us
slow       plc    0    4MiB    20us   cold    0us, 0.0 %      330us every 4ms
linux      linux  0    64MiB   -      -       2440us, 61.0 %  -
other      plc    1    4MiB    20us   ignore  0us, 0.0 %      1070us every 4ms

CPU 0: 75.4 % reserved, of at most 90.0 %; 20us every 142500ns to end windows
CPU 1: 28.9 % reserved, of at most 90.0 %; 30us every 1490us to end windows
other: no tasks given: not analysed
"#;
    assert_eq!(check::report(&file), expected);
}

#[test]
fn the_documentation_shows_the_report_that_is_really_printed() {
    let page = fs::read_to_string("../../docs/partition-file.md").unwrap();
    let (_, file) = example("two-schedules.toml");
    let report = check::report(&file);
    assert!(page.contains(&format!("```text\n{report}```")), "{report}");
}

#[test]
fn a_linux_in_the_background_shares_with_the_loader_of_one_with_windows() {
    let text = fs::read_to_string(Path::new(FOLDER).join("good/task-behind-another-window.toml"));
    let other = "[[partition]]\nname = \"other\"\nkind = \"linux\"\ncpu = 0\nbackground = true\nconsole = \"control\"\n\
                 memory = \"64MiB\"\nkernel = \"dummy-kernel\"\n\n[[schedule]]\n";
    let folder = tempfile::tempdir().unwrap();
    fs::copy(Path::new(FOLDER).join("dummy-kernel"), folder.path().join("dummy-kernel")).unwrap();
    let path = folder.path().join("shared.toml");
    let text = text.unwrap().replace("../dummy-kernel", "dummy-kernel").replace("50us", "30us");
    let text = text.replace("name = \"s\"", "name = \"s\"\ncontrol = \"/run/takt.sock\"");
    fs::write(&path, text.replace("[[schedule]]\n", other)).unwrap();
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let table = &file.schedules().tables()[0];
    let other = file.partitions()[2].id();
    let left = table.left_on(Cpu(0));
    assert_eq!(file.own_time(table, other), Nanos(left.0 / 2));
}

#[test]
fn needs_are_lines_for_a_script() {
    let (folder, file) = example("plc-and-linux.toml");
    let folder = folder.path().canonicalize().unwrap();
    let folder = folder.display();
    let expected = format!(
        "memory 272629760\ncpus 1\nfile {folder}/configs/plc-and-linux.toml\n\
         file {folder}/target/guest/vmlinuz\nfile {folder}/target/guest/initrd.img\n"
    );
    assert_eq!(check::needs(&file), expected);
}
