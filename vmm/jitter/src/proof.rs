//! Whether there was the load that was asked for.
//!
//! Punctual releases beside a Linux that has hung say nothing about releases under load. So a load
//! proves itself by its progress, in the time of the run: from Linux's first process on, no [`STANDSTILL_MAX`] may
//! pass without any. How long Linux takes to start it is not the load's. The counts are Linux's own word, and a Linux that lies proves what it likes: this is
//! for those who want to know, against a machine that fails, not against a guest that cheats.

use serde::Serialize;
use takt_figures::load::Course;
use takt_figures::report::Partition;

use crate::figures::Figures;
use crate::load::Load;

/// Longest time without progress that a load may take between two of its steps: several times what the
/// largest object takes to compile where one instruction is a nanosecond.
pub const STANDSTILL_MAX: u64 = 2_000_000_000;

/// Whether a load has proved itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Proof {
    /// True if it has.
    pub proved: bool,
    /// Why it has not.
    pub reason: Option<String>,
    /// The Linux that was to make it; empty if there is none.
    pub partition: String,
}

impl Proof {
    /// Looks for the proof of a load; `None` if none was asked for.
    pub fn of(load: Load, figures: &Figures) -> Option<Proof> {
        if load == Load::None {
            return None;
        }
        // Each Linux is asked for the load.
        let without = figures.linuxes().find_map(|linux| {
            missing(load.name(), figures, linux).map(|reason| (linux.name.clone(), reason))
        });
        let none = || format!("there is no Linux that could make the load {}", load.name());
        Some(match (figures.linuxes().next(), without) {
            (None, _) => Proof { proved: false, reason: Some(none()), partition: String::new() },
            (_, Some((partition, reason))) => {
                Proof { proved: false, reason: Some(reason), partition }
            }
            (Some(first), None) => {
                Proof { proved: true, reason: None, partition: first.name.clone() }
            }
        })
    }
}

/// Why there is no proof that a Linux made a load.
fn missing(load: &str, figures: &Figures, linux: &Partition) -> Option<String> {
    let run = seconds(figures.duration_ns);
    let Some(course) = figures.load(&linux.name) else {
        let boot = match linux.boot_to_init_ns.flatten() {
            Some(ns) => format!("its first process started at {}", seconds(ns)),
            None => "nor did it start its first process".into(),
        };
        return Some(format!(
            "the load {load} was not seen: Linux told nothing of it in {run}, {boot}{}. Is the run long \
             enough, and does the /init of the guest know takt.load?",
            stuck(linux)
        ));
    };
    if course.load != load {
        return Some(format!("Linux made the load {} and not {load}", course.load));
    }
    // Where the console does not tell of the first process, nothing is known of what came before the load.
    let first_process = linux.boot_to_init_ns.flatten().unwrap_or(course.began_ns);
    let put_off = course.began_ns.saturating_sub(first_process);
    if put_off >= STANDSTILL_MAX {
        return Some(format!(
            "the load {load} began at {}, {} after Linux's first process: what was measured until then was \
             not under load",
            seconds(course.began_ns),
            seconds(put_off)
        ));
    }
    let standstill = course.standstill;
    if standstill.duration().0 >= STANDSTILL_MAX {
        let meanwhile = match standstill.lines {
            0 => "Linux said nothing of it".into(),
            _ => format!(
                "Linux said again and again that it had done {}",
                done_at(course, standstill.from_ns)
            ),
        };
        return Some(format!(
            "the load {load} stood still for {}, from {} to {} of {run}: {meanwhile}{}. What was measured \
             then was not under load: look at the console of Linux for the reason, and measure again",
            seconds(standstill.duration().0),
            seconds(standstill.from_ns),
            seconds(standstill.to_ns),
            stuck(linux)
        ));
    }
    if course.points.len() < 2 {
        return Some(format!(
            "the load {load} began at {} and had no progress when the run ended at {run}: too short a run \
             proves no load, let it last some seconds longer",
            seconds(course.began_ns)
        ));
    }
    None
}

/// What was done at a time, with its unit.
fn done_at(course: &Course, at: u64) -> String {
    let points = course.points.iter().take_while(|point| point.0 <= at);
    format!("{} {}", points.last().map_or(0, |point| point.1), course.unit)
}

/// What is known of a kernel that does nothing any more, to be added to a sentence.
fn stuck(linux: &Partition) -> String {
    linux.stuck.flatten().map_or(String::new(), |stuck| format!(", and its kernel {stuck}"))
}

