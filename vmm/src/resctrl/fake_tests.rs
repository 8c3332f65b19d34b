//! A file system that is made up: it holds the record of a host, refuses what the kernel refuses, shows masks and
//! percentages as wide as the kernel does, notes each change in order, and can be told to refuse any of them.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::rc::Rc;

use super::SCHEMATA;
use crate::kernel_tree::Tree;
use crate::resctrl::kernel::Kernel;

#[derive(Default)]
struct State {
    files: RefCell<BTreeMap<String, String>>,
    vendor: String,
    /// Schemata of a group that is new: all of everything.
    whole: String,
    log: RefCell<Vec<String>>,
    /// Refuse the change with this number, once.
    refuse: Cell<Option<usize>>,
}

/// Such a file system. A clone is the same one.
#[derive(Clone)]
pub struct Fake(Rc<State>);

fn refused(reason: i32) -> io::Error {
    io::Error::from_raw_os_error(reason)
}

impl Fake {
    pub fn of(record: &str) -> Self {
        let parts = record.split("== ").filter_map(|part| part.split_once('\n'));
        let all: BTreeMap<_, _> =
            parts.map(|(path, text)| (path.to_owned(), text.to_owned())).collect();
        let vendor =
            all["proc/cpuinfo"].lines().find_map(|line| line.strip_prefix("vendor_id\t: "));
        let below = |(path, text): (&String, &String)| {
            Some((path.strip_prefix("sys/fs/resctrl/")?.to_owned(), text.clone()))
        };
        let files: BTreeMap<_, _> = all.iter().filter_map(below).collect();
        Self(Rc::new(State {
            vendor: vendor.unwrap().to_owned(),
            whole: files[SCHEMATA].clone(),
            files: RefCell::new(files),
            ..State::default()
        }))
    }

    /// Refuses the change of this number.
    pub fn refuse(&self, change: usize) {
        self.0.refuse.set(Some(change));
    }

    pub fn log(&self) -> Vec<String> {
        self.0.log.borrow().clone()
    }

    pub fn files(&self) -> BTreeMap<String, String> {
        self.0.files.borrow().clone()
    }

    pub fn set(&self, path: &str, text: &str) {
        self.0.files.borrow_mut().insert(path.into(), text.into());
    }

    fn note(&self, change: String) -> io::Result<()> {
        let mut log = self.0.log.borrow_mut();
        if self.0.refuse.get() == Some(log.len()) {
            self.0.refuse.set(None);
            return Err(refused(libc::EINVAL));
        }
        log.push(change);
        Ok(())
    }

    fn info(&self, path: &str, radix: u32) -> Option<u32> {
        let text = self.read(&format!("info/{path}")).ok()?;
        u32::from_str_radix(text.trim(), radix).ok()
    }

    /// The value as it is shown, if the kernel takes it (`cbm_validate` and `bw_validate` in
    /// arch/x86/kernel/cpu/resctrl/ctrlmondata.c).
    fn shown(&self, resource: &str, value: &str, old: &str) -> Option<String> {
        let width = old.len();
        let Some(all) = self.info(&format!("{resource}/cbm_mask"), 16) else {
            let step = self.info(&format!("{resource}/bandwidth_gran"), 10)?;
            let least = self.info(&format!("{resource}/min_bandwidth"), 10)?;
            let most = if self.0.vendor == "AuthenticAMD" { 2048 } else { 100 };
            let value: u32 = value.parse().ok()?;
            let takes = (least..=most).contains(&value);
            return takes.then(|| format!("{:width$}", value.next_multiple_of(step)));
        };
        let value = u32::from_str_radix(value, 16).ok()?;
        let is_sparse = self.info(&format!("{resource}/sparse_masks"), 10) == Some(1);
        let row = value >> value.trailing_zeros().min(31);
        let in_a_row = value == 0 || row & (row + 1) == 0;
        let least = self.info(&format!("{resource}/min_cbm_bits"), 10)?;
        let takes = value & !all == 0 && value.count_ones() >= least && (in_a_row || is_sparse);
        takes.then(|| format!("{value:0width$x}"))
    }

    /// Schemata after a line was written to them: what it does not name stays.
    fn merged(&self, before: &str, line: &str) -> Option<String> {
        let (resource, given) = line.split_once(':')?;
        let mut after = Vec::new();
        let mut found = false;
        for old in before.lines() {
            let (name, all) = old.split_once(':')?;
            if name.trim() != resource {
                after.push(old.to_owned());
                continue;
            }
            let mut values: Vec<_> = all.split(';').map(str::to_owned).collect();
            for one in given.split(';') {
                let (domain, value) = one.split_once('=')?;
                let is_it = |old: &&mut String| old.split('=').next() == Some(domain);
                let old = values.iter_mut().find(is_it)?;
                let (_, shown) = old.split_once('=')?;
                *old = format!("{domain}={}", self.shown(resource, value, shown)?);
            }
            after.push(format!("{name}:{}", values.join(";")));
            found = true;
        }
        found.then(|| after.join("\n") + "\n")
    }
}

impl Tree for Fake {
    fn read(&self, path: &str) -> io::Result<String> {
        self.0.files.borrow().get(path).cloned().ok_or(io::ErrorKind::NotFound.into())
    }

    fn write(&self, path: &str, line: &str) -> io::Result<()> {
        let before = self.read(path)?;
        let after = self.merged(&before, line).ok_or_else(|| refused(libc::EINVAL))?;
        self.note(format!("{path} = {line}"))?;
        self.set(path, &after);
        Ok(())
    }

    fn make(&self, path: &str) -> io::Result<()> {
        let resources = ["L3", "L3CODE", "L3DATA", "MB", "SMBA"];
        let most = resources.iter().filter_map(|r| self.info(&format!("{r}/num_closids"), 10));
        let there = self.files().keys().filter(|file| file.ends_with(SCHEMATA)).count();
        if most.min().is_some_and(|most| there >= most as usize) {
            return Err(refused(libc::ENOSPC));
        }
        self.note(format!("make {path}"))?;
        let whole = self.0.whole.clone();
        for (file, text) in
            [(SCHEMATA, &*whole), ("tasks", ""), ("cpus_list", "\n"), ("mode", "shareable\n")]
        {
            self.set(&format!("{path}/{file}"), text);
        }
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
        self.0.vendor.clone()
    }
}
