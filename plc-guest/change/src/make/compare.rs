//! What is different apart from the state: tasks, objects, ports, points.

use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use takt_program::{Area, EventSource, Image, Nanoseconds, ObjectKind, Task, TaskKind, Variable};

use super::carry::Carried;
use super::likeness::{Likeness, same_name};
use super::refusal::Refusal;

/// Something that engineers should know before they make the change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// What it is about.
    pub kind: NoteKind,
    /// What is different.
    pub text: String,
}

/// What a note is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoteKind {
    /// The name of the program. Tools take it from the image's file, so it need not be the same.
    Name,
    /// A task.
    Task,
    /// An input, an output or a marker.
    Point,
    /// What the new version's start would do, and the change does not.
    Init,
    /// References that may lose their targets.
    Reference,
}

impl NoteKind {
    /// One word for it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::Task => "task",
            Self::Point => "point",
            Self::Init => "init",
            Self::Reference => "reference",
        }
    }
}

#[derive(Default)]
struct Comparison {
    notes: Vec<Note>,
    refusals: Vec<Refusal>,
}

pub fn compare(old: &Image<'_>, new: &Image<'_>) -> (Vec<Note>, Vec<Refusal>) {
    let mut found = Comparison::default();
    if !same_name(old.name(), new.name()) {
        let text =
            format!("the image's is {}, and {} in the running version", new.name(), old.name());
        found.notes.push(Note { kind: NoteKind::Name, text });
    }
    found.must_be("the category", &old.category(), &new.category());
    for (area, what) in [
        (Area::Input, "the size of the inputs"),
        (Area::Output, "the size of the outputs"),
        (Area::Marker, "the size of the markers"),
    ] {
        found.must_be(what, &old.area_bytes(area), &new.area_bytes(area));
    }
    // The kernel has found its place at the start of the guest, where it is added as a task.
    let there = |image: &Image<'_>| if image.init().is_some() { "there" } else { "not there" };
    found.must_be("init", &there(old), &there(new));
    found.tasks(old, new);
    found.objects(old, new);
    found.ports(old, new);
    found.points(old, new);
    if new.init().is_some() {
        let text =
            "init of the new version is not run; outputs and markers keep their values".into();
        found.notes.push(Note { kind: NoteKind::Init, text });
    }
    (found.notes, found.refusals)
}

/// The kernel looks at the variables that event tasks wait for, at places that it has found at the start.
pub fn rises(old: &Image<'_>, new: &Image<'_>, carried: &Carried) -> Vec<Refusal> {
    let sources = new.tasks().filter_map(|task| match task.kind {
        TaskKind::Event { source: EventSource::Rise(name), .. } => Some(name),
        _ => None,
    });
    let kept_names = carried.kept();
    let moved = sources.filter(|name| {
        let places = (old.variable(name), new.variable(name));
        let stays = matches!(places, (Some(a), Some(b)) if a.area == b.area
            && (a.offset, a.bit) == (b.offset, b.bit));
        let kept = places.1.is_some_and(|v| v.area != Area::State)
            || kept_names.contains(&name.to_ascii_lowercase());
        !stays || !kept
    });
    moved.map(|name| Refusal::Rise { name: name.to_string() }).collect()
}

impl Comparison {
    fn differs(&mut self, what: impl ToString, old: impl ToString, new: impl ToString) {
        let (what, old, new) = (what.to_string(), old.to_string(), new.to_string());
        self.refusals.push(Refusal::Different { what, old, new });
    }

    fn must_be<T: PartialEq + ToString>(&mut self, what: impl ToString, old: &T, new: &T) {
        if old != new {
            self.differs(what, old.to_string(), new.to_string());
        }
    }

    fn missing(&mut self, what: String, is_new: bool) {
        self.refusals.push(Refusal::Missing { what, is_new });
    }

    fn note(&mut self, kind: NoteKind, text: String) {
        self.notes.push(Note { kind, text });
    }

    fn tasks(&mut self, old: &Image<'_>, new: &Image<'_>) {
        for task in old.tasks().skip(new.tasks().len()) {
            self.missing(format!("task {}", task.name), false);
        }
        for task in new.tasks().skip(old.tasks().len()) {
            self.missing(format!("task {}", task.name), true);
        }
        for (number, (old, new)) in old.tasks().zip(new.tasks()).enumerate() {
            if same_name(old.name, new.name) {
                self.task(&old, &new);
            } else {
                self.differs(format!("the name of task {number}"), old.name, new.name);
            }
        }
    }

    fn task(&mut self, old: &Task<'_>, new: &Task<'_>) {
        let name = new.name;
        if old.kind != new.kind {
            self.differs(format!("the release of task {name}"), when(old), when(new));
        }
        if new.stack_bytes > old.stack_bytes {
            let bytes = |task: &Task<'_>| format!("{} bytes", task.stack_bytes);
            self.differs(format!("the stack of task {name}"), bytes(old), bytes(new));
        }
        // Which jobs delay which would be others in the middle of them.
        self.must_be(format!("the priority of task {name}"), &old.priority, &new.priority);
        let time = |time: Option<Nanoseconds>| time.map_or("none".into(), |time| time.to_string());
        let pairs = [
            ("budget", time(old.budget), time(new.budget)),
            ("deadline", time(old.deadline), time(new.deadline)),
            ("sensitivity", old.sensitivity.to_string(), new.sensitivity.to_string()),
        ];
        for (what, old, new) in pairs {
            if old != new {
                self.note(NoteKind::Task, format!("{name}: {what} {old} becomes {new}"));
            }
        }
    }

