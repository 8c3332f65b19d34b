//! Programs, functions and function blocks: their variables, and the order in which bodies are
//! checked.

use std::collections::HashMap;
use std::sync::Arc;

use super::body::Body;
use super::types::Resolved;
use super::{Checker, Entry, Progress};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Constant, GlobalId, Local, LocalId, LocalKind, Place, Routine, RoutineId, Step, StructureKind,
    Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Edge, Name, SectionKind, UnitKind};

/// A unit.
pub(super) struct UnitEntry<'a> {
    pub(super) ast: &'a ast::Unit,
    pub(super) library: bool,
    /// Of its declarations.
    pub(super) progress: Progress,
    /// Whether its body is checked or will be.
    pub(super) wanted: bool,
    /// The structure of its variables, unless it is a function.
    pub(super) structure: Option<TypeId>,
    pub(super) routine: Option<RoutineId>,
    /// The variable and type of a function's result.
    pub(super) result: Option<(LocalId, TypeId)>,
    pub(super) variables: Vec<Variable<'a>>,
    pub(super) by_key: HashMap<&'a str, usize>,
    locals: Vec<Local>,
    /// The variables that a call can name, in the order of their declaration.
    pub(super) parameters: Vec<usize>,
}

impl<'a> UnitEntry<'a> {
    pub(super) fn new(ast: &'a ast::Unit, library: bool) -> Self {
        Self {
            ast,
            library,
            progress: Progress::Waiting,
            wanted: false,
            structure: None,
            routine: None,
            result: None,
            variables: Vec::new(),
            by_key: HashMap::new(),
            locals: Vec::new(),
            parameters: Vec::new(),
        }
    }
}

/// A variable of a unit.
#[derive(Clone, Debug)]
pub(super) struct Variable<'a> {
    pub(super) name: &'a Name,
    /// Its type; none after an error in it.
    pub(super) ty: Option<TypeId>,
    pub(super) kind: SectionKind,
    pub(super) storage: Storage,
    /// Whether it is declared CONSTANT.
    pub(super) constant: bool,
    /// Whether it has an initial value.
    pub(super) initialised: bool,
    /// What it begins with; for parameters that a call leaves out.
    pub(super) initial: Constant,
    pub(super) edge: Option<Edge>,
    /// Its address, as declared.
    pub(super) address: Option<&'a ast::Address>,
    pub(super) read: bool,
    pub(super) written: bool,
}

/// Where a variable lies.
#[derive(Clone, Debug)]
pub(super) enum Storage {
    /// In the instance.
    Field(u32),
    /// In the instance as a reference, which VAR_IN_OUT is for function blocks.
    Reference(u32, TypeId),
    /// In the routine.
    Local(LocalId),
    /// Outside.
    Global(GlobalId),
    /// A global variable, by its index in the checker, which may not be resolved yet.
    External(usize),
    /// Nowhere: it is a constant.
    Constant(TypeId, Constant),
    /// Nowhere: there was an error.
    Nowhere,
}

impl<'a> Checker<'a> {
    /// Checks all units of the project, and of libraries what those need.
    pub(super) fn all_units(&mut self) {
        // Tests come behind the program: what it is, they are checked against.
        for tests in [false, true] {
            if !tests {
                self.want_instances();
            }
            for index in 0..self.units.len() {
                let unit = &self.units[index];
                let own = !unit.library && !self.sources.is_of_library(unit.ast.name.span.file);
                if own && (unit.ast.kind == UnitKind::Test) == tests {
                    self.want(index);
                }
            }
            while let Some(index) = self.waiting.pop() {
                let library = self.units[index].library;
                self.seen_from(library, |checker| checker.unit_body(index));
            }
        }
    }

    /// Wants the programs that a CONFIGURATION runs: those of a library, too, which nothing calls.
    fn want_instances(&mut self) {
        let configurations = self.configurations.clone();
        let resources = configurations.iter().flat_map(|one| &one.resources);
        for instance in resources.flat_map(|resource| &resource.programs) {
            if let Some(Entry::Units(units)) = self.names.get(&instance.program.key) {
                let index = units[0];
                if self.units[index].ast.kind == UnitKind::Program {
                    self.want(index);
                }
            }
        }
    }

    /// Sees to it that the body of a unit is checked.
    pub(super) fn want(&mut self, index: usize) {
        if !self.units[index].wanted {
            self.units[index].wanted = true;
            let span = self.units[index].ast.name.span;
            self.declare_unit(index, span, false);
            self.waiting.push(index);
        }
    }

    /// The structure of a function block or program.
    pub(super) fn unit_type(
        &mut self,
        index: usize,
        span: Span,
        by_reference: bool,
    ) -> Option<TypeId> {
        self.declare_unit(index, span, by_reference)?;
        self.want(index);
        self.units[index].structure
    }