fn seconds(ns: u64) -> String {
    format!("{:.3} s", ns as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use takt_figures::load::{Recorder, Standstill};
    use takt_figures::report::{How, Stuck};
    use takt_scheduler::time::Nanos;

    use super::*;

    const MS: u64 = 1_000_000;

    /// What a run of a duration has left whose console told this, at these times in ms.
    fn figures(lines: &[(u64, &str)], duration_ms: u64) -> Figures {
        let mut recorder = Recorder::default();
        for (at, line) in lines {
            recorder.add(format!("{line}\n").as_bytes(), Nanos(at * MS));
        }
        let end = Nanos(duration_ms * MS);
        let linux = Partition {
            name: "linux".into(),
            kind: "linux".into(),
            boot_to_init_ns: Some(Some(1_700 * MS)),
            ..Partition::default()
        };
        Figures {
            duration_ns: end.0,
            partitions: vec![Partition { name: "plc".into(), ..Partition::default() }, linux],
            loads: recorder.course("linux", end).into_iter().collect(),
            ..Figures::default()
        }
    }

    fn reason(figures: &Figures) -> Option<String> {
        Proof::of(Load::Fork, figures).unwrap().reason
    }

    #[test]
    fn a_load_that_goes_on_is_proved_up_to_the_limit() {
        let lines = [
            (1_800, "takt-load: fork 0 processes"),
            (3_799, "takt-load: fork 1 processes"),
            (5_000, "takt-load: fork 2 processes"),
        ];
        let proof = Proof::of(Load::Fork, &figures(&lines, 6_999)).unwrap();
        assert_eq!((proof.proved, proof.partition.as_str()), (true, "linux"));
        assert!(reason(&figures(&lines, 7_000)).is_some());
    }

    #[test]
    fn a_load_that_begins_long_after_linux_has_started_is_not_proved() {
        // The first process is there at 1,700 ms.
        let from = |began| {
            let lines = [
                (began, "takt-load: fork 0 processes"),
                (began + 500, "takt-load: fork 9 processes"),
            ];
            figures(&lines, began + 1_000)
        };
        assert_eq!(reason(&from(3_699)), None);
        let told = reason(&from(3_700)).unwrap();
        assert!(
            told.starts_with("the load fork began at 3.700 s, 2.000 s after Linux's first"),
            "{told}"
        );
        let mut unknown = from(9_000);
        unknown.partitions[1].boot_to_init_ns = None;
        assert_eq!(reason(&unknown), None);
    }

    #[test]
    fn a_standstill_is_told_with_its_time_and_what_linux_said() {
        let lines = [
            (1_800, "takt-load: fork 0 processes"),
            (5_000, "takt-load: fork 31 processes"),
            (5_500, "takt-load: fork 31 processes"),
        ];
        let mut stopped = figures(&lines, 20_000);
        let told = reason(&stopped).unwrap();
        let expected = "the load fork stood still for 15.000 s, from 5.000 s to 20.000 s of 20.000 s: \
                        Linux said again and again that it had done 31 processes. ";
        assert!(told.starts_with(expected), "{told}");
        stopped.partitions[1].stuck =
            Some(Some(Stuck { how: How::Spinning, since_ns: 5_600 * MS }));
        let told = reason(&stopped).unwrap();
        assert!(told.contains("and its kernel spins with interrupts off since 5.600 s"), "{told}");
        let silent = reason(&figures(&lines[..2], 20_000)).unwrap();
        assert!(silent.contains("of 20.000 s: Linux said nothing of it. "), "{silent}");
    }

    #[test]
    fn a_standstill_in_the_middle_counts_like_one_at_the_end() {
        let lines = [
            (1_000, "takt-load: fork 0 processes"),
            (1_500, "takt-load: fork 9 processes"),
            (4_000, "takt-load: fork 10 processes"),
        ];
        let told = reason(&figures(&lines, 4_100)).unwrap();
        assert!(
            told.contains("stood still for 2.500 s, from 1.500 s to 4.000 s of 4.100 s"),
            "{told}"
        );
    }

    #[test]
    fn what_was_never_seen_or_too_short_is_not_proved() {
        let told = reason(&figures(&[], 20_000)).unwrap();
        assert!(
            told.starts_with("the load fork was not seen: Linux told nothing of it in 20.000 s")
        );
        assert!(told.contains("its first process started at 1.700 s"), "{told}");
        let told = reason(&figures(&[(1_800, "takt-load: fork 0 processes")], 2_000)).unwrap();
        assert!(told.starts_with("the load fork began at 1.800 s and had no progress"), "{told}");
        let told = reason(&figures(&[(1_800, "takt-load: cpu 1 MiB")], 2_000)).unwrap();
        assert_eq!(told, "Linux made the load cpu and not fork");
        let none = Figures { partitions: Vec::new(), ..figures(&[], 1) };
        assert_eq!(reason(&none).unwrap(), "there is no Linux that could make the load fork");
        assert_eq!(Proof::of(Load::None, &none), None);
    }

    #[test]
    fn each_linux_has_to_make_the_load() {
        let lines =
            [(1_000, "takt-load: fork 0 processes"), (1_500, "takt-load: fork 9 processes")];
        let mut both = figures(&lines, 2_000);
        both.partitions.push(Partition { name: "second".into(), ..both.partitions[1].clone() });
        let proof = Proof::of(Load::Fork, &both).unwrap();
        assert_eq!((proof.proved, proof.partition.as_str()), (false, "second"));
        let load =
            takt_figures::load::Course { partition: "second".into(), ..both.loads[0].clone() };
        both.loads.push(load);
        assert!(Proof::of(Load::Fork, &both).unwrap().proved);
    }

    #[test]
    fn a_hostile_console_proves_no_more_than_it_says() {
        let most = format!("takt-load: fork {} processes", u64::MAX);
        let back = [
            (1_000, "takt-load: fork 5 processes"),
            (1_500, most.as_str()),
            (2_000, "takt-load: fork 4 processes"),
            (2_500, "takt-load: fork 99999999999999999999 processes"),
            (3_000, "takt-load: fork \u{1b}[2J processes"),
            (3_400, most.as_str()),
        ];
        let told = reason(&figures(&back, 3_600)).unwrap();
        assert!(told.contains("stood still for 2.100 s, from 1.500 s"), "{told}");
        assert!(!told.chars().any(char::is_control));
        // A file that somebody has written by hand.
        let mut odd = figures(&back, 3_600);
        odd.loads[0].standstill = Standstill { from_ns: u64::MAX, to_ns: 0, lines: u64::MAX };
        assert_eq!(reason(&odd), None);
        odd.loads[0].standstill = Standstill { from_ns: 0, to_ns: u64::MAX, lines: u64::MAX };
        odd.loads[0].points.clear();
        assert!(reason(&odd).unwrap().contains("had done 0 processes"));
    }
}
