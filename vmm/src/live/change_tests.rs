//! The steps of a change, against kernels that behave and kernels that lie.

mod queue_tests;

use std::fs;
use std::path::PathBuf;

use takt_abi::live;
use takt_abi::live::{
    Answer, ChangePhase as Phase, ChangeReason as Reason, ChangeRecord, ChangeStep, MESSAGE_BYTES,
    Order, Point, ProgramRecord, Range, Refusal, decode_order,
};
use takt_abi::memory::PAGE;
use takt_abi::program::PROGRAMS_MAX;
use takt_plan::Admission;
use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds, Version};
use takt_protocol::{Load, Named, PointValue};
use takt_scheduler::time::Nanos;
use vm_memory::{Bytes, GuestAddress};

use super::limits::ProgramLimits;
use super::tests::Case;
use super::{Banks, ProgramChanges, Running, Turn, ValueOrder};
use crate::boot::StartMode;
use crate::boot::programs::Programs;
use crate::config;
use crate::memory::{GuestMemory, Pages};

const FILE: &str = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
    [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
    [[partition.program]]\nimage = \"a.plc\"\nsecond_state = true\n[[partition.program]]\nimage = \"b.plc\"\n[[schedule]]\nname = \"normal\"\n\
    [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";

/// A version of `a` with this many variables.
fn image(patch: u16, variables: u32, budget: u64) -> Vec<u8> {
    image_of("a", patch, variables, budget)
}

fn image_of(program: &str, patch: u16, variables: u32, budget: u64) -> Vec<u8> {
    let mut image = Builder::new(program);
    image.version = Version { major: 1, minor: 0, patch };
    image.code = vec![0xc3];
    image.state_bytes = 8 * variables;
    let ty = image.elementary(Elementary::Ulint);
    for index in 0..variables {
        image.variable(Variable::new(&format!("v{index}"), ty, Area::State, 8 * index));
    }
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(budget));
    image.task(task);
    image.build().unwrap()
}

/// A partition with version 1.0.0 of two programs, and its kernel's ends of the queues.
struct Plant {
    case: Case,
    banks: Banks,
    now: u64,
}

impl Plant {
    fn new(name: &str) -> Self {
        let folder = PathBuf::from(env!("OUT_DIR")).join(format!("change-{name}"));
        fs::create_dir_all(&folder).unwrap();
        for program in ["a", "b"] {
            let image = image_of(program, 0, 1, 10_000);
            fs::write(folder.join(format!("{program}.plc")), image).unwrap();
        }
        fs::write(folder.join("case.toml"), FILE).unwrap();
        let file = config::load(&folder.join("case.toml"), None).unwrap();
        let partition = file.partitions()[0].clone();
        let programs = Programs::of(&partition).unwrap();
        let memory =
            GuestMemory::for_plc_with_programs(partition.memory_bytes(), Pages::Small, &[])
                .unwrap();
        programs.load(&memory, StartMode::Cold).unwrap();
        let mut case = Case::new();
        case.running.changes =
            ProgramChanges::of(partition.programs(), Admission::of(&file, partition.id()));
        Self { case, banks: Banks { memory, programs }, now: 0 }
    }

    fn load(&mut self, image: &[u8]) -> Result<String, String> {
        self.load_into("a", image)
    }

    fn load_into(&mut self, program: &str, image: &[u8]) -> Result<String, String> {
        let parts = image.chunks(10_000).count() as u32;
        let mut said = Ok(String::new());
        for (part, data) in (0..).zip(image.chunks(10_000)) {
            let (partition, program) = ("plc".to_owned(), program.to_owned());
            let load = Load { partition, program, part, parts, data: data.to_vec() };
            let running = &mut self.case.running;
            said = running.changes.load(&load, &self.banks, &mut running.link);
            if said.is_err() {
                break;
            }
        }
        said.map_err(|refusal| refusal.text)
    }

