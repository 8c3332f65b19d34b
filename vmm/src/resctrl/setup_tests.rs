//! Against a file system that is made up: it holds the record of a host, merges lines into schemata as the
//! kernel does, notes each change in order, and can be told to refuse any of them.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use takt_host::resctrl::ResctrlError;
use takt_scheduler::table::Cpu;

use super::*;
use crate::kernel_tree::Tree;

const RECORD: &str = include_str!("../../host/tests/hosts/resctrl-xeon.host");
const WHOLE: &str = "MB:0=100;1=100\nL3:0=7ff;1=7ff";

#[derive(Default)]
struct State {
    files: RefCell<BTreeMap<String, String>>,
    log: RefCell<Vec<String>>,
    /// Refuse the change with this number, once.
    refuse: Cell<Option<usize>>,
}

#[derive(Clone)]
struct Fake(Rc<State>);

fn fake() -> Fake {
    let parts = RECORD.split("== ").filter_map(|part| part.split_once('\n'));
    let below = parts.filter_map(|(path, text)| {
        Some((path.strip_prefix("sys/fs/resctrl/")?.to_owned(), text.to_owned()))
    });
    let state = State { files: RefCell::new(below.collect()), ..State::default() };
    state.files.borrow_mut().insert(SCHEMATA.into(), WHOLE.into());
    Fake(Rc::new(state))
}

impl Fake {
    fn note(&self, change: String) -> io::Result<()> {
        let mut log = self.0.log.borrow_mut();
        if self.0.refuse.get() == Some(log.len()) {
            self.0.refuse.set(None);
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        }
        log.push(change);
        Ok(())
    }

    fn log(&self) -> Vec<String> {
        self.0.log.borrow().clone()
    }

    fn files(&self) -> BTreeMap<String, String> {
        self.0.files.borrow().clone()
    }
}

impl Tree for Fake {
    fn read(&self, path: &str) -> io::Result<String> {
        self.0.files.borrow().get(path).cloned().ok_or(io::ErrorKind::NotFound.into())
    }

    fn write(&self, path: &str, text: &str) -> io::Result<()> {
        let before = self.read(path)?;
        self.note(format!("{path} = {text}"))?;
        let (resource, value) = text.split_once(':').unwrap();
        let (domain, _) = value.split_once('=').unwrap();
        let line = |line: &str| match line.split_once(':') {
            Some((name, all)) if name == resource => {
                let new = |one: &str| match one.split_once('=') {
                    Some((of, _)) if of == domain => value.to_owned(),
                    _ => one.to_owned(),
                };
                format!("{name}:{}", all.split(';').map(new).collect::<Vec<_>>().join(";"))
            }
            _ => line.to_owned(),
        };
        let after = before.lines().map(line).collect::<Vec<_>>().join("\n");
        self.0.files.borrow_mut().insert(path.into(), after);
        Ok(())
    }

    fn make(&self, path: &str) -> io::Result<()> {
        self.note(format!("make {path}"))?;
        let mut files = self.0.files.borrow_mut();
        files.insert(format!("{path}/{SCHEMATA}"), WHOLE.into());
        files.insert(format!("{path}/tasks"), String::new());
        Ok(())
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        self.note(format!("remove {path}"))?;
        self.0.files.borrow_mut().retain(|file, _| !file.starts_with(&format!("{path}/")));
        Ok(())
    }

    fn full_path(&self, path: &str) -> PathBuf {
        PathBuf::from("/sys/fs/resctrl").join(path)
    }
}

impl Kernel for Fake {
    fn folders(&self) -> io::Result<Vec<String>> {
        let mut names: Vec<String> = self
            .files()
            .keys()
            .filter_map(|path| Some(path.split_once('/')?.0.to_owned()))
            .collect();
        names.dedup();
        Ok(names)
    }

    fn vendor(&self) -> String {
        "GenuineIntel".into()
    }
}

fn asked(partition: &str, ways: Option<u32>, percent: Option<u32>) -> Asked {
    Asked { partition: partition.into(), cpu: Cpu(3), domain: Some(0), ways, percent }
}

fn usual() -> [Asked; 2] {
    [asked("plc", Some(4), None), asked("linux", None, Some(30))]
}

