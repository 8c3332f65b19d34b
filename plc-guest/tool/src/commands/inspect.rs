//! `takt plc inspect`: what is in an image, for people and for scripts. Of sources in Structured Text it shows how many
//! instructions their tasks take at most, which an image does not say.

use std::path::PathBuf;

use serde_json::{Value, json};
use takt_program::{
    Area, Direction, EventSource, Flags, Image, Object, ObjectKind, Task, TaskKind, Variable,
};

use super::structured_text::{Messages, is_text};
use super::{hex, image, read, worst};
use crate::Failure;

/// Arguments of `inspect`.
#[derive(clap::Args)]
pub struct Inspect {
    /// An image; or sources in Structured Text (.st), and folders of which all such files are taken: of them, the
    /// greatest number of instructions of each task is shown. Without any, the project in the current folder is taken.
    inputs: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    messages: Messages,
}

impl Inspect {
    pub fn run(self) -> Result<(), Failure> {
        let path = match &self.inputs[..] {
            [path] if !is_text(path) => path,
            inputs if inputs.iter().all(|input| is_text(input)) => {
                return worst::show(inputs, &self.messages, self.json);
            }
            _ => {
                return Err(Failure::input(
                    "found more than one image; one image, or sources in Structured Text (.st), are allowed",
                ));
            }
        };
        let bytes = read(path)?;
        let image = image(path, &bytes)?;
        if self.json {
            println!("{:#}", as_json(&image));
        } else {
            print(&image);
        }
        Ok(())
    }
}

fn print(image: &Image<'_>) {
    println!("program   {} {}, category {}", image.name(), image.version(), image.category());
    println!("hash      {}", hex(&image.hash()));
    println!("layout    {}", hex(&image.layout_hash()));
    println!("signature {}", image.key().map_or("none".into(), |key| format!("by {}", hex(&key))));
    println!(
        "memory    {} bytes of code, {} of constants, {} of state",
        image.code().len(),
        image.constants().len(),
        image.state_bytes()
    );
    println!(
        "image     {} bytes of inputs, {} of outputs, {} of markers",
        image.area_bytes(Area::Input),
        image.area_bytes(Area::Output),
        image.area_bytes(Area::Marker)
    );
    println!("source    {} traps, {} lines", image.traps().len(), image.lines().len());
    println!("init      {}", if image.init().is_some() { "yes" } else { "none" });
    println!("tasks:");
    for task in image.tasks() {
        let or_none = |time: Option<_>| {
            time.map_or("none".into(), |time: takt_program::Nanoseconds| time.to_string())
        };
        println!(
            "  {:<20} {}, priority {}, budget {}, deadline {}, stack {} bytes",
            task.name,
            when(&task),
            task.priority,
            or_none(task.budget),
            or_none(task.deadline),
            task.stack_bytes
        );
    }
    if image.variables().len() > 0 {
        println!("points:");
    }
    for variable in image.variables() {
        let (ty, flags) =
            (image.type_name(variable.ty).to_string(), flags(variable.flags).join(" "));
        println!("  {:<20} {:<12} {:<12} {flags}", variable.name, location(&variable), ty);
    }
    for (index, object) in image.objects().enumerate() {
        println!("object {index}: {} {}", object.name, object_text(&object));
    }
    for (index, port) in image.ports().enumerate() {
        println!(
            "port {index}: {} {}, {} bytes",
            port.name,
            direction(port.direction),
            port.message_bytes
        );
    }
}