    fn tick(&mut self) -> Vec<String> {
        self.now += 20;
        let (now, mut turn) = (Nanos::from_millis(self.now), Turn::default());
        self.case.running.on_tick(now, 0, Some(&self.banks), &mut turn, &mut Vec::new());
        turn.events.into_iter().map(|(.., text)| text).collect()
    }

    fn phase(&self) -> (String, String, Option<String>) {
        let status = self.case.running.changes.status().remove(0);
        (status.running.version, status.phase, status.other.map(|other| other.version))
    }
}

fn record(phase: Phase) -> ChangeRecord {
    ChangeRecord { phase, took: 3000, cycle: 9, ..ChangeRecord::default() }
}

#[test]
fn a_version_is_checked_brought_into_the_bank_entered_and_left() {
    let mut plant = Plant::new("steps");
    let (mut orders, mut answers) = plant.case.guest();
    plant.tick();
    let next = image(1, 2, 10_000);
    let said = plant.load(&next).unwrap();
    assert!(said.contains("a: version 1.0.1 is being prepared"), "{said}");
    // The order tells what lies in the bank.
    let mut buffer = [0; MESSAGE_BYTES];
    let mut last = || {
        let mut last = None;
        while let Ok(message) = orders.receive(&mut buffer) {
            last = decode_order(message.bytes)
                .ok()
                .filter(|(_, o)| !matches!(o, Order::Status { .. }))
                .or(last);
        }
        last.unwrap()
    };
    let (number, order) = last();
    let Order::Prepare { program: 0, image_bytes, forward_bytes, .. } = order else {
        panic!("{order:?}")
    };
    assert_eq!(image_bytes as usize, next.len());
    let place = plant.banks.programs.all()[0].place;
    let read = |at: u64, bytes: u32| {
        let mut found = vec![0; bytes as usize];
        plant.banks.memory.regions().read_slice(&mut found, GuestAddress(at)).unwrap();
        found
    };
    assert_eq!(read(place.second_bank, image_bytes), next);
    let plan =
        read(place.second_bank + u64::from(image_bytes).next_multiple_of(PAGE), forward_bytes);
    assert!(plan.starts_with(b"TAKTCHG\0"));
    assert!(plant.load(&next).unwrap_err().contains("a change is under way (preparing)"));

    let mut tell = |plant: &mut Plant, number: u32, record: ChangeRecord| {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = Answer::Change(record);
        answers.send(message.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick()
    };
    // What the kernel cannot do from here is not believed, and an answer to an older order neither.
    assert!(tell(&mut plant, number, record(Phase::Trial)).is_empty());
    assert!(tell(&mut plant, number - 1, record(Phase::Prepared)).is_empty());
    assert_eq!(plant.phase().1, "preparing");
    assert_eq!(tell(&mut plant, number, record(Phase::Prepared)), ["a: a version is prepared"]);
    let running = &mut plant.case.running;
    assert!(running.changes.commit("b", &mut running.link).is_err());
    running.changes.commit("a", &mut running.link).unwrap();
    let (number, order) = last();
    assert_eq!(order, Order::Change { program: 0, step: ChangeStep::Commit });
    let news = tell(&mut plant, number, record(Phase::Trial));
    assert_eq!(news, ["a: version 1.0.1 runs from cycle 9 on, on trial; the change took 3000 ns"]);
    assert_eq!(plant.phase(), ("1.0.1".into(), "trial".into(), Some("1.0.0".into())));
    let table = plant.banks.programs.load(&plant.banks.memory, StartMode::Cold).unwrap();
    assert_eq!(table.programs[0].image_bytes, next.len() as u64);

    let failed = ChangeRecord { reason: Reason::Fault, ..record(Phase::RolledBack) };
    let news = tell(&mut plant, number, failed);
    assert!(
        news[0].contains("version 1.0.0 runs again from cycle 9 on: a fault of the new version"),
        "{news:?}"
    );
    assert_eq!(plant.phase(), ("1.0.0".into(), "rolled-back".into(), Some("1.0.1".into())));
    // The next version goes into the bank that is free now: the second one again.
    plant.load(&image(2, 2, 10_000)).unwrap();
    assert_eq!(plant.phase().2, Some("1.0.2".into()));
}

#[test]
fn a_program_that_stops_while_a_version_is_prepared_can_be_loaded_again() {
    let mut plant = Plant::new("stops");
    let (mut orders, mut answers) = plant.case.guest();
    plant.tick();
    plant.load(&image(1, 2, 10_000)).unwrap();
    let mut tell = |plant: &mut Plant, phase, reason| {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = Answer::Change(ChangeRecord { phase, reason, ..ChangeRecord::default() });
        let number = plant.case.running.link.last();
        answers.send(message.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick()
    };
    assert_eq!(tell(&mut plant, Phase::Prepared, Reason::None), ["a: a version is prepared"]);
    let mut buffer = [0; MESSAGE_BYTES];
    while orders.receive(&mut buffer).is_ok() {}
    plant.tick();
    let mut asked = Vec::new();
    while let Ok(message) = orders.receive(&mut buffer) {
        asked.extend(decode_order(message.bytes).map(|(_, order)| order));
    }
    let tell_me = Order::Change { program: 0, step: ChangeStep::Tell };
    assert!(asked.contains(&tell_me), "only the kernel knows of a stop: {asked:?}");
    let news = tell(&mut plant, Phase::None, Reason::Stopped);
    assert!(news[0].contains("given up: the program was stopped or started anew"), "{news:?}");
    plant.load(&image(2, 2, 10_000)).unwrap();
}

/// A version with so many variables, each at another place than in [`image_of`].
fn reversed(program: &str, patch: u16, variables: u32) -> Vec<u8> {
    let mut image = Builder::new(program);
    image.version = Version { major: 1, minor: 0, patch };
    image.code = vec![0xc3];
    image.state_bytes = 8 * variables;
    let ty = image.elementary(Elementary::Ulint);
    for index in 0..variables {
        let place = 8 * (variables - 1 - index);
        image.variable(Variable::new(&format!("v{index}"), ty, Area::State, place));
    }
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    image.build().unwrap()
}

#[test]
fn what_is_too_large_for_two_cycles_takes_the_second_state_if_the_file_gives_one() {
    let mut plant = Plant::new("large");
    let (mut orders, mut answers) = plant.case.guest();
    plant.tick();
    let mut tell = |plant: &mut Plant, record: ChangeRecord| {
        let mut buffer = [0; MESSAGE_BYTES];
        let number = plant.case.running.link.last();
        let answer = Answer::Change(record);
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick()
    };
    for (program, place) in [("a", 0), ("b", 1)] {
        plant.load_into(program, &image_of(program, 1, 300, 10_000)).unwrap();
        for phase in [Phase::Prepared, Phase::Held] {
            if phase == Phase::Held {
                plant.case.running.commit(program).unwrap();
                tell(&mut plant, ChangeRecord { program: place, ..record(Phase::Trial) });
            }
            tell(&mut plant, ChangeRecord { program: place, ..record(phase) });
        }
    }
    let said = plant.load_into("b", &reversed("b", 2, 300)).unwrap_err();
    assert!(said.starts_with("the change takes more than 256 steps. With the key `second_state`"));
    let mut buffer = [0; MESSAGE_BYTES];
    while orders.receive(&mut buffer).is_ok() {}

    let next = reversed("a", 2, 300);
    let said = plant.load(&next).unwrap();
    assert!(said.contains("carried to the second state, in 300 steps and 76 us"), "{said}");
    let message = orders.receive(&mut buffer).unwrap();
    let Ok((_, Order::Prepare { image_bytes, forward_bytes, .. })) = decode_order(message.bytes)
    else {
        panic!("another order")
    };
    assert_eq!((image_bytes as usize, forward_bytes), (next.len(), 96 + 300 * 16));
    // Version 1.0.1 runs in the second bank.
    let place = plant.banks.programs.all()[0].place;
    let mut plan = vec![0; forward_bytes as usize];
    let at = GuestAddress(place.image + u64::from(image_bytes).next_multiple_of(PAGE));
    plant.banks.memory.regions().read_slice(&mut plan, at).unwrap();
    let old = image(1, 300, 10_000);
    let images = [&old, &next].map(|bytes| Image::parse(bytes).unwrap());
    takt_change::LargePlan::parse(&plan, &images[0], &images[1]).unwrap();

    let carried = ChangeRecord { carried: 9, carrying: 41_001, ..record(Phase::Prepared) };
    let news = tell(&mut plant, carried);
    let told = "a: a version is prepared; 9 pages were carried to its state in 42 us";
    assert!(news.iter().any(|text| text == told), "{news:?}");
    let status = plant.case.running.changes.status().remove(0);
    assert_eq!((status.carried_pages, status.carrying_ns), (9, 41_001));
}

#[test]
fn what_is_no_version_of_the_program_is_refused_and_nothing_is_written() {
    let mut plant = Plant::new("refused");
    let _ends = plant.case.guest();
    plant.tick();
    let good = image(1, 2, 10_000);
    let mut damaged = good.clone();
    *damaged.last_mut().unwrap() ^= 1;
    let large = image(1, 20_000, 10_000);
    for (image, reason) in [
        (&damaged[..], "this is no program image"),
        (&good[..good.len() - 1], "this is no program image"),
        (b"x", "this is no program image"),
        (
            &image(1, 2, 300_000),
            "with the larger budgets of both versions, in the schedule \"normal\" the task \"a.main\" is not proven \
             to meet its deadlines: it and the more urgent tasks may ask for 301us, and the windows may give only 288us",
        ),
        (&large, "longer than the program's bank"),
    ] {
        let said = plant.load(image).unwrap_err();
        assert!(said.contains(reason), "{reason}: {said}");
    }
    let place = plant.banks.programs.all()[0].place;
    let first: u64 =
        plant.banks.memory.regions().read_obj(GuestAddress(place.second_bank)).unwrap();
    assert_eq!((first, plant.phase().1.as_str()), (0, "none"));
    // Parts come in their order.
    let running = &mut plant.case.running;
    let mut part = |part| {
        let (partition, program) = ("plc".to_owned(), "a".to_owned());
        let load = Load { partition, program, part, parts: 3, data: vec![1] };
        running.changes.load(&load, &plant.banks, &mut running.link).is_ok()
    };
    assert!(part(0) && part(1) && !part(1) && !part(2) && part(0) && !part(2));
}

#[test]
fn other_budgets_are_let_in_if_all_tasks_of_the_partition_meet_their_deadlines_with_them() {
    let mut plant = Plant::new("budgets");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    let mut enter = |plant: &mut Plant, program: &str, place| {
        for phase in [Phase::Prepared, Phase::Trial, Phase::Held] {
            let mut buffer = [0; MESSAGE_BYTES];
            let number = plant.case.running.link.last();
            let answer = Answer::Change(ChangeRecord { program: place, ..record(phase) });
            answers
                .send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1))
                .unwrap();
            plant.tick();
            if phase == Phase::Prepared {
                plant.case.running.commit(program).unwrap();
            }
        }
    };
    plant.load(&image(1, 2, 200_000)).unwrap();
    enter(&mut plant, "a", 0);
    // What the other program needs now counts, and not what the file says of it.
    let said = plant.load_into("b", &image_of("b", 1, 2, 150_000)).unwrap_err();
    assert!(said.contains("the task \"b.main\" is not proven"), "{said}");
    plant.load(&image(2, 2, 10_000)).unwrap();
    enter(&mut plant, "a", 0);
    plant.load_into("b", &image_of("b", 1, 2, 150_000)).unwrap();
}

