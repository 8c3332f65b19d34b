//! Which tasks write which outputs.
//!
//! Each task has a view of the outputs for itself, and the kernel takes out of it what the image says the task writes. A
//! write that is not seen here never leaves a program of several tasks. So what a VAR_IN_OUT stands for counts as
//! written by the task that hands it on, and what a reference refers to by each task that assigns through references of
//! that type.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use super::NativeError;
use super::alias::callees_first;
use super::effects::{Base, Target, target};
use super::walk;
use crate::hir::{
    Area, Argument, Expr, ExprKind, Global, GlobalId, Intrinsic, LocalId, LocalKind, Location,
    Place, Program, Root, Routine, RoutineId, Section, Statement, StatementKind, Step, Storage,
    Type, TypeId,
};

/// Which tasks write each bit of `%Q`: a bit for each task.
pub struct Writers {
    bits: Vec<u16>,
}

impl Writers {
    /// Looks at the whole program.
    ///
    /// # Errors
    /// [`NativeError::ReferredOutput`] and [`NativeError::SharedOutput`]
    pub fn of(program: &Program) -> Result<Writers, NativeError> {
        let facts = facts(program);
        // What tests do is no part of the program. Their task is the last.
        let own = program.tasks.len() - usize::from(program.tests.wanted.is_some());
        let own = program.tasks.iter().take(own);
        let tasks: Vec<Task> = own.map(|task| Task::of(&facts, task.entry)).collect();
        let mut derived: BTreeMap<TypeId, BTreeSet<TypeId>> = BTreeMap::new();
        for (whole, part) in facts.iter().flat_map(|facts| &facts.derived) {
            derived.entry(*whole).or_default().insert(*part);
        }
        let mut bits = vec![0; 8 * program.area_size(Area::Output) as usize];
        let mut firsts: Vec<Vec<(Stretch, Location)>> = vec![Vec::new(); tasks.len()];
        let mut add = |stretch: Stretch, task: usize, location: Location| {
            let end = bits.len().min(stretch.1 as usize);
            if let Some(part) = bits.get_mut(stretch.0 as usize..end) {
                part.iter_mut().for_each(|bit| *bit |= 1u16 << task);
                firsts[task].push((stretch, location));
            }
        };
        let mut by_type: BTreeMap<TypeId, Vec<usize>> = BTreeMap::new();
        for (number, task) in tasks.iter().enumerate() {
            task.written.iter().for_each(|(stretch, location)| add(*stretch, number, *location));
            for ((stretch, ty), (output, location)) in &task.referred {
                let writing = by_type.entry(*ty).or_insert_with(|| {
                    let types = reached(*ty, &derived);
                    let writes = |task: &usize| !tasks[*task].through.is_disjoint(&types);
                    (0..tasks.len()).filter(writes).collect()
                });
                if let [first, second, ..] = writing[..] {
                    let name = |task: usize| program.tasks[task].name.clone();
                    return Err(NativeError::ReferredOutput {
                        output: program.global(*output).name.clone(),
                        location: *location,
                        tasks: [name(first), name(second)],
                    });
                }
                writing.iter().for_each(|task| add(*stretch, *task, *location));
            }
        }
        let writers = Writers { bits };
        match program.globals.iter().find_map(|global| writers.shared(program, global, &firsts)) {
            Some(error) => Err(error),
            None => Ok(writers),
        }
    }

    /// The error about an output that several tasks write: it would never leave the program.
    fn shared(
        &self,
        program: &Program,
        global: &Global,
        firsts: &[Vec<(Stretch, Location)>],
    ) -> Option<NativeError> {
        let tasks = self.tasks(program, global).filter(|tasks| tasks.count_ones() > 1)?;
        let (start, end) = stretch(program, global)?;
        let mut writing = (0..firsts.len()).filter(|task| tasks & 1 << task != 0).map(|task| {
            let mut written = firsts[task].iter();
            let first = written.find(|(part, _)| part.0 < end && start < part.1);
            let location = first.map_or(global.location, |(_, location)| *location);
            (program.tasks[task].name.clone(), location)
        });
        let (first, second) = (writing.next()?, writing.next()?);
        Some(NativeError::SharedOutput {
            output: global.name.clone(),
            tasks: [first.0, second.0],
            locations: [first.1, second.1],
        })
    }

    /// The task that alone writes an output, by its number. Nothing is said of other areas, which have no views.
    pub fn only(&self, program: &Program, global: &Global) -> Option<u16> {
        let tasks = self.tasks(program, global).filter(|tasks| tasks.count_ones() == 1)?;
        Some(tasks.trailing_zeros() as u16)
    }