fn as_json(image: &Image<'_>) -> Value {
    let tasks = image.tasks().map(|task| {
        let (period, offset) = match task.kind {
            TaskKind::Cyclic { period, offset } => (Some(period.0), Some(offset.0)),
            TaskKind::Event { minimum, .. } => (Some(minimum.0), None),
            TaskKind::Freewheeling => (None, None),
        };
        let kind = match task.kind {
            TaskKind::Cyclic { .. } => "cyclic",
            TaskKind::Event { .. } => "event",
            TaskKind::Freewheeling => "freewheeling",
        };
        let source = match task.kind {
            TaskKind::Event { source, .. } => Some(source_text(source)),
            TaskKind::Cyclic { .. } | TaskKind::Freewheeling => None,
        };
        json!({
            "name": task.name, "kind": kind, "period_ns": period, "offset_ns": offset,
            "source": source, "priority": task.priority, "budget_ns": task.budget.map(|time| time.0),
            "deadline_ns": task.deadline.map(|time| time.0), "stack_bytes": task.stack_bytes,
            "sensitivity": task.sensitivity,
        })
    });
    let variables = image.variables().map(|variable| {
        let writer = variable.writer.and_then(|task| image.task(task)).map(|task| task.name);
        json!({
            "name": variable.name, "type": image.type_name(variable.ty).to_string(),
            "area": area(variable.area), "offset": variable.offset, "bit": variable.bit,
            "bytes": variable.bytes, "flags": flags(variable.flags), "writer": writer,
        })
    });
    let objects =
        image.objects().map(|object| json!({ "name": object.name, "kind": object_text(&object) }));
    let ports = image.ports().map(|port| {
        let direction = direction(port.direction);
        json!({ "name": port.name, "direction": direction, "message_bytes": port.message_bytes })
    });
    json!({
        "name": image.name(), "version": image.version().to_string(), "category": image.category(),
        "hash": hex(&image.hash()), "layout_hash": hex(&image.layout_hash()),
        "key": image.key().map(|key| hex(&key)), "code_bytes": image.code().len(),
        "constant_bytes": image.constants().len(), "state_bytes": image.state_bytes(),
        "input_bytes": image.area_bytes(Area::Input), "output_bytes": image.area_bytes(Area::Output),
        "marker_bytes": image.area_bytes(Area::Marker), "init": image.init().is_some(),
        "tasks": tasks.collect::<Vec<_>>(), "variables": variables.collect::<Vec<_>>(),
        "objects": objects.collect::<Vec<_>>(), "ports": ports.collect::<Vec<_>>(),
    })
}

fn when(task: &Task<'_>) -> String {
    match task.kind {
        TaskKind::Cyclic { period, offset } if offset.0 == 0 => format!("every {period}"),
        TaskKind::Cyclic { period, offset } => format!("every {period} from {offset} on"),
        TaskKind::Event { source, minimum } => {
            format!("on {}, at most every {minimum}", source_text(source))
        }
        TaskKind::Freewheeling => "freewheeling".into(),
    }
}

fn source_text(source: EventSource<'_>) -> String {
    match source {
        EventSource::Channel(name) => format!("channel {name}"),
        EventSource::Doorbell(name) => format!("doorbell {name}"),
        EventSource::Interrupt(name) => format!("interrupt {name}"),
        EventSource::Rise(name) => format!("rise of {name}"),
    }
}

fn object_text(object: &Object<'_>) -> String {
    match object.kind {
        ObjectKind::Semaphore { ceiling } => format!("semaphore, ceiling {ceiling}"),
        ObjectKind::Queue { message_bytes, depth } => {
            format!("queue, {depth} messages of {message_bytes} bytes")
        }
        ObjectKind::Mailbox { bytes } => format!("mailbox, {bytes} bytes"),
        ObjectKind::Flags => "event flags".into(),
    }
}

fn direction(direction: Direction) -> &'static str {
    match direction {
        Direction::In => "in",
        Direction::Out => "out",
    }
}

fn area(area: Area) -> &'static str {
    match area {
        Area::State => "state",
        Area::Input => "input",
        Area::Output => "output",
        Area::Marker => "marker",
        Area::Constant => "constant",
    }
}

/// As IEC 61131-3 writes it for the process image; area and offset for the rest.
fn location(variable: &Variable<'_>) -> String {
    let letter = match variable.area {
        Area::Input => "%I",
        Area::Output => "%Q",
        Area::Marker => "%M",
        Area::State | Area::Constant => {
            return format!("{}+{}", area(variable.area), variable.offset);
        }
    };
    match variable.bit {
        Some(bit) => format!("{letter}X{}.{bit}", variable.offset),
        None => format!("{letter}B{}", variable.offset),
    }
}

fn flags(flags: Flags) -> Vec<&'static str> {
    let all = [
        (Flags::RETAIN, "retain"),
        (Flags::PERSISTENT, "persistent"),
        (Flags::INPUT, "input"),
        (Flags::OUTPUT, "output"),
        (Flags::CONSTANT, "constant"),
        (Flags::FORCEABLE, "forceable"),
        (Flags::PART, "part"),
    ];
    all.into_iter().filter(|(flag, _)| flags.has(*flag)).map(|(_, name)| name).collect()
}