/// Orders a force of `v0`.
fn force(plant: &mut Plant, point: Point) -> Result<(), String> {
    let named = Named { name: "a.v0".into(), text: "1".into() };
    let value = PointValue { partition: "plc".into(), point, value: 1, named };
    let Running { writes, changes, link, .. } = &mut plant.case.running;
    changes.is_settled(0).map_err(|refusal| refusal.text)?;
    let ordered = writes.order(1, ValueOrder::Force(value), link, Nanos::from_millis(plant.now));
    ordered.map_err(|refusal| refusal.text)
}

#[test]
fn a_place_in_a_program_means_the_version_that_runs() {
    let mut plant = Plant::new("places");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    let mut tell = |plant: &mut Plant, number: u32, answer: Answer| {
        let mut buffer = [0; MESSAGE_BYTES];
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick()
    };
    let range = Range { program: 0, area: live::Area::State, offset: 0, bytes: 8 };
    let point = Point::new(range, None).unwrap();
    // The first order was that for the status.
    plant.load(&image(1, 2, 10_000)).unwrap();
    tell(&mut plant, 2, Answer::Change(record(Phase::Prepared)));
    force(&mut plant, point).unwrap();
    let said = plant.case.running.commit("a").unwrap_err().text;
    assert!(said.contains("has not answered an order"), "{said}");
    let forced = plant.case.running.link.last();
    tell(&mut plant, forced, Answer::Reply(Ok(())));
    let said = plant.case.running.commit("a").unwrap_err().text;
    assert!(said.contains("1 of its values are forced"), "{said}");
    plant.case.running.writes.forget().unwrap();

    // What Takt does not know of, the kernel does.
    plant.case.running.commit("a").unwrap();
    let commit = plant.case.running.link.last();
    let news = tell(&mut plant, commit, Answer::Reply(Err(Refusal::Forced)));
    assert!(news[0].contains("values of the program are forced"), "{news:?}");
    assert_eq!(plant.phase().1, "prepared");

    // From the commit on nothing is watched or forced, until the trial is over.
    let limits = [ProgramLimits { name: "a".into(), watch: 100, force: true, areas: [8, 0, 0, 0] }];
    plant.case.running.limits = limits.into();
    let Running { watching, limits, .. } = &mut plant.case.running;
    watching.watch(7, vec![range], Nanos::ZERO, limits).unwrap();
    plant.case.running.commit("a").unwrap();
    let commit = plant.case.running.link.last();
    assert!(force(&mut plant, point).unwrap_err().contains("committing"));
    let mut turn = Turn::default();
    let now = Nanos::from_millis(plant.now);
    plant.case.running.on_tick(now, 0, Some(&plant.banks), &mut turn, &mut Vec::new());
    assert_eq!(turn.unwatched.len(), 1);
    assert!(turn.unwatched[0].0 == 7 && !turn.exchanged);
    let programs = [ProgramRecord::default(); PROGRAMS_MAX];
    let status = Answer::Programs { programs, count: 1, tasks: 1, forced: 0, dropped: 0 };
    tell(&mut plant, commit, status);
    tell(&mut plant, commit, Answer::Change(record(Phase::Trial)));
    assert!(force(&mut plant, point).unwrap_err().contains("trial"));
    // Clients compare this hash with that of the image from which they take places.
    let hash = Image::parse(&image(1, 2, 10_000)).unwrap().hash();
    assert_eq!(plant.case.running.figures.programs[0].hash, hash);
    assert_eq!(plant.case.running.limits[0].areas[0], 16);
    tell(&mut plant, commit, Answer::Change(record(Phase::Held)));
    force(&mut plant, point).unwrap();
    assert!(plant.case.running.roll_back("a").is_err());
}

