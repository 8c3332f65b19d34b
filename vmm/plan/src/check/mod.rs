//! `takt check`: what a partition file means, before anything is started from it.
//!
//! A schedule is numbers in a file. What they amount to (who runs when, what is left for the
//! background, whether the tasks are in time, what the kernel is asked for) is computed here, not
//! by hand. All of it is ASCII, because a machine in a control cabinet is read
//! over a serial line.
//!
//! [`needs`] is the other answer: the same file for a script that starts a machine for it.
//!
//! Both are pure functions of the validated file.

mod channels;
mod hardware;
mod health;
mod passthrough;
mod programs;
mod tables;
mod timeline;
mod unconnected;
mod vsock;

use takt_scheduler::schedules::ScheduleId;

use crate::{Kind, Partition, PartitionFile};

/// Each schedule drawn per CPU, what each partition gets in it and how its tasks fare; then what holds under all of
/// them, the programs, the channels, the sockets, the host's devices, shared hardware, and the health monitor's own rows. Ends with
/// a newline.
#[must_use]
pub fn report(file: &PartitionFile) -> String {
    let mut out = format!("{}: major frame {}\n", file.name(), file.schedules().frame());
    let several = file.schedule_names().len() > 1;
    let each = file.schedule_names().iter().zip(file.schedules().tables());
    for (i, (name, table)) in each.enumerate() {
        let start = if several && i == 0 { ", which holds at the start" } else { "" };
        line(&mut out, &format!("\nSchedule \"{name}\"{start}"));
        for cpu in table.cpus() {
            timeline::draw(&mut out, file, table, cpu);
        }
        out.push_str("\n# window   < release guard   - background\n\n");
        tables::shares(&mut out, file, table);
        tables::tasks(&mut out, file, ScheduleId(i));
    }
    out.push_str(if several { "\nWhichever schedule holds\n\n" } else { "\n" });
    tables::partitions(&mut out, file);
    tables::reservations(&mut out, file);
    tables::sharing(&mut out, file);
    tables::not_analysed(&mut out, file);
    programs::list(&mut out, file);
    channels::list(&mut out, file);
    vsock::list(&mut out, file);
    passthrough::list(&mut out, file);
    hardware::list(&mut out, file);
    health::list(&mut out, file);
    if let Some(time) = file.watchdog() {
        line(
            &mut out,
            &format!(
                "\nthe host's watchdog restarts this machine {time} after Takt's last heartbeat"
            ),
        );
    }
    out
}

/// What a machine must have to run the file: the lines `memory BYTES` (the sum of all partitions),
/// `cpus N` (the highest CPU number, plus one), `file PATH` for the partition file, each image,
/// each disk and each file that is sent from, `folder PATH` for that of each file of retained values, and `record NAME PATH`
/// for each file that is appended to. Paths are absolute. Ends with a newline.
#[must_use]
pub fn needs(file: &PartitionFile) -> String {
    let memory: u64 = file.partitions().iter().map(Partition::memory_bytes).sum();
    let cpus = file.schedules().cpus().last().map(|cpu| cpu.0 + 1).unwrap_or(0);
    let mut out = format!("memory {memory}\ncpus {cpus}\nfile {}\n", file.path().display());
    for partition in file.partitions() {
        let images = match partition.kind() {
            Kind::Plc { image } => [image.as_ref(), None],
            Kind::Linux { kernel, initrd, .. } => [Some(kernel), initrd.as_ref()],
        };
        let programs = partition.programs().iter().map(|program| &program.path);
        let disks = partition.disks().iter().map(|disk| &disk.path);
        for path in images.into_iter().flatten().chain(programs).chain(disks) {
            line(&mut out, &format!("file {}", path.display()));
        }
        let retained = partition.programs().iter().filter_map(|program| program.retain.as_ref());
        for folder in retained.filter_map(|retain| retain.path.parent()) {
            line(&mut out, &format!("folder {}", folder.display()));
        }
        if let Some(path) = partition.console_log() {
            line(&mut out, &format!("record console.{} {}", partition.name(), path.display()));
        }
    }
    for channel in file.channels() {
        if let Some(path) = channel.source_file() {
            line(&mut out, &format!("file {}", path.display()));
        }
        if let Some(path) = channel.destination_file() {
            line(&mut out, &format!("record {} {}", channel.name, path.display()));
        }
    }
    if let Some(path) = file.control() {
        line(&mut out, &format!("control {}", path.display()));
    }
    out
}

fn line(out: &mut String, text: &str) {
    out.push_str(text.trim_end());
    out.push('\n');
}
