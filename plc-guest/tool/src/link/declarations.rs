//! From the declarations in the object files to the tables of the image.

use std::ops::Range;

use takt_program::build::{Builder, Event, Kind, Object, Port, Task, Trap, Type, Variable, When};
use takt_program::{
    Area, CodeOffset, Direction, Elementary, Flags, Nanoseconds, ObjectKind, TaskId, TrapKind,
    TypeId, Version, address, limit,
};
use takt_sdk::declaration::kind;

use super::LinkError;
use super::declared::{self, Declared};
use super::elf::Program;
use super::names::Names;

const DEFAULT_STACK: u32 = 16 << 10;

/// An image in the making with everything that the program declares, its code and its data; and the names of that.
pub fn builder(program: &Program) -> Result<(Builder, Names), LinkError> {
    let mut declared = declared::read(program)?;
    // The order of declarations in a file is the compiler's; that of names is the author's.
    declared.sort_by_key(|declared| declared.name.to_ascii_lowercase());
    let mut builder = Builder::new("");
    builder.code.clone_from(&program.code);
    builder.constants.clone_from(&program.constants);
    builder.state.clone_from(&program.state);
    let too_large = |_| LinkError::Declared {
        what: "program",
        name: "state".into(),
        why: format!("it has {} bytes, the limit is {}", program.state_bytes, limit::STATE_BYTES),
    };
    builder.state_bytes = u32::try_from(program.state_bytes).map_err(too_large)?;
    head(&mut builder, program, &declared)?;
    let (names, written) = (Names::default(), Vec::new());
    let mut maker = Maker { builder, program, names, writers: Vec::new(), written };
    for declared in &declared {
        maker.task_or_writer(declared)?;
    }
    for declared in &declared {
        maker.rest(declared)?;
    }
    maker.check_writers()?;
    let (mut builder, mut names) = (maker.builder, maker.names);
    // As the image has them.
    names.points.sort_by_key(|point| point.name.to_ascii_lowercase());
    for at in program.user_traps.iter().filter_map(|&address| code_offset(program, address)) {
        builder.trap(Trap { at, kind: TrapKind::User, place: None });
    }
    Ok((builder, names))
}

/// Name, version and `init`, each of which there is once.
fn head(builder: &mut Builder, program: &Program, declared: &[Declared]) -> Result<(), LinkError> {
    let mut programs = declared.iter().filter(|declared| declared.kind == kind::PROGRAM);
    let head = programs.next().ok_or(LinkError::NoProgram)?;
    if programs.next().is_some() {
        return Err(LinkError::Twice { what: "the program" });
    }
    let number =
        |index: usize| head.narrow("program", "a version or category", head.numbers[index]);
    builder.name.clone_from(&head.name);
    builder.version = Version { major: number(0)?, minor: number(1)?, patch: number(2)? };
    builder.category = head.narrow("program", "a category", head.numbers[3])?;
    let mut inits = declared.iter().filter(|declared| declared.kind == kind::INIT);
    if let Some(init) = inits.next() {
        builder.init = Some(function(program, init, "init")?);
    }
    if inits.next().is_some() {
        return Err(LinkError::Twice { what: "init" });
    }
    Ok(())
}

struct Maker<'a> {
    builder: Builder,
    program: &'a Program,
    names: Names,
    /// Which task writes which point, and whether there is such a point.
    writers: Vec<Writer>,
    written: Vec<Written>,
}

/// An output: its first bit, the first bit behind it, and which task writes it.
struct Written {
    name: String,
    bits: Range<u32>,
    task: TaskId,
}

struct Writer {
    task: String,
    point: String,
    found: bool,
}

