//! Each file in `partition_files/` has one defect and is named after it; the `.err` beside it is
//! the exact message. Files whose name starts with `good-` have none. The examples in `configs/`
//! must be good too.
//!
//! `UPDATE_EXPECT=1 cargo test -p takt --test partition_files` writes the `.err` files anew; read
//! the difference before you keep it.

use std::fs;
use std::path::{Path, PathBuf};

use takt::config::{self, Kind};
use takt::{check, config::PartitionFile};

/// How a user in the package's folder would name the fixtures.
const FOLDER: &str = "tests/partition_files";
/// CPUs of the machine that the fixtures are for.
const HOST_CPUS: Option<usize> = Some(2);

fn toml_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|e| e == "toml")).collect();
    files.sort();
    files
}

fn is_good(path: &Path) -> bool {
    path.file_name().unwrap().to_str().unwrap().starts_with("good-")
}

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
    let mut count = 0;
    for path in toml_files(Path::new(FOLDER)).into_iter().filter(|path| !is_good(path)) {
        count += 1;
        let expectation = path.with_extension("err");
        let Some(found) = message(&path) else {
            failures.push(format!("{}: no defect found", path.display()));
            continue;
        };
        if update {
            fs::write(&expectation, &found).unwrap();
            continue;
        }
        let expected = fs::read_to_string(&expectation).unwrap_or_default();
        if found != expected {
            failures.push(format!("{}\nexpected:\n{expected}found:\n{found}", path.display()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert!(count >= 40, "the fixtures are gone: {count} left");
}

#[test]
fn good_files_are_good() {
    for path in toml_files(Path::new(FOLDER)).into_iter().filter(|path| is_good(path)) {
        assert_eq!(message(&path), None);
    }
}

#[test]
fn no_expectation_is_left_without_its_file() {
    for entry in fs::read_dir(FOLDER).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "err") {
            assert!(path.with_extension("toml").exists(), "{}", path.display());
        }
    }
}

#[test]
fn each_message_shows_the_place_and_what_is_allowed() {
    for path in toml_files(Path::new(FOLDER)).into_iter().filter(|path| !is_good(path)) {
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
    let path = Path::new(FOLDER).join("cpu-that-this-machine-lacks.toml");
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

/// An empty folder of this test's own: tests run side by side, each in a thread of its name.
fn scratch(name: &str) -> PathBuf {
    let test = std::thread::current().name().unwrap_or("main").to_owned();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// An example, with empty files where it expects the images that `scripts/guest-image` makes.
fn example(name: &str) -> (PathBuf, PartitionFile) {
    let folder = scratch(&format!("example-{name}"));
    let images = folder.join("target/guest");
    fs::create_dir_all(&images).unwrap();
    fs::create_dir(folder.join("configs")).unwrap();
    fs::write(images.join("vmlinuz"), "").unwrap();
    fs::write(images.join("initrd.img"), "").unwrap();
    let path = folder.join("configs").join(name);
    fs::copy(Path::new("../configs").join(name), &path).unwrap();
    let file = config::load(&path, None).unwrap_or_else(|error| panic!("{error}"));
    (folder.canonicalize().unwrap(), file)
}

#[test]
fn every_example_is_good_and_says_what_it_shows() {
    for path in toml_files(Path::new("../configs")) {
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
    assert_eq!(file.path(), folder.join("configs/plc-and-linux.toml"));
    assert_eq!(file.schedule_name(), "normal");
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
        file.partitions().iter().map(|p| file.table().guaranteed(p.id()).0).collect();
    assert_eq!(own, [300_000, 680_000]);
}

#[test]
fn the_report_draws_the_schedule_and_says_what_each_partition_gets() {
    let (_, file) = example("plc-and-linux.toml");
    let expected = r#"plc-and-linux: schedule "normal", major frame 1ms

CPU 0
         0us             250us           500us           750us           1ms
         |               |               |               |               |
  plc    ####################                                          <<
  linux                     --------------------------------------------
  reserved: 42.9 % of this CPU, of at most 90.0 %; 20us every 340us to end windows

# window   < release guard   - background

partition  kind   cpu  memory  runs        own time per frame  share   guard  SCHED_DEADLINE
plc        plc    0    4MiB    1 window    300us               30.0 %  20us   370us every 1ms
linux      linux  0    256MiB  background  680us               68.0 %  -      -
"#;
    assert_eq!(check::report(&file), expected);
}

#[test]
fn the_report_shows_every_cpu_and_windows_shorter_than_a_column() {
    let path = Path::new(FOLDER).join("good-two-cpus.toml");
    let file = config::load(&path, HOST_CPUS).unwrap_or_else(|error| panic!("{error}"));
    let expected = r#"two-cpus: schedule "normal", major frame 10ms

CPU 0
         0us             2500us          5ms             7500us          10ms
         |               |               |               |               |
  fast   #                              <#                              <
  linux  ----------------------------------------------------------------
  reserved: 3.3 % of this CPU, of at most 90.0 %; 20us every 2465us to end windows

CPU 1
         0us             2500us          5ms             7500us          10ms
         |               |               |               |               |
  slow                    <<#################
  reserved: 28.1 % of this CPU, of at most 90.0 %; 20us every 3650us to end windows

# window   < release guard   - background

partition  kind   cpu  memory   runs        own time per frame  share   guard  SCHED_DEADLINE
fast       plc    0    1028KiB  2 windows   100us               1.0 %   20us   120us every 5ms
slow       plc    1    4MiB     1 window    2500us              25.0 %  200us  2750us every 10ms
linux      linux  0    64MiB    background  9860us              98.6 %  -      -
"#;
    assert_eq!(check::report(&file), expected);
}

#[test]
fn needs_are_lines_for_a_script() {
    let (folder, file) = example("plc-and-linux.toml");
    let folder = folder.display();
    let expected = format!(
        "memory 272629760\ncpus 1\nfile {folder}/configs/plc-and-linux.toml\n\
         file {folder}/target/guest/vmlinuz\nfile {folder}/target/guest/initrd.img\n"
    );
    assert_eq!(check::needs(&file), expected);
}
