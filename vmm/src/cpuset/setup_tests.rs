//! Against a kernel that is made up: it keeps files, does what the real one does to CPUs, notes
//! each change in order, and can be told to refuse any of them.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::rc::Rc;

use super::*;
use crate::kernel_tree::Tree;

#[derive(Default)]
struct State {
    files: RefCell<BTreeMap<String, String>>,
    log: RefCell<Vec<String>>,
    cpus: usize,
    /// Where the process is.
    home: RefCell<String>,
    /// Refuse the change with this number, once.
    refuse: Cell<Option<usize>>,
    /// Refuse partitions, in these words.
    invalid: Option<&'static str>,
    /// How often a removal is too early.
    lingering: Cell<usize>,
    /// How often it was waited.
    pauses: Cell<usize>,
    /// The place where the process was is gone.
    homeless: Cell<bool>,
    /// Refuse deadline threads everywhere.
    unprivileged: bool,
}

#[derive(Clone)]
struct Fake(Rc<State>);

fn fake(cpus: usize, change: impl FnOnce(&mut State)) -> Fake {
    let mut state = State { cpus, ..State::default() };
    state.files.get_mut().extend(
        [("cgroup.subtree_control", "memory pids\n"), ("cgroup.procs", "")]
            .map(|(path, text)| (path.to_owned(), text.to_owned())),
    );
    change(&mut state);
    Fake(Rc::new(state))
}

impl Fake {
    /// CPUs that partitions have.
    fn apart(&self) -> Vec<usize> {
        let files = self.0.files.borrow();
        let apart = files.iter().filter(|(path, state)| {
            path.ends_with("/cpuset.cpus.partition") && state.as_str() == "root"
        });
        apart
            .filter_map(|(path, _)| path.strip_prefix("takt-cpu")?.split('/').next()?.parse().ok())
            .collect()
    }

    fn note(&self, change: String) -> io::Result<()> {
        let mut log = self.0.log.borrow_mut();
        if self.0.refuse.get() == Some(log.len()) {
            self.0.refuse.set(None);
            return Err(io::Error::from_raw_os_error(libc::ENOSPC));
        }
        log.push(change);
        Ok(())
    }

    fn log(&self) -> Vec<String> {
        self.0.log.borrow().clone()
    }

    fn left_over(&self, cpu: usize, threads: &str) {
        self.make(&format!("takt-cpu{cpu}")).unwrap();
        let files = &mut self.0.files.borrow_mut();
        files.insert(format!("takt-cpu{cpu}/cpuset.cpus.partition"), "root".into());
        files.insert(format!("takt-cpu{cpu}/cgroup.threads"), threads.into());
        self.0.log.borrow_mut().clear();
    }

    /// All that a run must leave as it was.
    fn snapshot(&self) -> (BTreeMap<String, String>, String) {
        (self.0.files.borrow().clone(), self.0.home.borrow().clone())
    }
}

fn missing() -> io::Error {
    io::Error::from_raw_os_error(libc::ENOENT)
}

impl Tree for Fake {
    fn read(&self, path: &str) -> io::Result<String> {
        if path == "cpuset.cpus.effective" {
            let apart = self.apart();
            let rest = (0..self.0.cpus).filter(|cpu| !apart.contains(cpu));
            return Ok(rest.map(|cpu| cpu.to_string()).collect::<Vec<_>>().join(",") + "\n");
        }
        self.0.files.borrow().get(path).cloned().ok_or_else(missing)
    }

    fn write(&self, path: &str, text: &str) -> io::Result<()> {
        if path.ends_with("cgroup.procs") {
            if self.0.homeless.get() && path != "cgroup.procs" {
                return Err(missing());
            }
            self.note(format!("{path} = {text}"))?;
            *self.0.home.borrow_mut() =
                path.trim_end_matches("cgroup.procs").trim_end_matches('/').to_owned();
            return Ok(());
        }
        if path == "cgroup.threads" {
            self.0.lingering.set(0);
            return self.note(format!("{path} = {text}"));
        }
        if !self.0.files.borrow().contains_key(path) {
            return Err(missing());
        }
        self.note(format!("{path} = {text}"))?;
        let last = self.0.cpus == self.apart().len() + 1;
        let now = match text {
            "root" if self.0.invalid.is_some() => self.0.invalid.unwrap_or_default(),
            "root" if last => "root invalid (Parent unable to distribute cpu downstream)",
            "+cpuset" => "cpuset memory pids\n",
            "-cpuset" => "memory pids\n",
            other => other,
        };
        self.0.files.borrow_mut().insert(path.to_owned(), now.to_owned());
        Ok(())
    }

