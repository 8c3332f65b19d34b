//! The kernel's thread that moves a device's packets: where it runs, and so who pays for it.
//!
//! vhost starts it for the thread that becomes the owner of the device. Since Linux 6.4 it is a thread of
//! the owner's process and inherits affinity, cgroup and class. Before, it is a thread of the kernel's and
//! inherits the cgroup. So a thread of Takt's becomes the owner when it is where the worker is to be: in
//! the scheduling domain of the guest's CPU, pinned to it, of the class SCHED_OTHER. Then the worker is
//! looked for by its name, which has the owner's number, and pinned as well.
//!
//! On the guest's CPU it takes the time that windows leave, together with the guest, and comes before no deadline
//! thread. A worker that could not be found might run on a CPU that belongs to others, so that is an error.

use std::fs;
use std::io;

use ::vhost::VhostBackend;
use takt_scheduler::enforce::pin_thread;

use super::{Vhost, VhostError};
use crate::vcpu::kick;
use crate::vcpu::thread::{self, Place, ThreadError};

/// Longest name of a thread, in bytes: `TASK_COMM_LEN` of the kernel, less the NUL.
const NAME_MAX: usize = 15;

/// Makes the process the owner of a device, and puts the worker where the guest is.
///
/// # Errors
/// See [`VhostError`].
pub(super) fn place(vhost: &Vhost, whose: &str, place: Place) -> Result<(), VhostError> {
    const OWNER: &str = "vhost-owner";
    let own = || {
        thread::pin(OWNER, &place)?;
        vhost.set_owner().map_err(vhost.cannot("start its thread"))?;
        let mut worker = format!("vhost-{}", kick::this_thread());
        worker.truncate(NAME_MAX);
        let found = find(&worker);
        if found.is_empty() {
            return Err(VhostError::NoWorker { whose: whose.to_owned(), worker });
        }
        found
            .into_iter()
            .try_for_each(|thread| pin_thread(thread, place.cpu))
            .map_err(|source| VhostError::Pin { whose: whose.to_owned(), worker, source })
    };
    let died = || VhostError::Thread(ThreadError::Died { name: OWNER.to_owned() });
    std::thread::scope(|scope| {
        let owner = std::thread::Builder::new().name(OWNER.to_owned()).stack_size(1 << 16);
        let spawned = owner
            .spawn_scoped(scope, own)
            .map_err(|source| ThreadError::Spawn { name: OWNER.to_owned(), source })?;
        spawned.join().unwrap_or_else(|_| Err(died()))
    })
}

/// `PF_KTHREAD` of the kernel's `include/linux/sched.h`.
const KERNEL_THREAD: u32 = 0x0020_0000;

/// The threads of this name: those of this process, or else those of the kernel. Any user's process can have the name.
fn find(name: &str) -> Vec<i32> {
    let own = named("/proc/self/task", name);
    if !own.is_empty() {
        return own;
    }
    named("/proc", name).into_iter().filter(|thread| is_the_kernels(*thread)).collect()
}

fn is_the_kernels(thread: i32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{thread}/stat")).unwrap_or_default();
    flags(&stat).is_some_and(|flags| flags & KERNEL_THREAD != 0)
}

/// The flags of a process, the ninth field of proc(5). The second is its name in brackets, which may have any in itself.
fn flags(stat: &str) -> Option<u32> {
    stat.rsplit_once(')')?.1.split_ascii_whitespace().nth(6)?.parse().ok()
}

fn named(folder: &str, name: &str) -> Vec<i32> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let thread = |entry: io::Result<fs::DirEntry>| {
        let path = entry.ok()?.path();
        let number = path.file_name()?.to_str()?.parse().ok()?;
        let found = fs::read_to_string(path.join("comm")).ok()?;
        (found.trim_end() == name).then_some(number)
    };
    entries.filter_map(thread).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_process_passes_for_a_thread_of_the_kernels_by_its_name() {
        assert_eq!(flags("7 (vhost-1) S 2 0 0 0 -1 2129984 0"), Some(2_129_984));
        assert_eq!(flags("7 (a) S 2 0 0 0 -1 2129984) S 1 7 7 0 -1 4194304 0"), Some(4_194_304));
        assert_eq!(flags("7 (a"), None);
        // Process 1 is a program, wherever this runs.
        assert!(!is_the_kernels(1) && !is_the_kernels(-1));
    }

    #[test]
    fn a_thread_of_this_process_is_found_by_its_name() {
        let (tell, told) = std::sync::mpsc::channel();
        let (end, ended) = std::sync::mpsc::channel::<()>();
        let body = move || {
            tell.send(kick::this_thread()).unwrap();
            let _ = ended.recv();
        };
        let named = std::thread::Builder::new().name("vhost-like".to_owned());
        let thread = named.spawn(body).unwrap();
        let id = told.recv().unwrap();
        assert_eq!(find("vhost-like"), [id]);
        drop(end);
        thread.join().unwrap();
        assert!(find("vhost-like").is_empty());
    }
}
