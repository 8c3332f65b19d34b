//! Descriptions as records of the file.

use alloc::collections::BTreeMap;
use alloc::string::String;
use alloc::vec::Vec;

use super::describe::{
    Event, Field, Kind, Line, Object, Place, Port, Task, Trap, Type, Variable, When,
};
use crate::layout::{self, NO_BIT, NO_TASK};
use crate::object::kind as object_kind;
use crate::task::kind as task_kind;
use crate::types::kind as type_kind;
use crate::{Area, ObjectKind, address};

/// A table of records in the making, with numbers put at their places.
pub struct Table {
    pub bytes: Vec<u8>,
    record: usize,
}

impl Table {
    pub fn new(record: usize) -> Self {
        Self { bytes: Vec::new(), record }
    }

    /// Begins the next record, all zeros.
    fn next(&mut self) {
        self.bytes.resize(self.bytes.len() + self.record, 0);
    }

    /// Puts a number into the last record.
    fn put<const N: usize>(&mut self, at: usize, number: [u8; N]) {
        let start = self.bytes.len() - self.record + at;
        self.bytes[start..start + N].copy_from_slice(&number);
    }

    fn put_u32(&mut self, at: usize, number: u32) {
        self.put(at, number.to_le_bytes());
    }

    fn put_u64(&mut self, at: usize, number: u64) {
        self.put(at, number.to_le_bytes());
    }

    fn put_text(&mut self, at: usize, (offset, length): (u32, u32)) {
        self.put_u32(at, offset);
        self.put_u32(at + 4, length);
    }
}

/// The strings section in the making. The same string is kept once.
#[derive(Default)]
pub struct Texts {
    pub bytes: Vec<u8>,
    there: BTreeMap<String, (u32, u32)>,
}

impl Texts {
    pub fn add(&mut self, text: &str) -> (u32, u32) {
        if text.is_empty() {
            return (0, 0);
        }
        if let Some(&at) = self.there.get(text) {
            return at;
        }
        // A section or string beyond a u32 is beyond its limit too, and refused when it is read.
        let at = (self.bytes.len() as u32, text.len() as u32);
        self.bytes.extend_from_slice(text.as_bytes());
        self.there.insert(text.into(), at);
        at
    }

    fn place(&mut self, place: Option<&Place>) -> ((u32, u32), u32, u32) {
        place.map_or(((0, 0), 0, 0), |place| (self.add(&place.file), place.line, place.column))
    }
}

/// The three tables of types.
pub struct Types {
    pub types: Table,
    pub fields: Table,
    pub values: Table,
}

pub fn types(types: &[Type], texts: &mut Texts) -> Types {
    use layout::ty as at;
    let mut tables = Types {
        types: Table::new(at::BYTES),
        fields: Table::new(layout::field::BYTES),
        values: Table::new(layout::enumerator::BYTES),
    };
    let mut depths: Vec<u16> = Vec::new();
    for ty in types {
        let depth_of = |id: crate::TypeId| depths.get(id.0 as usize).copied().unwrap_or(0);
        let (mut first, mut count, mut base, mut low, mut high, mut depth) = (0, 0, 0, 0, 0, 1);
        let kind = match &ty.kind {
            Kind::Elementary(elementary) => {
                base = elementary.code();
                type_kind::ELEMENTARY
            }
            Kind::String { length } => {
                count = *length;
                type_kind::STRING
            }
            Kind::WString { length } => {
                count = *length;
                type_kind::WSTRING
            }
            Kind::Array { element, lower, upper } => {
                (first, low, high) = (element.0, *lower, *upper);
                depth = depth_of(*element).saturating_add(1);
                type_kind::ARRAY
            }
            Kind::Structure { fields } | Kind::FunctionBlock { fields } => {
                first = (tables.fields.bytes.len() / layout::field::BYTES) as u32;
                count = fields.len() as u32;
                let deepest = fields.iter().map(|field| depth_of(field.ty)).max();
                depth = deepest.unwrap_or(0).saturating_add(1);
                fields.iter().for_each(|field| add_field(&mut tables.fields, field, texts));
                let structure = matches!(ty.kind, Kind::Structure { .. });
                if structure { type_kind::STRUCTURE } else { type_kind::FUNCTION_BLOCK }
            }
            Kind::Enumeration { base: of, values } => {
                base = of.code();
                first = (tables.values.bytes.len() / layout::enumerator::BYTES) as u32;
                count = values.len() as u32;
                for (name, value) in values {
                    tables.values.next();
                    tables.values.put_text(layout::enumerator::NAME, texts.add(name));
                    tables.values.put(layout::enumerator::VALUE, value.to_le_bytes());
                }
                type_kind::ENUMERATION
            }
            Kind::Subrange { base: of, low: lowest, high: highest } => {
                (base, low, high) = (of.code(), *lowest, *highest);
                type_kind::SUBRANGE
            }
            Kind::Reference { target } => {
                first = target.0;
                type_kind::REFERENCE
            }
        };
        depths.push(depth);
        let table = &mut tables.types;
        table.next();
        table.put(at::KIND, [kind, base]);
        table.put(at::DEPTH, depth.to_le_bytes());
        table.put_u32(at::SIZE, ty.bytes);
        table.put_text(at::NAME, texts.add(&ty.name));
        table.put_u32(at::FIRST, first);
        table.put_u32(at::COUNT, count);
        table.put(at::LOW, low.to_le_bytes());
        table.put(at::HIGH, high.to_le_bytes());
    }
    tables
}

fn add_field(table: &mut Table, field: &Field, texts: &mut Texts) {
    table.next();
    table.put_text(layout::field::NAME, texts.add(&field.name));
    table.put_u32(layout::field::TYPE, field.ty.0);
    table.put_u32(layout::field::OFFSET, field.offset);
}