    /// The tasks that write an output or a part of it.
    fn tasks(&self, program: &Program, global: &Global) -> Option<u16> {
        let (start, end) = stretch(program, global)?;
        let bits = self.bits.get(start as usize..end as usize)?;
        Some(bits.iter().fold(0, |all, bit| all | bit))
    }
}

/// The stretch of `%Q` in which an output lies; none of another variable.
fn stretch(program: &Program, global: &Global) -> Option<Stretch> {
    let Storage { area, offset, bit } = global.storage;
    let stretch = match bit {
        Some(bit) => one_bit(offset, bit),
        None => bytes(offset, offset + program.types.size(global.ty)),
    };
    (area == Area::Output).then_some(stretch)
}

/// The bits from the byte `start` to the one in front of `end`.
fn bytes(start: u32, end: u32) -> Stretch {
    (8 * start, 8 * end)
}

fn one_bit(byte: u32, bit: u8) -> Stretch {
    let first = 8 * byte + u32::from(bit);
    (first, first + 1)
}

/// The types to which a reference may refer that was made from one to `ty`: such as to an element of an array.
fn reached(ty: TypeId, derived: &BTreeMap<TypeId, BTreeSet<TypeId>>) -> BTreeSet<TypeId> {
    let mut found = BTreeSet::from([ty]);
    let mut waiting = vec![ty];
    while let Some(whole) = waiting.pop() {
        let parts = derived.get(&whole).into_iter().flatten().copied();
        waiting.extend(parts.filter(|part| found.insert(*part)));
    }
    found
}

/// Bits of `%Q`: from the first, up to the one behind the last.
type Stretch = (u32, u32);

/// Outputs of which REF is taken, by their stretch of `%Q` and the type of the reference: which, and where first.
type Referred = BTreeMap<(Stretch, TypeId), (GlobalId, Location)>;

/// What is written of `%Q`, and where first.
type Written = BTreeMap<Stretch, Location>;

/// What is known of a routine itself, without its callees.
#[derive(Default)]
struct Facts {
    callees: BTreeSet<RoutineId>,
    written: Written,
    referred: Referred,
    /// The types of what it assigns through references.
    through: BTreeSet<TypeId>,
    /// The types of what a reference refers to, with that of a part of it to which it makes another reference.
    derived: BTreeSet<(TypeId, TypeId)>,
    /// Its parameters that stand for a place of the caller which it assigns, itself or by a callee.
    parameters: BTreeSet<LocalId>,
}

/// The facts of all routines.
fn facts(program: &Program) -> Vec<Facts> {
    let mut known: Vec<Facts> = Vec::new();
    known.resize_with(program.routines.len(), Facts::default);
    for id in callees_first(program) {
        let routine = program.routine(id);
        let mut collector = Collector {
            program,
            routine,
            known: &known,
            facts: Facts::default(),
            handed_on: HashSet::new(),
        };
        walk::statements(&routine.body, &mut |statement| collector.statement(statement));
        walk::expressions(&routine.body, &mut |expr| collector.expr(expr));
        known[id.0 as usize] = collector.facts;
    }
    known
}

/// The facts of all routines that a task may call, together.
#[derive(Default)]
struct Task {
    written: Written,
    referred: Referred,
    through: BTreeSet<TypeId>,
}

impl Task {
    fn of(facts: &[Facts], entry: RoutineId) -> Task {
        let mut task = Task::default();
        let mut seen = BTreeSet::from([entry]);
        let mut waiting = vec![entry];
        while let Some(id) = waiting.pop() {
            let facts = &facts[id.0 as usize];
            for (stretch, first) in &facts.written {
                task.written.entry(*stretch).or_insert(*first);
            }
            task.through.extend(&facts.through);
            for (referred, first) in &facts.referred {
                task.referred.entry(*referred).or_insert(*first);
            }
            waiting.extend(facts.callees.iter().filter(|callee| seen.insert(**callee)));
        }
        task
    }
}

struct Collector<'p> {
    program: &'p Program,
    routine: &'p Routine,
    /// Of the callees.
    known: &'p [Facts],
    facts: Facts,
    /// The references that are no REF: those for a VAR_IN_OUT and of messages.
    handed_on: HashSet<*const Expr>,
}