    fn make(&self, path: &str) -> io::Result<()> {
        self.note(format!("make {path}"))?;
        for file in ["cgroup.type", "cgroup.threads", "cpuset.cpus", "cpuset.cpus.partition"] {
            self.0.files.borrow_mut().insert(format!("{path}/{file}"), String::new());
        }
        Ok(())
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        if self.0.lingering.get() > 0 {
            return Err(io::Error::from_raw_os_error(libc::EBUSY));
        }
        self.note(format!("remove {path}"))?;
        self.0.files.borrow_mut().retain(|file, _| !file.starts_with(&format!("{path}/")));
        Ok(())
    }

    fn full_path(&self, path: &str) -> PathBuf {
        PathBuf::from("/cgroups").join(path)
    }
}

impl Kernel for Fake {
    fn home(&self) -> io::Result<String> {
        Ok(self.0.home.borrow().clone())
    }

    fn name_of(&self, _: &str) -> String {
        "kicker-1".into()
    }

    fn refusal(&self, cpu: Cpu, cgroup: Option<&str>) -> io::Result<Option<io::Error>> {
        let apart = self.apart();
        let accepted = match cgroup {
            Some(cgroup) => apart.contains(&cpu.0) && cgroup == folder(cpu),
            None => !apart.contains(&cpu.0) && apart.len() + 1 == self.0.cpus,
        };
        Ok((!accepted || self.0.unprivileged).then(|| io::Error::from_raw_os_error(libc::EPERM)))
    }

    fn pause(&self) {
        self.0.pauses.set(self.0.pauses.get() + 1);
        self.0.lingering.set(self.0.lingering.get().saturating_sub(1));
    }
}

fn refused(kernel: &Fake, cpus: &[Cpu]) -> String {
    let Err(error) = Setup::make(kernel.clone(), cpus) else { panic!("not refused") };
    error.to_string()
}

#[test]
fn a_cpu_is_set_apart_and_given_back_in_this_order() {
    let kernel = fake(4, |state| *state.home.get_mut() = "user.slice/session".into());
    let before = kernel.snapshot();
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1)]).unwrap();
    let done = [
        "cgroup.subtree_control = +cpuset",
        "cgroup.procs = 0",
        "make takt-cpu1",
        "takt-cpu1/cgroup.type = threaded",
        "takt-cpu1/cpuset.cpus = 1",
        "takt-cpu1/cpuset.cpus.partition = root",
    ];
    assert_eq!(kernel.log(), done);
    assert_eq!((setup.own(), setup.left()), (&[Cpu(1)][..], None));
    assert!(setup.entry(Cpu(0)).is_none());
    let entry = format!("{:?}", setup.entry(Cpu(1)));
    assert!(entry.contains("\"/cgroups/takt-cpu1/cgroup.threads\""), "{entry}");

    assert_eq!(setup.undo().unwrap(), [Cpu(1)]);
    let undone = [
        "takt-cpu1/cpuset.cpus.partition = member",
        "remove takt-cpu1",
        "cgroup.subtree_control = -cpuset",
        "user.slice/session/cgroup.procs = 0",
    ];
    assert_eq!(kernel.log()[done.len()..], undone);
    assert_eq!(kernel.snapshot(), before);
    assert_eq!(setup.undo().unwrap(), []);
    assert_eq!(kernel.log().len(), done.len() + undone.len());
}

#[test]
fn what_was_there_before_stays() {
    let kernel = fake(2, |state| {
        state.files.get_mut().insert("cgroup.subtree_control".into(), "cpuset cpu\n".into());
    });
    let before = kernel.snapshot();
    Setup::make(kernel.clone(), &[Cpu(1)]).unwrap().undo().unwrap();
    assert_eq!(kernel.snapshot(), before);
    assert!(
        !kernel.log().iter().any(|step| step.contains("cgroup.") && !step.contains("threaded")),
        "{:?}",
        kernel.log()
    );
}

#[test]
fn one_cpu_stays_with_the_host_and_is_then_alone() {
    let kernel = fake(3, |_| {});
    let setup = Setup::make(kernel.clone(), &[Cpu(2), Cpu(0), Cpu(1)]).unwrap();
    assert_eq!((setup.own(), setup.left()), (&[Cpu(2), Cpu(1)][..], Some(Cpu(0))));
    assert!(setup.entry(Cpu(0)).is_none());
}

#[test]
fn wherever_setting_up_stops_nothing_is_left_of_it() {
    let kernel = |refuse| {
        fake(3, |state| {
            *state.home.get_mut() = "system.slice".into();
            state.refuse.set(refuse);
        })
    };
    let whole = kernel(None);
    Setup::make(whole.clone(), &[Cpu(1), Cpu(2)]).unwrap();
    let steps = whole.log().len();
    assert_eq!(steps, 2 + 2 * 4);
    for refuse in 0..steps {
        let kernel = kernel(Some(refuse));
        let before = kernel.snapshot();
        let error = refused(&kernel, &[Cpu(1), Cpu(2)]);
        assert!(error.starts_with("cannot ") && error.contains("/cgroups/"), "{error}");
        assert_eq!(kernel.snapshot(), before, "after step {refuse}: {:?}", kernel.log());
    }
}