#[test]
fn a_version_that_is_entered_or_left_is_known_whatever_comes_between() {
    let mut plant = Plant::new("between");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    let mut tell = |plant: &mut Plant, number: u32, answer: Answer| {
        let mut buffer = [0; MESSAGE_BYTES];
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick();
    };
    let prepare = |plant: &mut Plant, patch| {
        plant.load(&image(patch, 2, 10_000)).unwrap();
        plant.case.running.link.last()
    };
    // The program stops before Takt hears that the version has been entered.
    let number = prepare(&mut plant, 1);
    tell(&mut plant, number, Answer::Change(record(Phase::Prepared)));
    plant.case.running.commit("a").unwrap();
    let number = plant.case.running.link.last();
    let stopped = ChangeRecord { reason: Reason::Stopped, ..record(Phase::None) };
    tell(&mut plant, number, Answer::Change(stopped));
    assert_eq!(plant.phase(), ("1.0.1".into(), "none".into(), Some("1.0.0".into())));
    // A roll-back is ordered when the kernel has begun one itself.
    let number = prepare(&mut plant, 2);
    tell(&mut plant, number, Answer::Change(record(Phase::Prepared)));
    plant.case.running.commit("a").unwrap();
    let number = plant.case.running.link.last();
    tell(&mut plant, number, Answer::Change(record(Phase::Trial)));
    plant.case.running.roll_back("a").unwrap();
    let number = plant.case.running.link.last();
    tell(&mut plant, number, Answer::Reply(Err(Refusal::NotNow)));
    assert!(plant.case.running.changes.is_settled(0).is_err());
    tell(&mut plant, number, Answer::Change(record(Phase::RolledBack)));
    assert_eq!(plant.phase(), ("1.0.1".into(), "rolled-back".into(), Some("1.0.2".into())));
}

