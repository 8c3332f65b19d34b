//! The program image: what was compiled, with the tables that the kernel and the tools read.

use std::collections::HashMap;

use takt_program::build::{self, Builder, Kind, Place};
use takt_program::{Area, CodeOffset, Flags, Nanoseconds, ObjectKind, TaskId, TrapKind};

use super::Native;
use super::retained::Retained;
use crate::hir::{
    self, Elementary, Global, Location, Program, Retention, StructureKind, TaskKind, Type, TypeId,
};

/// The bytes of the image of a compiled program.
///
/// # Errors
/// What the image's own rules refuse, such as more variables than it can have.
pub fn image(program: &Program, native: &Native) -> Result<Vec<u8>, takt_program::ImageError> {
    let mut builder = Builder::new(&program.name);
    builder.version = program.version;
    builder.category = program.category;
    builder.code.clone_from(&native.code);
    builder.constants.clone_from(&native.constants);
    builder.init = Some(CodeOffset(native.init));
    // Zeros at the end need no room in the file.
    let used = native.state.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    builder.state = native.state[..used].to_vec();
    builder.state_bytes = native.state.len() as u32;
    builder.input_bytes = program.area_size(hir::Area::Input);
    builder.output_bytes = program.area_size(hir::Area::Output);
    builder.marker_bytes = program.area_size(hir::Area::Marker);

    let mut types = Types { program, known: HashMap::new() };
    let mut retained = Retained::new(&program.types);
    for global in &program.globals {
        let ty = types.add(&mut builder, global.ty);
        let mut variable =
            build::Variable::new(&name(&global.name), ty, area(global), global.storage.offset);
        variable.bit = global.storage.bit;
        let (retention, parts) = retained.of(global, takt_program::limit::VARIABLES as usize);
        variable.flags = flags(global).with(kept(retention));
        variable.writer = native.writers.only(program, global).map(TaskId);
        variable.declared = place(program, global.location);
        builder.variable(variable);
        for part in parts {
            let ty = types.add(&mut builder, part.ty);
            let mut built = build::Variable::new(&name(&part.name), ty, area(global), part.offset);
            built.flags = kept(part.retention).with(Flags::PART);
            built.declared = place(program, global.location);
            builder.variable(built);
        }
    }
    for (offset, bytes) in unused(program) {
        let element = builder.elementary(takt_program::Elementary::Byte);
        let upper = i64::from(bytes) - 1;
        let kind = Kind::Array { element, lower: 0, upper };
        let ty = builder.ty(build::Type { name: String::new(), bytes, kind });
        builder.variable(build::Variable::new(
            &format!("unused.{offset}"),
            ty,
            Area::State,
            offset,
        ));
    }
    for (task, stack) in program.tasks.iter().zip(&native.stacks) {
        let entry = CodeOffset(native.routines[task.entry.0 as usize]);
        let mut built = build::Task::new(&name(&task.name), when(&task.kind), entry);
        built.priority = task.priority;
        built.budget = (task.budget_ns > 0).then_some(Nanoseconds(task.budget_ns));
        built.deadline = (task.deadline_ns > 0).then_some(Nanoseconds(task.deadline_ns));
        built.stack_bytes = *stack;
        builder.task(built);
    }
    for object in &program.objects {
        builder.object(build::Object { name: name(&object.name), kind: object_kind(object.kind) });
    }
    for port in &program.ports {
        builder.port(build::Port {
            name: port.name.clone(),
            direction: port.direction,
            message_bytes: port.bytes,
        });
    }
    for site in &native.traps {
        let kind = match site.trap.kind {
            hir::TrapKind::Bounds => TrapKind::Bounds,
            hir::TrapKind::ZeroDivide => TrapKind::ZeroDivide,
            hir::TrapKind::Null => TrapKind::Null,
            hir::TrapKind::LoopBudget => TrapKind::LoopBudget,
            hir::TrapKind::Subrange => TrapKind::Subrange,
        };
        builder.trap(build::Trap {
            at: CodeOffset(site.offset),
            kind,
            place: place(program, site.trap.location),
        });
    }
    for (at, location) in &native.lines {
        if let Some(Place { file, line, .. }) = place(program, *location) {
            builder.line(build::Line { at: CodeOffset(*at), file, line });
        }
    }
    builder.build()
}

/// What no variable has of the state, as (place, bytes): where an older version had something that this one has not. It gets a name,
/// since state without one is taken for data that cannot be carried over.
fn unused(program: &Program) -> Vec<(u32, u32)> {
    let of = |global: &&Global| global.storage.area == hir::Area::State;
    let types = &program.types;
    let mut taken: Vec<_> = program
        .globals
        .iter()
        .filter(of)
        .map(|global| (global.storage.offset, types.size(global.ty), types.align(global.ty)))
        .collect();
    taken.sort_unstable();
    let (mut end, mut unused) = (0, Vec::new());
    for (offset, bytes, align) in taken {
        // Less is a gap of alignment.
        if offset >= end + align {
            unused.push((end, offset - end));
        }
        end = end.max(offset + bytes);
    }
    unused
}

/// A name as images have them: that of an address loses its percent sign. Only names that the compiler made have other
/// characters, such as that of a type without one: `(Stop, Go)` becomes `_Stop,_Go_`.
fn name(name: &str) -> String {
    let allowed = |c: char| if c.is_ascii_alphanumeric() || "_.-[],".contains(c) { c } else { '_' };
    name.trim_start_matches('%').chars().map(allowed).collect()
}

fn place(program: &Program, location: Location) -> Option<Place> {
    let file = program.files.get(usize::from(location.file))?.clone();
    (location.line > 0).then_some(Place { file, line: location.line, column: location.column })
}