    fn objects(&mut self, old: &Image<'_>, new: &Image<'_>) {
        let text = |kind| match kind {
            ObjectKind::Semaphore { ceiling } => format!("a semaphore of ceiling {ceiling}"),
            ObjectKind::Queue { message_bytes, depth } => {
                format!("a queue of {depth} messages of {message_bytes} bytes")
            }
            ObjectKind::Mailbox { bytes } => format!("a mailbox of {bytes} bytes"),
            ObjectKind::Flags => "event flags".into(),
        };
        let list = |image: &Image<'_>| -> Vec<(String, String)> {
            image.objects().map(|object| (object.name.into(), text(object.kind))).collect()
        };
        self.list("object", &list(old), &list(new));
    }

    fn ports(&mut self, old: &Image<'_>, new: &Image<'_>) {
        let list = |image: &Image<'_>| -> Vec<(String, String)> {
            let text = |port: takt_program::Port<'_>| {
                format!("{:?} with messages of {} bytes", port.direction, port.message_bytes)
            };
            image.ports().map(|port| (port.name.into(), text(port))).collect()
        };
        self.list("port", &list(old), &list(new));
    }

    /// Numbers in calls are places in these lists, so they must be the same.
    fn list(&mut self, what: &str, old: &[(String, String)], new: &[(String, String)]) {
        for (name, _) in old.iter().skip(new.len()) {
            self.missing(format!("{what} {name}"), false);
        }
        for (name, _) in new.iter().skip(old.len()) {
            self.missing(format!("{what} {name}"), true);
        }
        for (number, (old, new)) in old.iter().zip(new).enumerate() {
            if !same_name(&old.0, &new.0) {
                self.differs(format!("the name of {what} {number}"), &old.0, &new.0);
            } else if old.1 != new.1 {
                self.differs(format!("{what} {}", new.0), &old.1, &new.1);
            }
        }
    }

    fn points(&mut self, old: &Image<'_>, new: &Image<'_>) {
        let mut likeness = Likeness::new(old, new);
        let is_point =
            |v: &Variable<'_>| matches!(v.area, Area::Input | Area::Output | Area::Marker);
        let there =
            |image: &Image<'_>, name: &str| image.variable(name).is_some_and(|v| is_point(&v));
        for point in new.variables().filter(is_point) {
            let Some(before) = old.variable(point.name).filter(is_point) else {
                let place = place(&point);
                match point.area {
                    // Which task's outputs leave the partition is settled at the program's start.
                    Area::Output => self.missing(format!("output {} at {place}", point.name), true),
                    _ => {
                        let text = format!(
                            "{} at {place} is new; it begins with what is there",
                            point.name
                        );
                        self.note(NoteKind::Point, text);
                    }
                }
                continue;
            };
            if place(&before) != place(&point) {
                self.differs(format!("the place of {}", point.name), place(&before), place(&point));
            }
            if !likeness.same(before.ty, point.ty) {
                let (a, b) =
                    (old.type_name(before.ty).to_string(), new.type_name(point.ty).to_string());
                self.differs(format!("the type of {}", point.name), a, b);
            }
            let writer = |image: &Image<'_>, v: &Variable<'_>| {
                let task = v.writer.and_then(|task| image.task(task));
                task.map_or("no task alone".to_string(), |task| format!("task {}", task.name))
            };
            let (a, b) = (writer(old, &before), writer(new, &point));
            if a != b {
                self.differs(format!("the writer of {}", point.name), a, b);
            }
        }
        for point in old.variables().filter(|v| is_point(v) && !there(new, v.name)) {
            let place = place(&point);
            match point.area {
                Area::Output => self.missing(format!("output {} at {place}", point.name), false),
                _ => {
                    let text = format!("{} at {place} is gone", point.name);
                    self.note(NoteKind::Point, text);
                }
            }
        }
    }
}

fn place(point: &Variable<'_>) -> String {
    let letter = match point.area {
        Area::Input => "%I",
        Area::Output => "%Q",
        _ => "%M",
    };
    match point.bit {
        Some(bit) => format!("{letter}X{}.{bit}", point.offset),
        None => format!("{letter}B{}", point.offset),
    }
}

fn when(task: &Task<'_>) -> String {
    match task.kind {
        TaskKind::Cyclic { period, offset } => format!("every {period} from {offset} on"),
        TaskKind::Event { source, minimum } => {
            let (what, name) = match source {
                EventSource::Channel(name) => ("channel", name),
                EventSource::Doorbell(name) => ("doorbell", name),
                EventSource::Interrupt(name) => ("interrupt", name),
                EventSource::Rise(name) => ("rise of", name),
            };
            format!("on {what} {name}, at most every {minimum}")
        }
        TaskKind::Freewheeling => "freewheeling".into(),
    }
}