#[test]
fn an_order_that_the_kernel_does_not_take_ends_the_change() {
    let mut plant = Plant::new("not-now");
    let (_, mut answers) = plant.case.guest();
    plant.tick();
    plant.load(&image(1, 2, 10_000)).unwrap();
    let mut buffer = [0; MESSAGE_BYTES];
    // The first order was that for the status.
    for number in 1..=3 {
        let answer = Answer::Reply(Err(Refusal::NotNow));
        let message = answer.encode(number, &mut buffer).unwrap();
        answers.send(message, takt_channel::Tsc(1)).unwrap();
    }
    let news = plant.tick();
    assert!(news[0].contains("the kernel takes no such order now"), "{news:?}");
    assert_eq!(plant.phase().1, "refused");
    // A guest that starts anew knows of no change.
    let _new = plant.case.guest();
    assert!(plant.tick()[0].contains("the guest starts anew with version 1.0.0"));
    assert_eq!(plant.phase(), ("1.0.0".into(), "none".into(), None));
}

#[test]
fn there_is_no_way_back_into_a_bank_that_was_written_over() {
    let mut plant = Plant::new("gone");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    plant.load(&image(1, 2, 10_000)).unwrap();
    plant.case.running.commit("a").unwrap_err();
    let mut tell = |plant: &mut Plant, phase| {
        let mut buffer = [0; MESSAGE_BYTES];
        let number = plant.case.running.link.last();
        let answer = Answer::Change(record(phase));
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick();
    };
    tell(&mut plant, Phase::Prepared);
    plant.case.running.commit("a").unwrap();
    tell(&mut plant, Phase::Trial);
    tell(&mut plant, Phase::Held);
    assert_eq!(plant.phase(), ("1.0.1".into(), "held".into(), Some("1.0.0".into())));
    // The kernel takes no order, so it does not hear of the version that lies in the bank then.
    while plant.case.running.link.send(&Order::WatchClear).is_ok() {}
    let said = plant.load(&image(2, 2, 10_000)).unwrap_err();
    assert!(said.contains("takes no orders now"), "{said}");
    let said = plant.case.running.roll_back("a").unwrap_err().text;
    assert!(said.contains("the version before is gone"), "{said}");
    assert_eq!(plant.phase(), ("1.0.1".into(), "held".into(), None));
}