    /// Resolves the declarations of a unit.
    pub(super) fn declare_unit(
        &mut self,
        index: usize,
        span: Span,
        by_reference: bool,
    ) -> Option<()> {
        let library = self.units[index].library;
        self.seen_from(library, |checker| checker.declare_unit_here(index, span, by_reference))
    }

    fn declare_unit_here(&mut self, index: usize, span: Span, by_reference: bool) -> Option<()> {
        let (ast, library) = (self.units[index].ast, self.units[index].library);
        match self.units[index].progress {
            Progress::Done => return Some(()),
            Progress::Begun if by_reference => return Some(()),
            Progress::Begun => {
                let found = format!("`{}` contains itself", ast.name.text);
                self.tell(
                    Diagnostic::new(Code::Recursion, span, found)
                        .hint("a function block can refer to another of its kind with REF_TO"),
                );
                return None;
            }
            Progress::Waiting => self.units[index].progress = Progress::Begun,
        }
        let structure = match ast.kind {
            UnitKind::Function => None,
            UnitKind::FunctionBlock => Some(StructureKind::FunctionBlock),
            UnitKind::Program | UnitKind::Test => Some(StructureKind::Program),
        };
        let name = match ast.kind {
            // That of a test is a text, and no name of a type.
            UnitKind::Test => format!("TEST.{index}"),
            _ => ast.name.text.to_string(),
        };
        let structure = structure.map(|kind| self.program.types.declare(&name, kind));
        self.units[index].structure = structure;
        self.blocks.extend(structure.map(|structure| (structure, index)));
        let location = self.location(ast.name.span);
        let routine = self.program.add_routine(Routine {
            name,
            instance: structure,
            locals: Vec::new(),
            result: None,
            body: Vec::new(),
            location,
        });
        self.units[index].routine = Some(routine);
        let done = self.deeper(span, |checker| {
            let mut body = Body::of_constants(checker);
            body.unit = Some(index);
            let result = body.declarations(ast, structure);
            let Body { variables, by_key, locals, .. } = body;
            let entry = &mut checker.units[index];
            entry.parameters = (0..variables.len())
                .filter(|at| {
                    matches!(
                        variables[*at].kind,
                        SectionKind::Input | SectionKind::Output | SectionKind::InOut
                    )
                })
                .collect();
            (entry.variables, entry.by_key, entry.locals) = (variables, by_key, locals);
            entry.result = result;
            Some(())
        });
        if let Some(structure) = structure {
            // The library changes with the compiler, and tests are never loaded.
            match library || ast.kind == UnitKind::Test {
                true => self.program.types.complete(structure),
                false => self.program.types.complete_with_room(structure),
            }
        }
        let entry = &mut self.units[index];
        entry.progress = Progress::Done;
        let routine = Arc::make_mut(&mut self.program.routines[routine.0 as usize]);
        routine.locals = entry.locals.clone();
        routine.result = entry.result.map(|(local, _)| local);
        done
    }

    fn unit_body(&mut self, index: usize) {
        let entry = &mut self.units[index];
        let ast = entry.ast;
        let Some(routine) = entry.routine else { return };
        let variables = std::mem::take(&mut entry.variables);
        let by_key = std::mem::take(&mut entry.by_key);
        let locals = std::mem::take(&mut entry.locals);
        // What others ask for while this body is checked.
        entry.variables = variables.clone();
        entry.by_key = by_key.clone();
        let mut body = Body::of_constants(self);
        body.unit = Some(index);
        (body.variables, body.by_key, body.locals) = (variables, by_key, locals);
        body.resolve_externals();
        let declared: Vec<Storage> =
            body.variables.iter().map(|variable| variable.storage.clone()).collect();
        let mut block = body.edges(ast.span);
        block.extend(body.block(&ast.body));
        body.warn_of_variables(ast);
        let mut checked = std::mem::take(&mut body.variables);
        // Within the body an input with an edge is the edge. Callers go on assigning the input.
        for (variable, storage) in checked.iter_mut().zip(declared) {
            if variable.edge.is_some() {
                variable.storage = storage;
            }
        }
        body.checker.units[index].variables = checked;
        let locals = std::mem::take(&mut body.locals);
        let routine = Arc::make_mut(&mut self.program.routines[routine.0 as usize]);
        routine.locals = locals;
        routine.body = block;
    }

    /// The place of a unit's own variable.
    pub(super) fn variable_place(
        &self,
        index: Option<usize>,
        storage: &Storage,
        ty: TypeId,
    ) -> Option<Place> {
        let instance = || self.units[index?].structure;
        Some(match storage {
            Storage::Field(field) => Place::instance(instance()?).field(*field, ty),
            Storage::Reference(field, reference) => {
                let place = Place::instance(instance()?).field(*field, *reference);
                let location = crate::hir::Location::default();
                let load = crate::hir::ExprKind::Load(place);
                Place::deref(crate::hir::Expr::new(*reference, load, location), ty)
            }
            Storage::Local(local) => Place::local(*local, ty),
            Storage::Global(global) => Place::global(*global, ty),
            Storage::External(_) | Storage::Constant(..) | Storage::Nowhere => return None,
        })
    }
}

