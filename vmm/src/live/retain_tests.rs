//! Which values are kept, and when they are handed over.

use std::fs;
use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;

use takt_abi::live::SampleHead;
use takt_plan::Admission;
use takt_program::build::{Builder, Task, Variable};
use takt_program::{CodeOffset, Elementary, Flags, Nanoseconds};

use super::*;
use crate::boot::programs::Programs;
use crate::config::{self, PartitionFile};
use crate::memory::{GuestMemory, Pages};
use crate::saver::Files;

/// A partition with a program of one RETAIN variable, whose values go to a file.
fn plant(name: &str) -> PartitionFile {
    let folder = PathBuf::from(env!("OUT_DIR")).join(format!("retain-{name}"));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let mut image = Builder::new("a");
    image.code = vec![0xc3];
    image.state_bytes = 8;
    let ty = image.elementary(Elementary::Ulint);
    image.variable(Variable::new("n", ty, takt_program::Area::State, 0).with(Flags::RETAIN));
    image.task(Task {
        budget: Some(Nanoseconds(10_000)),
        ..Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0))
    });
    fs::write(folder.join("a.plc"), image.build().unwrap()).unwrap();
    let text = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"a.plc\"\nretain = \"kept\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";
    fs::write(folder.join("case.toml"), text).unwrap();
    config::load(&folder.join("case.toml"), None).unwrap()
}

fn retaining(file: &PartitionFile, files: &Files) -> Retaining {
    let partition = &file.partitions()[0];
    let number = |place| files.beginning(partition, place).and_then(|b| b.file);
    Retaining::of(partition.programs(), number)
}

fn sampled(cycle: u64, unsettled: u16, bytes: &[u8]) -> Sampled {
    let head = SampleHead { cycle, unsettled, ..SampleHead::default() };
    Sampled { client: OWN_CLIENTS, head, missed: 0, bytes: bytes.to_vec() }
}

/// A window at each step of this time.
fn run(retaining: &mut Retaining, ms: Range<u64>, step: usize, news: &mut Vec<String>) {
    ms.step_by(step).for_each(|ms| retaining.save(None, ms, at(ms), news));
}

fn at(ms: u64) -> Nanos {
    Nanos::from_millis(ms)
}

/// The orders and budgets of a partition that retains and is watched.
fn watch(retaining: &mut Retaining, file: &PartitionFile) -> Vec<String> {
    let programs = file.partitions()[0].programs();
    let limits: Vec<ProgramLimits> = programs.iter().map(ProgramLimits::new).collect();
    let (changes, mut watching, mut news) =
        (ProgramChanges::of(programs, Admission::default()), Watching::default(), Vec::new());
    retaining.watch(&mut watching, &limits, &changes, &mut news);
    news
}

fn spawn(
    _: &str,
    _: crate::sandbox::Kind,
    work: Box<dyn FnOnce() + Send>,
) -> Result<(), crate::vcpu::thread::ThreadError> {
    std::thread::spawn(work);
    Ok(())
}