#[test]
fn one_program_changes_at_a_time_and_the_way_back_of_another_is_gone_then() {
    let mut plant = Plant::new("two");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    plant.load(&image(1, 2, 10_000)).unwrap();
    let mut tell = |plant: &mut Plant, phase| {
        let mut buffer = [0; MESSAGE_BYTES];
        let number = plant.case.running.link.last();
        let answer = Answer::Change(record(phase));
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick()
    };
    let next = image_of("b", 1, 2, 10_000);
    let refused = |plant: &mut Plant, phase: &str| {
        let said = plant.load_into("b", &next).unwrap_err();
        assert!(
            said.contains(&format!("the program a of this partition changes ({phase})")),
            "{said}"
        );
    };
    refused(&mut plant, "preparing");
    tell(&mut plant, Phase::Prepared);
    refused(&mut plant, "prepared");
    plant.case.running.commit("a").unwrap();
    refused(&mut plant, "committing");
    tell(&mut plant, Phase::Trial);
    refused(&mut plant, "trial");
    tell(&mut plant, Phase::Held);
    assert_eq!(plant.phase(), ("1.0.1".into(), "held".into(), Some("1.0.0".into())));

    plant.load_into("b", &next).unwrap();
    let news = plant.tick();
    assert!(news[0].contains("a: version 1.0.1 stays, and no roll-back leads"), "{news:?}");
    assert_eq!(plant.phase(), ("1.0.1".into(), "none".into(), None));
    let said = plant.case.running.roll_back("a").unwrap_err().text;
    assert!(said.contains("there is nothing to go back to"), "{said}");
}