fn area(global: &Global) -> Area {
    match global.storage.area {
        hir::Area::State => Area::State,
        hir::Area::Input => Area::Input,
        hir::Area::Output => Area::Output,
        hir::Area::Marker => Area::Marker,
    }
}

fn flags(global: &Global) -> Flags {
    let flags = match global.storage.area {
        hir::Area::Input => Flags::INPUT,
        hir::Area::Output => Flags::OUTPUT,
        _ => Flags::NONE,
    };
    flags.with(if global.constant { Flags::CONSTANT } else { Flags::FORCEABLE })
}

fn kept(retention: Retention) -> Flags {
    match retention {
        Retention::Never | Retention::None => Flags::NONE,
        Retention::Retain => Flags::RETAIN,
        Retention::Persistent => Flags::PERSISTENT,
    }
}

fn when(kind: &TaskKind) -> build::When {
    match kind {
        TaskKind::Cyclic { period_ns, offset_ns } => {
            build::When::Cyclic { period: Nanoseconds(*period_ns), offset: Nanoseconds(*offset_ns) }
        }
        TaskKind::Event { source, minimum_ns } => build::When::Event {
            source: match source {
                hir::Event::Rise(variable) => build::Event::Rise(name(variable)),
                hir::Event::Channel(port) => build::Event::Channel(port.clone()),
            },
            minimum: Nanoseconds(*minimum_ns),
        },
        TaskKind::Freewheeling => build::When::Freewheeling,
    }
}

fn object_kind(kind: hir::ObjectKind) -> ObjectKind {
    match kind {
        hir::ObjectKind::Semaphore { ceiling } => ObjectKind::Semaphore { ceiling },
        hir::ObjectKind::Queue { message, depth } => {
            ObjectKind::Queue { message_bytes: message, depth }
        }
        hir::ObjectKind::Mailbox { bytes } => ObjectKind::Mailbox { bytes },
        hir::ObjectKind::Flags => ObjectKind::Flags,
    }
}

/// Types as the image numbers them: each behind its parts.
struct Types<'p> {
    program: &'p Program,
    known: HashMap<TypeId, takt_program::TypeId>,
}

impl Types<'_> {
    fn add(&mut self, builder: &mut Builder, id: TypeId) -> takt_program::TypeId {
        if let Some(known) = self.known.get(&id) {
            return *known;
        }
        let types = &self.program.types;
        let kind = match types.get(id) {
            Type::Elementary(ty) => Kind::Elementary(elementary(*ty)),
            Type::String { capacity } => Kind::String { length: u32::from(*capacity) },
            Type::WString { capacity } => Kind::WString { length: u32::from(*capacity) },
            Type::Enumeration { base, values, .. } => Kind::Enumeration {
                base: elementary(*base),
                values: values
                    .iter()
                    .map(|(name, value)| (self::name(name), *value as i64))
                    .collect(),
            },
            Type::Subrange { base, lower, upper, .. } => {
                Kind::Subrange { base: elementary(*base), low: *lower as i64, high: *upper as i64 }
            }
            Type::Array { element, lower, upper } => {
                Kind::Array { element: self.add(builder, *element), lower: *lower, upper: *upper }
            }
            // What a reference refers to may contain the reference, and has no number yet: the image does not tell
            // then to what it refers.
            Type::Reference { target } => {
                let target = self.known.get(target).copied();
                Kind::Reference { target: target.unwrap_or_else(|| builder.next_type()) }
            }
            Type::Structure(structure) => {
                let fields = structure.fields.iter().map(|field| build::Field {
                    name: name(&field.name),
                    ty: self.add(builder, field.ty),
                    offset: field.offset,
                });
                let mut fields: Vec<build::Field> = fields.collect();
                // A field that came in a later version may lie in front of older ones.
                fields.sort_by_key(|field| field.offset);
                match structure.kind {
                    StructureKind::Struct => Kind::Structure { fields },
                    StructureKind::FunctionBlock | StructureKind::Program => {
                        Kind::FunctionBlock { fields }
                    }
                }
            }
            Type::OpenArray { .. } => unreachable!("only a parameter is an open array"),
        };
        let ty = match types.get(id) {
            Type::Enumeration { name, .. } | Type::Structure(hir::Structure { name, .. }) => {
                build::Type::new(types.size(id), kind).named(&self::name(name))
            }
            _ => build::Type::new(types.size(id), kind),
        };
        let number = builder.ty(ty);
        self.known.insert(id, number);
        number
    }
}

fn elementary(ty: Elementary) -> takt_program::Elementary {
    use takt_program::Elementary as To;
    match ty {
        Elementary::Bool => To::Bool,
        Elementary::Sint => To::Sint,
        Elementary::Int => To::Int,
        Elementary::Dint => To::Dint,
        Elementary::Lint => To::Lint,
        Elementary::Usint => To::Usint,
        Elementary::Uint => To::Uint,
        Elementary::Udint => To::Udint,
        Elementary::Ulint => To::Ulint,
        Elementary::Byte => To::Byte,
        Elementary::Word => To::Word,
        Elementary::Dword => To::Dword,
        Elementary::Lword => To::Lword,
        Elementary::Real => To::Real,
        Elementary::Lreal => To::Lreal,
        Elementary::Time => To::Time,
        Elementary::Ltime => To::Ltime,
        Elementary::Date => To::Date,
        Elementary::Ldate => To::Ldate,
        Elementary::Tod => To::Tod,
        Elementary::Ltod => To::Ltod,
        Elementary::Dt => To::Dt,
        Elementary::Ldt => To::Ldt,
        Elementary::Char => To::Char,
        Elementary::Wchar => To::Wchar,
    }
}