#[test]
fn groups_are_made_in_order_and_all_is_undone() {
    let kernel = fake();
    let before = kernel.files();
    let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
    let steps = [
        "make takt-plc",
        "takt-plc/schemata = L3:0=f",
        "make takt-linux",
        "takt-linux/schemata = L3:0=7f0",
        "takt-linux/schemata = MB:0=30",
        "schemata = L3:0=7f0",
    ];
    assert_eq!(kernel.log(), steps);
    assert_eq!(kernel.read("takt-plc/schemata").unwrap(), "MB:0=100;1=100\nL3:0=f;1=7ff");
    let tasks = setup.entry("linux").map(|entry| format!("{entry:?}")).unwrap();
    assert!(tasks.contains("/sys/fs/resctrl/takt-linux/tasks"), "{tasks}");
    assert!(setup.entry("other").is_none());
    setup.undo().unwrap();
    let undone = ["schemata = L3:0=7ff", "remove takt-linux", "remove takt-plc"];
    assert_eq!(kernel.log()[steps.len()..], undone);
    assert_eq!(kernel.files(), before);
    setup.undo().unwrap();
    assert_eq!(kernel.log().len(), steps.len() + undone.len());
}

#[test]
fn whichever_step_is_refused_all_is_as_before() {
    for step in 0..6 {
        let kernel = fake();
        let before = kernel.files();
        kernel.0.refuse.set(Some(step));
        let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
        assert!(error.to_string().contains("info/last_cmd_status"), "{error}");
        assert_eq!(kernel.files(), before, "step {step}: {:?}", kernel.log());
    }
}

#[test]
fn undoing_goes_on_after_a_step_that_is_refused() {
    for step in 6..9 {
        let kernel = fake();
        let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
        kernel.0.refuse.set(Some(step));
        assert!(setup.undo().is_err());
        assert_eq!(kernel.log().len(), 8, "step {step}: {:?}", kernel.log());
    }
}

#[test]
fn what_a_killed_takt_has_left_is_removed_wherever_it_was_killed() {
    for killed_after in 1..=6 {
        let kernel = fake();
        let before = kernel.files();
        // Nothing is undone: the process is gone.
        let setup = Setup::make(kernel.clone(), &usual()).unwrap();
        let steps = kernel.log();
        drop(setup);
        let killed = fake();
        for step in &steps[..killed_after] {
            match step.split_once(" = ") {
                Some((path, line)) => killed.write(path, line).unwrap(),
                None => killed.make(step.strip_prefix("make ").unwrap()).unwrap(),
            }
        }
        let found = remove_left_over(&killed).unwrap();
        assert_eq!(found, if killed_after < 3 { 1 } else { 2 });
        assert_eq!(killed.files(), before, "{:?}", killed.log());
        assert_eq!(remove_left_over(&killed).unwrap(), 0);
    }
}

#[test]
fn a_group_with_threads_is_left_alone() {
    let kernel = fake();
    kernel.make("takt-plc").unwrap();
    kernel.0.files.borrow_mut().insert("takt-plc/tasks".into(), "71\n72\n".into());
    let before = kernel.files();
    let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
    assert!(matches!(&error, GroupError::InUse { threads, .. } if threads == "71, 72"), "{error}");
    assert_eq!(kernel.files(), before);
}

#[test]
fn groups_of_others_stay_and_are_in_the_way_where_they_use_the_same_ways() {
    let kernel = fake();
    kernel.make("database").unwrap();
    let error = Setup::make(kernel.clone(), &usual()).err().unwrap();
    let taken = matches!(&error, GroupError::Refused { source: ResctrlError::Taken { group, .. } } if group == "database");
    assert!(taken && error.to_string().contains("rmdir the group database"), "{error}");
    kernel.write("database/schemata", "L3:0=7f0").unwrap();
    let mut setup = Setup::make(kernel.clone(), &usual()).unwrap();
    setup.undo().unwrap();
    assert_eq!(kernel.folders().unwrap(), ["database", "info"]);
    assert_eq!(kernel.read("database/schemata").unwrap(), "MB:0=100;1=100\nL3:0=7f0;1=7ff");
}