#[test]
fn a_guest_that_starts_anew_gets_no_version_and_is_known_by_what_it_was_loaded_with() {
    let mut plant = Plant::new("anew");
    let (_orders, mut answers) = plant.case.guest();
    plant.tick();
    let mut tell = |plant: &mut Plant, phase| {
        let mut buffer = [0; MESSAGE_BYTES];
        let number = plant.case.running.link.last();
        let answer = Answer::Change(record(phase));
        answers.send(answer.encode(number, &mut buffer).unwrap(), takt_channel::Tsc(1)).unwrap();
        plant.tick();
    };
    plant.load(&image(1, 2, 10_000)).unwrap();
    tell(&mut plant, Phase::Prepared);
    plant.case.running.commit("a").unwrap();
    // The guest ends when it has just entered the version, and is loaded before Takt hears of that.
    plant.banks.programs.begin_start();
    plant.banks.programs.load(&plant.banks.memory, StartMode::Cold).unwrap();
    tell(&mut plant, Phase::Trial);
    tell(&mut plant, Phase::Held);
    assert_eq!(plant.phase().0, "1.0.1");
    let place = plant.banks.programs.all()[0].place;
    let read = |plant: &Plant| {
        let mut found = vec![0; image(0, 1, 10_000).len()];
        plant.banks.memory.regions().read_slice(&mut found, GuestAddress(place.image)).unwrap();
        found
    };
    let said = plant.load(&image(2, 2, 10_000)).unwrap_err();
    assert!(said.contains("the guest starts anew"), "{said}");
    assert_eq!(read(&plant), image(0, 1, 10_000), "it is not written over");

    let _new = plant.case.guest();
    plant.tick();
    assert!(!plant.banks.programs.was_seen(), "what it retains is kept from now on");
    assert_eq!(plant.phase(), ("1.0.0".into(), "none".into(), None));
    plant.load(&image(2, 2, 10_000)).unwrap();
    assert_eq!(read(&plant), image(0, 1, 10_000), "the next one is in the other bank");
}