#[test]
fn undoing_goes_on_after_a_step_that_fails() {
    let kernel = fake(4, |state| *state.home.get_mut() = "system.slice".into());
    let before = kernel.snapshot();
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1), Cpu(2)]).unwrap();
    // The removal of the first folder.
    kernel.0.refuse.set(Some(kernel.log().len() + 1));
    let error = setup.undo().unwrap_err().to_string();
    assert!(error.starts_with("cannot remove /cgroups/takt-cpu2: "), "{error}");
    assert!(kernel.apart().is_empty());
    kernel.remove("takt-cpu2").unwrap();
    assert_eq!(kernel.snapshot(), before);
}

#[test]
fn a_process_whose_place_has_gone_stays_with_the_root() {
    let kernel = fake(2, |state| *state.home.get_mut() = "system.slice/run-1.scope".into());
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1)]).unwrap();
    kernel.0.homeless.set(true);
    assert_eq!(setup.undo().unwrap(), [Cpu(1)]);
    assert_eq!(*kernel.0.home.borrow(), "");
}

#[test]
fn a_thread_that_is_about_to_end_is_waited_for() {
    let kernel = fake(2, |_| {});
    let before = kernel.snapshot();
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1)]).unwrap();
    kernel.0.lingering.set(7);
    setup.undo().unwrap();
    assert_eq!(kernel.snapshot(), before);
}

#[test]
fn a_thread_that_never_ends_and_cannot_be_moved_is_told_of_in_the_end() {
    let kernel = fake(3, |_| {});
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1), Cpu(2)]).unwrap();
    kernel.0.lingering.set(usize::MAX);
    let error = setup.undo().unwrap_err().to_string();
    assert!(error.starts_with("cannot remove /cgroups/takt-cpu2: "), "{error}");
    assert!(kernel.apart().is_empty());
    assert_eq!(kernel.0.pauses.get(), PATIENCE);
}

#[test]
fn a_thread_that_hangs_is_left_to_the_host_and_holds_up_no_end() {
    let kernel = fake(2, |_| {});
    let before = kernel.snapshot();
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1)]).unwrap();
    kernel.0.files.borrow_mut().insert("takt-cpu1/cgroup.threads".into(), "71\n".into());
    kernel.0.lingering.set(usize::MAX);
    assert_eq!(setup.undo().unwrap(), [Cpu(1)]);
    assert!(kernel.log().contains(&"cgroup.threads = 71".to_owned()), "{:?}", kernel.log());
    assert_eq!(kernel.snapshot(), before);
}

#[test]
fn what_a_killed_takt_has_left_is_made_anew() {
    let kernel = fake(2, |_| {});
    let before = kernel.snapshot();
    kernel.left_over(1, "\n");
    let mut setup = Setup::make(kernel.clone(), &[Cpu(1)]).unwrap();
    let expected = ["takt-cpu1/cpuset.cpus.partition = member", "remove takt-cpu1"];
    assert_eq!(kernel.log()[..2], expected);
    assert_eq!(kernel.apart(), [1]);
    setup.undo().unwrap();
    assert_eq!(kernel.snapshot(), before);
}

#[test]
fn a_folder_with_threads_is_not_touched() {
    let kernel = fake(2, |_| {});
    kernel.left_over(1, "71\n");
    let before = kernel.snapshot();
    let error = refused(&kernel, &[Cpu(1)]);
    let expected = "/cgroups/takt-cpu1 is in use by thread 71 (kicker-1): ";
    assert!(error.starts_with(expected), "{error}");
    assert_eq!((kernel.snapshot(), kernel.log().len()), (before, 0));
}

#[test]
fn the_kernels_reason_is_in_the_error() {
    let reason = "root invalid (Cpu list in cpuset.cpus not exclusive)";
    let kernel = fake(2, |state| state.invalid = Some(reason));
    let before = kernel.snapshot();
    let error = refused(&kernel, &[Cpu(1)]);
    assert!(error.contains(reason) && error.contains("CPU 1"), "{error}");
    assert!(error.contains("/cgroups/takt-cpu1/cpuset.cpus.partition"), "{error}");
    assert_eq!(kernel.snapshot(), before);
}

#[test]
fn a_cpu_of_somebody_elses_is_refused_before_anything_is_done() {
    let kernel = fake(2, |_| {});
    let error = refused(&kernel, &[Cpu(5)]);
    assert!(error.contains("CPU 5") && error.contains("only CPUs 0,1;"), "{error}");
    assert_eq!(kernel.log().len(), 0);
}

#[test]
fn a_domain_that_does_not_help_is_given_back() {
    let kernel = fake(2, |state| state.unprivileged = true);
    let before = kernel.snapshot();
    let error = refused(&kernel, &[Cpu(1)]);
    assert!(error.contains("CAP_SYS_NICE"), "{error}");
    assert_eq!(kernel.snapshot(), before);
}
