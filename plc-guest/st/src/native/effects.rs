//! What a part of a routine reads and writes, as far as it can be known before it runs.
//!
//! Promotion of variables to registers rests on this: a variable may live in a register during a loop if nothing else
//! in the loop can see its memory. The answer is conservative. What makes it useful all the same:
//!
//! - An index is anywhere in its array, but not outside: bounds are checked.
//! - References and VAR_IN_OUT refer to variables of exactly their type, so a store of a REAL through one changes no
//!   DINT in the state. What lies at addresses may have several types.
//! - A call changes what its callee's summary says, and what it is given by reference.

use std::collections::BTreeMap;

use crate::hir::{
    Area, Argument, Block, Elementary, Expr, ExprKind, ForLoop, Intrinsic, LocalId, LocalKind,
    Place, Program, Root, Routine, RoutineId, Statement, StatementKind, Step, Type, TypeId,
};

/// Where a block of memory begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Base {
    /// At an area; offsets are from the area's start.
    Area(Area),
    /// At the instance whose body runs.
    Instance,
    /// At a local variable or a parameter that is a copy.
    Local(LocalId),
    /// At what a VAR_IN_OUT parameter stands for.
    Pointer(LocalId),
}

/// A scalar variable, or a scalar part of one, at a place that is known before the program runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Cell {
    /// Where its block begins.
    pub base: Base,
    /// Its offset in bytes.
    pub offset: u32,
    /// Its type.
    pub ty: Elementary,
}

/// What an access touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    /// One scalar.
    Cell(Cell),
    /// Something within a stretch of a block: an element of an array, a string, a bit, an instance.
    Range {
        /// Where the block begins.
        base: Base,
        /// The first byte.
        start: u32,
        /// The byte behind the last.
        end: u32,
        /// The type, if it is a scalar of that type.
        ty: Option<Elementary>,
    },
    /// What a reference refers to; the type, if it is a scalar.
    Indirect(Option<Elementary>),
}

/// How a target is touched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uses {
    /// How often it is written in the text.
    pub writes: u32,
    /// How often it occurs in the text.
    pub total: u32,
}

/// All accesses of a part of a routine.
#[derive(Clone, Debug, Default)]
pub struct Effects {
    /// By target.
    pub accesses: BTreeMap<Target, Uses>,
}

/// More accesses than this to an area by a callee are kept as one stretch.
const SUMMARY_ENTRIES: usize = 64;

impl Effects {
    fn add(&mut self, target: Target, write: bool) {
        let uses = self.accesses.entry(target).or_default();
        uses.total += 1;
        uses.writes += u32::from(write);
    }

    /// Whether `cell` is assigned.
    pub fn writes_to(&self, cell: &Cell) -> bool {
        self.accesses.get(&Target::Cell(*cell)).is_some_and(|uses| uses.writes > 0)
    }

    /// What a caller sees of a routine with these effects.
    pub fn summary(&self) -> Effects {
        let mut seen = Effects::default();
        for (target, uses) in &self.accesses {
            let kept = match *target {
                Target::Cell(Cell { base: Base::Local(_) | Base::Pointer(_), .. })
                | Target::Range { base: Base::Local(_) | Base::Pointer(_), .. } => None,
                Target::Cell(cell) => Some(Target::Range {
                    base: cell.base,
                    start: cell.offset,
                    end: cell.offset + cell.ty.size(),
                    ty: Some(cell.ty),
                }),
                other => Some(other),
            };
            if let Some(target) = kept {
                seen.add(target, uses.writes > 0);
            }
        }
        if seen.accesses.len() > SUMMARY_ENTRIES { seen.hull() } else { seen }
    }

    fn hull(self) -> Effects {
        let mut hulls: BTreeMap<Base, (u32, u32, bool)> = BTreeMap::new();
        let mut out = Effects::default();
        for (target, uses) in self.accesses {
            match target {
                Target::Range { base, start, end, .. } => {
                    let hull = hulls.entry(base).or_insert((start, end, false));
                    *hull = (hull.0.min(start), hull.1.max(end), hull.2 || uses.writes > 0);
                }
                other => out.add(other, uses.writes > 0),
            }
        }
        for (base, (start, end, write)) in hulls {
            out.add(Target::Range { base, start, end, ty: None }, write);
        }
        out
    }
}

/// Whether a place is a variable, field or element, and no part of its value.
fn is_whole(place: &Place) -> bool {
    let part = |step: &Step| matches!(step, Step::Bit(_) | Step::Part { .. } | Step::Unit(_));
    !place.path.iter().any(part)
}