pub fn variables<'a>(
    variables: impl Iterator<Item = &'a Variable>,
    types: &[Type],
    texts: &mut Texts,
) -> Table {
    use layout::variable as at;
    let mut table = Table::new(at::BYTES);
    for variable in variables {
        let bytes = types.get(variable.ty.0 as usize).map_or(0, |ty| ty.bytes);
        let (file, line, _) = texts.place(variable.declared.as_ref());
        table.next();
        table.put_text(at::NAME, texts.add(&variable.name));
        table.put_u32(at::TYPE, variable.ty.0);
        table.put(at::AREA, [Area::code(variable.area), variable.bit.unwrap_or(NO_BIT)]);
        table.put(at::FLAGS, variable.flags.bits().to_le_bytes());
        table.put_u32(at::OFFSET, variable.offset);
        table.put_u32(at::SIZE, bytes);
        table.put(at::WRITER, variable.writer.map_or(NO_TASK, |task| task.0).to_le_bytes());
        table.put_u32(at::LINE, line);
        table.put_text(at::FILE, file);
    }
    table
}

pub fn tasks(tasks: &[Task], texts: &mut Texts) -> Table {
    use layout::task as at;
    let mut table = Table::new(at::BYTES);
    for task in tasks {
        let (kind, period, offset) = match &task.when {
            When::Cyclic { period, offset } => (task_kind::CYCLIC, period.0, offset.0),
            When::Event { minimum, .. } => (task_kind::EVENT, minimum.0, 0),
            When::Freewheeling => (task_kind::FREEWHEELING, 0, 0),
        };
        let (source_kind, source) = match &task.when {
            When::Event { source: Event::Channel(name), .. } => (task_kind::CHANNEL, name.as_str()),
            When::Event { source: Event::Doorbell(name), .. } => {
                (task_kind::DOORBELL, name.as_str())
            }
            When::Event { source: Event::Interrupt(name), .. } => {
                (task_kind::INTERRUPT, name.as_str())
            }
            When::Event { source: Event::Rise(name), .. } => (task_kind::RISE, name.as_str()),
            When::Cyclic { .. } | When::Freewheeling => (0, ""),
        };
        let stack = task.stack_bytes.checked_next_multiple_of(address::PAGE as u32);
        table.next();
        table.put_text(at::NAME, texts.add(&task.name));
        table.put(at::KIND, [kind, task.priority]);
        table.put(at::SENSITIVITY, task.sensitivity.to_le_bytes());
        table.put_u32(at::STACK, stack.unwrap_or(u32::MAX));
        table.put_u64(at::PERIOD, period);
        table.put_u64(at::OFFSET, offset);
        table.put_u64(at::BUDGET, task.budget.unwrap_or_default().0);
        table.put_u64(at::DEADLINE, task.deadline.unwrap_or_default().0);
        table.put_u32(at::ENTRY, task.entry.0);
        table.put_u32(at::SOURCE_KIND, source_kind);
        table.put_text(at::SOURCE, texts.add(source));
    }
    table
}

pub fn objects(objects: &[Object], texts: &mut Texts) -> Table {
    use layout::object as at;
    let mut table = Table::new(at::BYTES);
    for object in objects {
        let (kind, a, b) = match object.kind {
            ObjectKind::Semaphore { ceiling } => (object_kind::SEMAPHORE, ceiling.into(), 0),
            ObjectKind::Queue { message_bytes, depth } => {
                (object_kind::QUEUE, message_bytes, depth)
            }
            ObjectKind::Mailbox { bytes } => (object_kind::MAILBOX, bytes, 0),
            ObjectKind::Flags => (object_kind::FLAGS, 0, 0),
        };
        table.next();
        table.put_text(at::NAME, texts.add(&object.name));
        table.put(at::KIND, [kind]);
        table.put_u32(at::A, a);
        table.put_u32(at::B, b);
    }
    table
}

pub fn ports(ports: &[Port], texts: &mut Texts) -> Table {
    use layout::port as at;
    let mut table = Table::new(at::BYTES);
    for port in ports {
        table.next();
        table.put_text(at::NAME, texts.add(&port.name));
        table.put(at::DIRECTION, [port.direction.code()]);
        table.put_u32(at::SIZE, port.message_bytes);
    }
    table
}

pub fn traps<'a>(traps: impl Iterator<Item = &'a Trap>, texts: &mut Texts) -> Table {
    use layout::trap as at;
    let mut table = Table::new(at::BYTES);
    for trap in traps {
        let (file, line, column) = texts.place(trap.place.as_ref());
        table.next();
        table.put_u32(at::OFFSET, trap.at.0);
        table.put(at::KIND, [trap.kind.code()]);
        table.put_text(at::FILE, file);
        table.put_u32(at::LINE, line);
        table.put_u32(at::COLUMN, column);
    }
    table
}

pub fn lines<'a>(lines: impl Iterator<Item = &'a Line>, texts: &mut Texts) -> Table {
    use layout::line as at;
    let mut table = Table::new(at::BYTES);
    for line in lines {
        table.next();
        table.put_u32(at::OFFSET, line.at.0);
        table.put_u32(at::LINE, line.line);
        table.put_text(at::FILE, texts.add(&line.file));
    }
    table
}

pub fn requirements(input: u32, output: u32, marker: u32) -> Table {
    use layout::requirements as at;
    let mut table = Table::new(at::BYTES);
    table.next();
    table.put_u32(at::INPUT, input);
    table.put_u32(at::OUTPUT, output);
    table.put_u32(at::MARKER, marker);
    table
}