impl<'a> Body<'_, 'a> {
    /// Whether the unit is a function.
    pub(super) fn in_function(&self) -> bool {
        self.unit.is_some_and(|unit| self.checker.units[unit].ast.kind == UnitKind::Function)
    }

    /// Whether the unit is a test, which may look into instances and play the outside world.
    pub(super) fn in_test(&self) -> bool {
        self.unit.is_some_and(|unit| self.checker.units[unit].ast.kind == UnitKind::Test)
    }

    /// All sections of a unit, and a function's result.
    fn declarations(
        &mut self,
        ast: &'a ast::Unit,
        structure: Option<TypeId>,
    ) -> Option<(LocalId, TypeId)> {
        // Constants first: sizes and initial values may need those of a section further down.
        let (constants, others): (Vec<_>, Vec<_>) =
            ast.sections.iter().partition(|section| section.constant.is_some());
        for section in constants.into_iter().chain(others) {
            self.section(section, structure);
        }
        let result = self.type_spec(ast.result.as_ref()?, None)?;
        if matches!(self.checker.program.types.get(result.ty), Type::OpenArray { .. }) {
            let span = ast.name.span;
            self.error(Code::InvalidDeclaration, span, "a result of the type ARRAY[*]");
            return None;
        }
        if self.checker.program.types.has_instance(result.ty) {
            self.short_lived_instance(ast.result.as_ref()?.span);
            return None;
        }
        self.locals.push(Local {
            name: ast.name.text.to_string(),
            ty: result.ty,
            kind: LocalKind::Variable,
            initial: result.initial,
        });
        Some((LocalId(self.locals.len() as u32 - 1), result.ty))
    }

    /// The type of declared variables, with their initial value.
    pub(super) fn variable_type(&mut self, variables: &'a ast::Variables) -> Option<Resolved> {
        let Some(mut resolved) = self.type_spec(&variables.spec, None) else {
            if let Some(initial) = &variables.initial {
                self.initial_apart(initial);
            }
            return None;
        };
        if let Some(initial) = &variables.initial {
            match self.initial(initial, resolved.ty) {
                Some(value) => {
                    let (ty, declared) = (resolved.ty, resolved.initial);
                    resolved.initial = self.completed(value, &declared, ty, initial.span());
                }
                None => self.checker.refuse_gap(initial.span()),
            }
        }
        Some(resolved)
    }

    fn resolve_externals(&mut self) {
        for index in 0..self.variables.len() {
            let Storage::External(global) = self.variables[index].storage else { continue };
            self.resolve_external(index, global);
        }
    }

    /// Statements before the first: the detection of edges of inputs.
    fn edges(&mut self, span: Span) -> Vec<crate::hir::Statement> {
        use crate::hir::{Arithmetic, Elementary, ExprKind, StatementKind, UnaryOperator};
        let mut block = Vec::new();
        let bool_type = self.elementary(Elementary::Bool);
        let Some(structure) = self.unit.and_then(|unit| self.checker.units[unit].structure) else {
            return block;
        };
        for index in 0..self.variables.len() {
            let (Some(edge), Storage::Field(field)) =
                (self.variables[index].edge, self.variables[index].storage.clone())
            else {
                continue;
            };
            // The field behind an input with an edge holds its last value.
            let input = Place::instance(structure).field(field, bool_type);
            let last = Place::instance(structure).field(field + 1, bool_type);
            let name = format!("{}'edge", self.variables[index].name.text);
            let local = self.temporary(&name, bool_type);
            let load = |place: &Place| self.expr(bool_type, ExprKind::Load(place.clone()), span);
            let not = |expr| {
                self.expr(bool_type, ExprKind::Unary(UnaryOperator::Not, Box::new(expr)), span)
            };
            let (now, before) = match edge {
                Edge::Rising => (load(&input), not(load(&last))),
                Edge::Falling => (not(load(&input)), load(&last)),
            };
            let kind = ExprKind::Arithmetic(Arithmetic::And, Box::new(now), Box::new(before));
            let detected = self.expr(bool_type, kind, span);
            let found = StatementKind::Assign(Place::local(local, bool_type), detected);
            let keep = StatementKind::Assign(last, load(&input));
            block.push(self.statement(found, span));
            block.push(self.statement(keep, span));
            self.variables[index].storage = Storage::Local(local);
        }
        block
    }
}

/// Whether a place is a bit or a part of a variable, which has no address.
pub(super) fn is_part(place: &Place) -> bool {
    matches!(place.path.last(), Some(Step::Bit(_) | Step::Part { .. } | Step::Unit(_)))
}