/// Where a place lies, as far as its path says.
pub fn target(program: &Program, routine: &Routine, place: &Place) -> Target {
    let types = &program.types;
    let scalar = types.scalar(place.ty);
    let mut partial = false;
    let (base, mut offset, mut ty) = match &place.root {
        Root::Global(id) => {
            let global = program.global(*id);
            partial = global.storage.bit.is_some();
            (Base::Area(global.storage.area), global.storage.offset, global.ty)
        }
        Root::Local(id) => {
            let local = routine.local(*id);
            let base =
                if local.kind == LocalKind::InOut { Base::Pointer(*id) } else { Base::Local(*id) };
            (base, 0, local.ty)
        }
        Root::Instance => (Base::Instance, 0, routine.instance.unwrap_or(place.ty)),
        Root::Deref(_) => {
            return Target::Indirect(scalar.filter(|_| is_whole(place)));
        }
    };
    for step in &place.path {
        match (step, types.get(ty)) {
            (Step::Field(index), Type::Structure(structure)) => {
                let field = &structure.fields[*index as usize];
                offset += field.offset;
                ty = field.ty;
            }
            (Step::Index(index), Type::Array { element, lower, upper }) => {
                match constant_index(index, *lower, *upper) {
                    Some(at) => {
                        offset += at * types.size(*element);
                        ty = *element;
                    }
                    None => {
                        let ty_of = scalar.filter(|_| is_whole(place));
                        return Target::Range {
                            base,
                            start: offset,
                            end: offset + types.size(ty),
                            ty: ty_of,
                        };
                    }
                }
            }
            (Step::OpenIndex(_), _) => {
                let ty = scalar.filter(|_| is_whole(place));
                return Target::Range { base, start: 0, end: u32::MAX, ty };
            }
            (Step::Bit(_) | Step::Part { .. } | Step::Unit(_), _) => {
                partial = true;
                break;
            }
            (step, ty) => unreachable!("{step:?} of {ty:?}"),
        }
    }
    match scalar {
        Some(scalar) if !partial => Target::Cell(Cell { base, offset, ty: scalar }),
        _ => Target::Range { base, start: offset, end: offset + types.size(ty).max(1), ty: None },
    }
}

/// The distance of a constant index from the lower bound, if it is within the bounds.
pub fn constant_index(index: &Expr, lower: i64, upper: i64) -> Option<u32> {
    match &index.kind {
        ExprKind::Constant(crate::hir::Constant::Integer(value)) => {
            let within = *value >= i128::from(lower) && *value <= i128::from(upper);
            within.then(|| (*value - i128::from(lower)) as u32)
        }
        ExprKind::Convert(crate::hir::Conversion::Value, inner) => {
            constant_index(inner, lower, upper)
        }
        _ => None,
    }
}

/// Collects effects.
pub struct Collector<'p> {
    /// The program.
    pub program: &'p Program,
    /// The routine that the part is of.
    pub routine: &'p Routine,
    /// What each callee does, by its index.
    pub summaries: &'p [Effects],
    /// What was found.
    pub effects: Effects,
}

impl<'p> Collector<'p> {
    /// A collector that found nothing yet.
    pub fn new(program: &'p Program, routine: &'p Routine, summaries: &'p [Effects]) -> Self {
        Collector { program, routine, summaries, effects: Effects::default() }
    }

    /// Adds a block.
    pub fn block(&mut self, block: &Block) {
        block.iter().for_each(|statement| self.statement(statement));
    }