impl Collector<'_> {
    fn statement(&mut self, statement: &Statement) {
        match &statement.kind {
            StatementKind::Assign(place, value) => {
                self.written(place, statement.location);
                if let ExprKind::Reference(target) = &value.kind
                    && self.is_in_out(place)
                {
                    self.handed_on.insert(value);
                    self.written(target, statement.location);
                }
            }
            StatementKind::For(parts) => self.written(&parts.variable, statement.location),
            StatementKind::Call(routine, arguments)
            | StatementKind::Invoke(_, routine, arguments) => {
                self.call(*routine, arguments, statement.location);
            }
            _ => {}
        }
    }

    fn expr(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Call(routine, arguments) => self.call(*routine, arguments, expr.location),
            ExprKind::Intrinsic(intrinsic, arguments) => {
                let reads = matches!(intrinsic, Intrinsic::ChannelRead(_));
                if (reads || matches!(intrinsic, Intrinsic::ChannelWrite(_)))
                    && let Some(message) = arguments.first()
                    && let ExprKind::Reference(place) = &message.kind
                {
                    self.handed_on.insert(message);
                    if reads {
                        self.written(place, expr.location);
                    }
                }
            }
            ExprKind::Reference(place) if !self.handed_on.contains(&std::ptr::from_ref(expr)) => {
                self.referred(place, expr);
            }
            _ => {}
        }
    }

    fn call(&mut self, routine: RoutineId, arguments: &[Argument], location: Location) {
        self.facts.callees.insert(routine);
        let known = self.known;
        for ((id, parameter), argument) in self.program.routine(routine).parameters().zip(arguments)
        {
            match argument {
                Argument::Value(_) | Argument::Output(None) => {}
                Argument::Output(Some(place)) => self.written(place, location),
                // An open array may be a VAR_INPUT, which is only read.
                Argument::Reference(place) => {
                    let ty = self.program.types.get(parameter.ty);
                    if !matches!(ty, Type::OpenArray { .. })
                        || known[routine.0 as usize].parameters.contains(&id)
                    {
                        self.written(place, location);
                    }
                }
            }
        }
    }

    fn written(&mut self, place: &Place, location: Location) {
        match &place.root {
            Root::Global(_) => {
                if let Some(stretch) = self.output(place) {
                    self.facts.written.entry(stretch).or_insert(location);
                }
            }
            Root::Local(id) if self.routine.local(*id).kind == LocalKind::InOut => {
                self.facts.parameters.insert(*id);
            }
            // What a VAR_IN_OUT stands for is written by the one that hands it on.
            Root::Deref(reference) if !self.loads_in_out(reference) => {
                self.facts.through.extend(self.referred_type(reference));
            }
            _ => {}
        }
    }

    fn referred(&mut self, place: &Place, expr: &Expr) {
        match &place.root {
            Root::Global(id) => {
                if let Some(stretch) = self.output(place) {
                    let first = (*id, expr.location);
                    self.facts.referred.entry((stretch, place.ty)).or_insert(first);
                }
            }
            Root::Deref(reference) => {
                let whole = self.referred_type(reference);
                self.facts.derived.extend(whole.map(|whole| (whole, place.ty)));
            }
            _ => {}
        }
    }

    /// The stretch of `%Q` in which a place lies.
    fn output(&self, place: &Place) -> Option<Stretch> {
        if let Root::Global(id) = &place.root
            && self.program.global(*id).storage.bit.is_some()
        {
            return stretch(self.program, self.program.global(*id));
        }
        match target(self.program, self.routine, place) {
            Target::Cell(cell) if cell.base == Base::Area(Area::Output) => {
                Some(bytes(cell.offset, cell.offset + cell.ty.size()))
            }
            Target::Range { base: Base::Area(Area::Output), start, end, .. } => {
                Some(bytes(start, end))
            }
            _ => None,
        }
    }

    fn referred_type(&self, reference: &Expr) -> Option<TypeId> {
        match self.program.types.get(reference.ty) {
            Type::Reference { target } => Some(*target),
            _ => None,
        }
    }

    fn loads_in_out(&self, reference: &Expr) -> bool {
        matches!(&reference.kind, ExprKind::Load(place) if self.is_in_out(place))
    }

    /// Whether a place is the reference that a function block keeps for a VAR_IN_OUT.
    fn is_in_out(&self, place: &Place) -> bool {
        let types = &self.program.types;
        let mut ty = match &place.root {
            Root::Global(id) => self.program.global(*id).ty,
            Root::Local(id) => self.routine.local(*id).ty,
            Root::Instance => match self.routine.instance {
                Some(ty) => ty,
                None => return false,
            },
            Root::Deref(reference) => match self.referred_type(reference) {
                Some(ty) => ty,
                None => return false,
            },
        };
        let mut found = false;
        for step in &place.path {
            found = false;
            ty = match (step, types.get(ty)) {
                (Step::Field(index), Type::Structure(structure)) => {
                    let field = &structure.fields[*index as usize];
                    found = field.section == Section::InOut;
                    field.ty
                }
                (
                    Step::Index(_) | Step::OpenIndex(_),
                    Type::Array { element, .. } | Type::OpenArray { element, .. },
                ) => *element,
                _ => return false,
            };
        }
        found
    }
}

#[cfg(test)]
#[path = "writers_tests.rs"]
mod tests;