impl Maker<'_> {
    fn task_or_writer(&mut self, declared: &Declared) -> Result<(), LinkError> {
        let (task, point) = (declared.name.clone(), declared.text.clone());
        match declared.kind {
            kind::CYCLIC | kind::EVENT | kind::FREEWHEELING => self.task(declared),
            kind::WRITES if self.writers.iter().any(|writer| writer.point == point) => {
                let why = "two writers are declared for it; an output has one".into();
                Err(LinkError::Declared { what: "point", name: point, why })
            }
            kind::WRITES => {
                self.writers.push(Writer { task, point, found: false });
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// A declared writer is of a point that there is.
    fn check_writers(&self) -> Result<(), LinkError> {
        match self.writers.iter().find(|writer| !writer.found) {
            None => Ok(()),
            Some(Writer { point, task, .. }) => {
                let why = format!("task `{task}` is said to write it, but there is no such point");
                Err(LinkError::Declared { what: "point", name: point.clone(), why })
            }
        }
    }

    /// The task that writes a point: the declared one, or the only one there is for an output.
    fn writer(&mut self, declared: &Declared, area: Area) -> Result<Option<TaskId>, LinkError> {
        let told = self.writers.iter_mut().find(|writer| writer.point == declared.name);
        if let Some(writer) = told {
            writer.found = true;
            let index = self.names.tasks.iter().position(|task| task.name == writer.task);
            let unknown = || format!("there is no task `{}` to write it", writer.task);
            let index = index.ok_or_else(|| declared.error("point", unknown()))?;
            return Ok(Some(TaskId(index as u16)));
        }
        match (area, self.names.tasks.len()) {
            (Area::Output, 1) => Ok(Some(TaskId(0))),
            (Area::Output, _) => {
                let why = "the program has several tasks: say which one writes it (TAKT_WRITES in C, writes! in Rust)";
                Err(declared.error("output", why.into()))
            }
            _ => Ok(None),
        }
    }

    fn rest(&mut self, declared: &Declared) -> Result<(), LinkError> {
        let [a, b, ..] = declared.numbers;
        let bytes = |number| declared.narrow("object", "a size", number);
        let object = match declared.kind {
            kind::PROGRAM | kind::INIT | kind::WRITES => return Ok(()),
            kind::CYCLIC | kind::EVENT | kind::FREEWHEELING => return Ok(()),
            kind::VARIABLE => return self.variable(declared),
            kind::PORT_IN | kind::PORT_OUT => {
                let incoming = declared.kind == kind::PORT_IN;
                let direction = if incoming { Direction::In } else { Direction::Out };
                let name = declared.name.clone();
                self.names.ports.push(declared.into());
                let id = self.builder.port(Port { name, direction, message_bytes: bytes(a)? });
                return self.number(declared, id);
            }
            kind::SEMAPHORE => {
                ObjectKind::Semaphore { ceiling: declared.narrow("semaphore", "a ceiling", a)? }
            }
            kind::QUEUE => ObjectKind::Queue { message_bytes: bytes(a)?, depth: bytes(b)? },
            kind::MAILBOX => ObjectKind::Mailbox { bytes: bytes(a)? },
            kind::FLAGS => ObjectKind::Flags,
            other => {
                return Err(declared.error("declaration", format!("there is no kind {other}")));
            }
        };
        self.names.objects.push(declared.into());
        let id = self.builder.object(Object { name: declared.name.clone(), kind: object });
        self.number(declared, id)
    }

    fn task(&mut self, declared: &Declared) -> Result<(), LinkError> {
        let [period, offset, priority, budget, deadline, stack, sensitivity, _] = declared.numbers;
        let some = |time| (time != 0).then_some(Nanoseconds(time));
        let when = match declared.kind {
            kind::CYCLIC => {
                When::Cyclic { period: Nanoseconds(period), offset: Nanoseconds(offset) }
            }
            kind::EVENT => When::Event { source: source(declared)?, minimum: Nanoseconds(period) },
            _ => When::Freewheeling,
        };
        self.names.tasks.push(declared.into());
        self.builder.task(Task {
            name: declared.name.clone(),
            when,
            priority: declared.narrow("task", "a priority", priority)?,
            budget: some(budget),
            deadline: some(deadline),
            stack_bytes: match declared.narrow("task", "a stack", stack)? {
                0 => DEFAULT_STACK,
                bytes => bytes,
            },
            entry: function(self.program, declared, "task")?,
            sensitivity: declared.narrow("task", "a sensitivity", sensitivity)?,
        });
        Ok(())
    }

    fn variable(&mut self, declared: &Declared) -> Result<(), LinkError> {
        let what = "point";
        let [elements, flags, bit, ..] = declared.numbers;
        let (ty, bytes) = self.type_of(declared, elements)?;
        let (area, offset) = self.place(declared, bytes)?;
        let flags = u16::try_from(flags).ok().and_then(Flags::from_bits);
        let flags =
            flags.ok_or_else(|| declared.error(what, "it has flags that there are not".into()))?;
        let changing = [Flags::RETAIN, Flags::PERSISTENT, Flags::FORCEABLE];
        if area == Area::Constant && changing.into_iter().any(|flag| flags.has(flag)) {
            let why = "it is constant, and can be neither retained nor forced";
            return Err(declared.error(what, why.into()));
        }
        let bit: u8 = declared.narrow(what, "a bit", bit)?;
        let writer = self.writer(declared, area)?;
        if let (Area::Output, Some(task)) = (area, writer) {
            let first = offset * 8 + u32::from(bit.saturating_sub(1));
            let count = if bit == 0 { bytes as u32 * 8 } else { 1 };
            self.write(declared, first..first + count, task)?;
        }
        self.names.points.push(declared.into());
        let variable = Variable::new(&declared.name, ty, area, offset).with(flags);
        self.builder.variable(Variable { bit: bit.checked_sub(1), writer, ..variable });
        let end = offset + bytes as u32;
        let image = match area {
            Area::Input => &mut self.builder.input_bytes,
            Area::Output => &mut self.builder.output_bytes,
            Area::Marker => &mut self.builder.marker_bytes,
            Area::State | Area::Constant => return Ok(()),
        };
        *image = end.max(*image);
        Ok(())
    }

    /// Refuses two tasks that write the same.
    fn write(
        &mut self,
        declared: &Declared,
        bits: Range<u32>,
        task: TaskId,
    ) -> Result<(), LinkError> {
        let common = |other: &&Written| {
            other.task != task && other.bits.start < bits.end && bits.start < other.bits.end
        };
        if let Some(other) = self.written.iter().find(common) {
            let name = |task: TaskId| self.names.tasks[usize::from(task.0)].name.clone();
            let shared = LinkError::Shared {
                first: other.name.clone(),
                second: declared.name.clone(),
                tasks: (name(other.task), name(task)),
            };
            return Err(shared.at(declared.place.as_ref()));
        }
        self.written.push(Written { name: declared.name.clone(), bits, task });
        Ok(())
    }

    /// The type, and its size.
    fn type_of(&mut self, declared: &Declared, elements: u64) -> Result<(TypeId, u64), LinkError> {
        let (element, bytes) = self.element(declared)?;
        if elements == 0 {
            return Ok((element, bytes.into()));
        }
        let count: u32 = declared.narrow("point", "a number of elements", elements)?;
        let bytes = count.checked_mul(bytes).filter(|bytes| *bytes <= limit::STATE_BYTES);
        let bytes = bytes.ok_or_else(|| declared.error("point", "it is too large".into()))?;
        let array = Kind::Array { element, lower: 0, upper: i64::from(count) - 1 };
        Ok((self.builder.ty(Type::new(bytes, array)), bytes.into()))
    }

    /// The type of the value, or of an element.
    fn element(&mut self, declared: &Declared) -> Result<(TypeId, u32), LinkError> {
        if declared.text == "STRING" {
            let length = declared.narrow("point", "a number of characters", declared.numbers[3])?;
            let bytes = u32::checked_add(length, 1).filter(|bytes| *bytes <= limit::STATE_BYTES);
            let bytes = bytes.ok_or_else(|| declared.error("point", "it is too large".into()))?;
            return Ok((self.builder.ty(Type::new(bytes, Kind::String { length })), bytes));
        }
        let elementary = Elementary::ALL.iter().find(|ty| ty.keyword() == declared.text);
        let unknown = || declared.error("point", format!("there is no type {}", declared.text));
        let elementary = *elementary.ok_or_else(unknown)?;
        Ok((self.builder.elementary(elementary), elementary.bytes()))
    }

    /// In which area a variable lies, and where in it.
    fn place(&self, declared: &Declared, bytes: u64) -> Result<(Area, u32), LinkError> {
        let constants = address::constants(self.program.code.len() as u32);
        let image = u64::from(limit::PROCESS_IMAGE_BYTES);
        let areas = [
            (Area::State, address::STATE, self.program.state_bytes),
            (Area::Constant, constants, self.program.constants.len() as u64),
            (Area::Input, address::INPUT, image),
            (Area::Output, address::OUTPUT, image),
            (Area::Marker, address::MARKER, image),
        ];
        let inside = |&(_, base, size): &(Area, u64, u64)| {
            let offset = declared.address.checked_sub(base)?;
            (offset.checked_add(bytes)? <= size).then_some(offset)
        };
        let found = areas.iter().find_map(|area| Some((area.0, inside(area)? as u32)));
        let outside = format!("its address {:#x} is in no memory of the program", declared.address);
        found.ok_or_else(|| declared.error("point", outside))
    }

    /// Writes the number of an object where the program reads it.
    fn number(&mut self, declared: &Declared, id: u32) -> Result<(), LinkError> {
        let why = match self.place(declared, 4)? {
            (Area::Constant, offset) => {
                let offset = offset as usize;
                self.builder.constants[offset..offset + 4].copy_from_slice(&id.to_le_bytes());
                return Ok(());
            }
            // A change would keep the number, and the new version may have given it to another object.
            (Area::State, _) => {
                "its number lies in the state; compile the program with the takt.h of this version"
            }
            _ => "its number lies in the process image",
        };
        Err(declared.error("object", why.into()))
    }
}

fn source(declared: &Declared) -> Result<Event, LinkError> {
    let (kind, name) = declared.text.split_once(':').unwrap_or(("", ""));
    let name = name.to_owned();
    match kind {
        "channel" => Ok(Event::Channel(name)),
        "doorbell" => Ok(Event::Doorbell(name)),
        "interrupt" => Ok(Event::Interrupt(name)),
        "rise" => Ok(Event::Rise(name)),
        _ => {
            let allowed = "allowed are channel:, doorbell:, interrupt: and rise: with a name";
            Err(declared.error("task", format!("its event is `{}`; {allowed}", declared.text)))
        }
    }
}

fn function(
    program: &Program,
    declared: &Declared,
    what: &'static str,
) -> Result<CodeOffset, LinkError> {
    code_offset(program, declared.address)
        .ok_or_else(|| declared.error(what, "its function is not in the code".into()))
}

fn code_offset(program: &Program, address: u64) -> Option<CodeOffset> {
    let offset = address.checked_sub(address::CODE)?;
    (offset < program.code.len() as u64).then_some(CodeOffset(offset as u32))
}