    /// Adds a statement with all in it.
    pub fn statement(&mut self, statement: &Statement) {
        match &statement.kind {
            StatementKind::Assign(place, value) => {
                self.expr(value);
                self.place(place, true);
            }
            StatementKind::Call(routine, arguments) => self.call(*routine, arguments),
            StatementKind::Invoke(place, routine, arguments) => {
                self.place(place, true);
                self.call(*routine, arguments);
            }
            StatementKind::If(arms, otherwise) => {
                for (condition, block) in arms {
                    self.expr(condition);
                    self.block(block);
                }
                self.block(otherwise);
            }
            StatementKind::Case(selector, arms, otherwise) => {
                self.expr(selector);
                arms.iter().for_each(|arm| self.block(&arm.body));
                self.block(otherwise);
            }
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                [from, to, by].into_iter().for_each(|expr| self.expr(expr));
                self.place(variable, true);
                self.place(variable, false);
                self.block(body);
            }
            StatementKind::While(condition, body) | StatementKind::Repeat(body, condition) => {
                self.expr(condition);
                self.block(body);
            }
            StatementKind::Exit | StatementKind::Continue | StatementKind::Return => {}
        }
    }

    fn place(&mut self, place: &Place, write: bool) {
        self.indices(place);
        self.effects.add(target(self.program, self.routine, place), write);
    }

    /// The expressions in a place.
    fn indices(&mut self, place: &Place) {
        if let Root::Deref(reference) = &place.root {
            self.expr(reference);
        }
        for step in &place.path {
            match step {
                Step::Index(index) | Step::Unit(index) => self.expr(index),
                Step::OpenIndex(indices) => indices.iter().for_each(|index| self.expr(index)),
                Step::Field(_) | Step::Bit(_) | Step::Part { .. } => {}
            }
        }
    }

    /// Adds an expression.
    pub fn expr(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Constant(_) => {}
            ExprKind::Load(place) => self.place(place, false),
            ExprKind::Unary(_, operand) | ExprKind::Convert(_, operand) => self.expr(operand),
            ExprKind::Arithmetic(_, left, right)
            | ExprKind::Compare(_, left, right)
            | ExprKind::AndThen(left, right)
            | ExprKind::OrElse(left, right) => {
                self.expr(left);
                self.expr(right);
            }
            ExprKind::Call(routine, arguments) => self.call(*routine, arguments),
            ExprKind::Intrinsic(intrinsic, arguments) => {
                arguments.iter().for_each(|argument| self.expr(argument));
                match (intrinsic, arguments.first().map(|first| &first.kind)) {
                    // Other tasks run meanwhile, and the runner reads what is kept for it.
                    (Intrinsic::Simulate(_), _) => {
                        self.effects.add(Target::Indirect(None), true);
                    }
                    (Intrinsic::ChannelRead(_), Some(ExprKind::Reference(message))) => {
                        self.handed_on(message, true);
                    }
                    (Intrinsic::ChannelWrite(_), Some(ExprKind::Reference(message))) => {
                        self.handed_on(message, false);
                    }
                    _ => {}
                }
            }
            ExprKind::Reference(place) | ExprKind::Bound { place, .. } => self.indices(place),
        }
    }

    fn call(&mut self, routine: RoutineId, arguments: &[Argument]) {
        for argument in arguments {
            match argument {
                Argument::Value(value) => self.expr(value),
                Argument::Reference(place) => {
                    self.indices(place);
                    self.handed_on(place, true);
                }
                Argument::Output(Some(place)) => self.place(place, true),
                Argument::Output(None) => {}
            }
        }
        self.callee(routine);
    }

    /// Its address is given to something that reads it, or writes it too.
    fn handed_on(&mut self, place: &Place, write: bool) {
        let touched = match target(self.program, self.routine, place) {
            Target::Cell(cell) => Target::Range {
                base: cell.base,
                start: cell.offset,
                end: cell.offset + cell.ty.size(),
                ty: None,
            },
            other => other,
        };
        self.effects.add(touched, write);
    }

    fn callee(&mut self, routine: RoutineId) {
        for (target, uses) in &self.summaries[routine.0 as usize].accesses {
            // The caller has added the whole instance.
            let own = matches!(target, Target::Range { base: Base::Instance, .. });
            if !own {
                self.effects.add(*target, uses.writes > 0);
            }
        }
    }
}

/// Where instances of each structure lie in the state: stretches of bytes. An array of instances is one stretch.
pub fn instances(program: &Program) -> BTreeMap<TypeId, Vec<(u32, u32)>> {
    fn walk(
        program: &Program,
        ty: TypeId,
        start: u32,
        end: u32,
        found: &mut BTreeMap<TypeId, Vec<(u32, u32)>>,
    ) {
        match program.types.get(ty) {
            Type::Structure(structure) => {
                let whole = end - start == structure.size;
                found.entry(ty).or_default().push((start, end));
                for field in &structure.fields {
                    let size = program.types.size(field.ty);
                    // Within an array of structures a field is anywhere in the array.
                    let (start, end) = if whole {
                        (start + field.offset, start + field.offset + size)
                    } else {
                        (start, end)
                    };
                    walk(program, field.ty, start, end, found);
                }
            }
            Type::Array { element, .. } => walk(program, *element, start, end, found),
            _ => {}
        }
    }
    let mut found = BTreeMap::new();
    for global in program.globals.iter().filter(|global| global.storage.area == Area::State) {
        let start = global.storage.offset;
        walk(program, global.ty, start, start + program.types.size(global.ty), &mut found);
    }
    found
}