#[test]
fn only_whole_values_of_one_cycle_are_kept() {
    let file = plant("whole");
    let mut retaining = retaining(&file, &Files::default());
    let partition = &file.partitions()[0];
    let programs = Programs::of(partition).unwrap();
    let bytes = partition.memory_bytes();
    let memory = GuestMemory::for_plc_with_programs(bytes, Pages::Small, &[]).unwrap();
    let banks = Banks { memory, programs };
    let restored = |banks: &Banks| {
        let table = banks.programs.load(&banks.memory, crate::boot::StartMode::Warm).unwrap();
        table.programs[0].restored
    };
    let mut take = |cycle, unsettled, bytes: &[u8]| {
        assert!(retaining.take(sampled(cycle, unsettled, bytes), Some(&banks)).is_none());
        retaining.programs[0].newest.as_ref().map(|(cycle, _)| *cycle)
    };
    assert_eq!(take(1, 0, &[1; 8]), None, "nothing was asked for yet");
    assert!(watch(&mut retaining, &file).is_empty());
    let mut take = |cycle, unsettled, bytes: &[u8]| {
        retaining.take(sampled(cycle, unsettled, bytes), Some(&banks));
        retaining.programs[0].newest.as_ref().map(|(cycle, _)| *cycle)
    };
    assert_eq!(take(2, 1, &[1; 8]), None, "a task has a job");
    assert_eq!(take(3, 0, &[1; 7]), None, "not all of it");
    assert_eq!(restored(&banks), 0);
    assert_eq!(take(4, 2, &[1; 8]), Some(4), "another program has");
    assert_eq!(restored(&banks), 2);
    let client = Sampled { client: 7, ..sampled(5, 0, &[2; 8]) };
    assert_eq!(retaining.take(client.clone(), None), Some(client), "a client's");
    assert!(retaining.left(OWN_CLIENTS) && !retaining.left(7));
}

#[test]
fn what_found_no_room_is_asked_for_again_and_told_once() {
    let file = plant("no-room");
    let programs = file.partitions()[0].programs();
    let limits: Vec<ProgramLimits> = programs.iter().map(ProgramLimits::new).collect();
    let changes = ProgramChanges::of(programs, Admission::default());
    let mut retaining = retaining(&file, &Files::default());
    let (mut watching, mut news) = (Watching::default(), Vec::new());
    for _ in 0..3 {
        // Without a program's limits nothing of it can be watched.
        retaining.watch(&mut watching, &[], &changes, &mut news);
    }
    assert_eq!(news.len(), 1, "{news:?}");
    assert!(!retaining.programs[0].watches);
    retaining.watch(&mut watching, &limits, &changes, &mut news);
    assert!(retaining.programs[0].watches && news.len() == 1, "{news:?}");
    // The time without values counts from here.
    run(&mut retaining, 20_000..25_000, 1_000, &mut news);
    assert_eq!(news.len(), 1, "{news:?}");
}

/// Waits until the saver has written what it was handed, and tells the generation.
fn outcome(retaining: &mut Retaining, saver: &mut Saver, news: &mut Vec<String>) -> u64 {
    loop {
        if let Some((number, result)) = saver.outcome() {
            retaining.outcome(number, &result, news);
            return result.unwrap();
        }
        std::thread::yield_now();
    }
}

#[test]
fn values_are_written_when_they_change_and_not_too_often() {
    let file = plant("written");
    let mut files = Files::open(&file).unwrap();
    let mut retaining = retaining(&file, &files);
    let mut saver = files.start(&spawn).unwrap().unwrap();
    let mut news = watch(&mut retaining, &file);
    retaining.take(sampled(1, 0, &[1; 8]), None);
    retaining.save(Some(&mut saver), 0, at(0), &mut news);
    assert_eq!(outcome(&mut retaining, &mut saver, &mut news), 1);
    let handed = |retaining: &Retaining| retaining.programs[0].file.as_ref().unwrap().handed[0];
    retaining.take(sampled(2, 0, &[2; 8]), None);
    retaining.save(Some(&mut saver), 0, at(900), &mut news);
    assert_eq!(handed(&retaining), 1, "the second is not over");
    retaining.save(Some(&mut saver), 0, at(1000), &mut news);
    assert_eq!((handed(&retaining), outcome(&mut retaining, &mut saver, &mut news)), (2, 2));
    retaining.save(Some(&mut saver), 0, at(5000), &mut news);
    assert!(retaining.programs[0].file.as_ref().unwrap().since.is_none(), "the same values");
    retaining.take(sampled(3, 0, &[3; 8]), None);
    retaining.save_last(&mut saver, at(5000));
    saver.finish(Duration::from_secs(60)).unwrap();
    assert_eq!(news, [""; 0]);
    let files = Files::open(&file).unwrap();
    let beginning = files.beginning(&file.partitions()[0], 0).unwrap();
    assert_eq!(beginning.kept.as_ref().unwrap().block, [3; 8]);
    assert!(beginning.news[0].contains("those of cycle 3, generation 3"), "{:?}", beginning.news);
    // Nothing comes any more, and that is told once.
    run(&mut retaining, 5_000..13_000, 1_000, &mut news);
    assert_eq!(news.len(), 0);
    run(&mut retaining, 13_000..90_000, 1_000, &mut news);
    assert_eq!(news.len(), 1);
    assert!(news[0].contains("no moment between two cycles"), "{news:?}");
}

#[test]
fn after_a_cold_start_nothing_from_before_it_is_written() {
    let file = plant("cold");
    let mut files = Files::open(&file).unwrap();
    let mut retaining = retaining(&file, &files);
    let mut saver = files.start(&spawn).unwrap().unwrap();
    let mut news = watch(&mut retaining, &file);
    retaining.take(sampled(1, 0, &[1; 8]), None);
    retaining.save(Some(&mut saver), 0, at(0), &mut news);
    outcome(&mut retaining, &mut saver, &mut news);
    retaining.take(sampled(2, 0, &[2; 8]), None);
    retaining.started_cold();
    // Not only when the second is over.
    retaining.save(Some(&mut saver), 0, at(20), &mut news);
    saver.finish(Duration::from_secs(60)).unwrap();
    let files = Files::open(&file).unwrap();
    let beginning = files.beginning(&file.partitions()[0], 0).unwrap();
    assert_eq!(beginning.kept.as_ref().unwrap().block, [0; 8]);
}

/// A PLC that an operator has stopped, or that has no windows in the schedule, and one with rare windows.
#[test]
fn time_without_windows_is_none_without_values() {
    let file = plant("stopped");
    let mut retaining = retaining(&file, &Files::default());
    let mut news = watch(&mut retaining, &file);
    run(&mut retaining, 0..5_000, 20, &mut news);
    for ms in (5_000..90_000).step_by(20) {
        retaining.save(None, 4_980, at(ms), &mut news);
    }
    run(&mut retaining, 90_000..92_000, 20, &mut news);
    assert_eq!(news, [""; 0]);
    // After so many windows there should have been values.
    run(&mut retaining, 92_000..96_000, 20, &mut news);
    assert_eq!(news.len(), 1);

    retaining.take(sampled(1, 0, &[1; 8]), None);
    run(&mut retaining, 100_000..160_000, 15_000, &mut news);
    assert_eq!(news.len(), 1, "{news:?}");
    run(&mut retaining, 160_000..220_000, 15_000, &mut news);
    assert_eq!(news.len(), 2);
}

#[test]
fn an_error_of_the_disk_is_told_and_tried_again() {
    let file = plant("failing");
    let mut files = Files::open(&file).unwrap();
    let mut retaining = retaining(&file, &files);
    let mut saver = files.start(&spawn).unwrap().unwrap();
    watch(&mut retaining, &file);
    let number = retaining.programs[0].file.as_ref().unwrap().number;
    let (mut news, full) = (Vec::new(), std::io::Error::from(std::io::ErrorKind::StorageFull));
    retaining.take(sampled(1, 0, &[1; 8]), None);
    retaining.save(Some(&mut saver), 0, at(0), &mut news);
    retaining.outcome(number, &Err(full), &mut news);
    assert!(news[0].contains("cannot be written: no storage space"), "{news:?}");
    let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
    retaining.outcome(number, &Err(full), &mut news);
    assert_eq!(news.len(), 1, "told once");
    retaining.save(Some(&mut saver), 0, at(1000), &mut news);
    assert!(retaining.programs[0].file.as_ref().unwrap().since.is_some(), "the same values again");
    retaining.outcome(number, &Ok(1), &mut news);
    assert!(news[1].contains("written again"), "{news:?}");
}
