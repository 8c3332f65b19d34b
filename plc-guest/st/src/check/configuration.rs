//! CONFIGURATION: which instances of programs its tasks run. What the tasks are is in `task`.

use std::collections::{HashMap, HashSet};

use super::body::Body;
use super::declare::retention;
use super::expression::Operand;
use super::placement::Placements;
use super::task::Properties;
use super::types::Resolved;
use super::unit::Storage;
use super::{Checker, Entry};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    ExprKind, GlobalId, Place, Routine, Statement, StatementKind, Task, TaskKind, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Binding, ProgramInstance, Resource, SectionKind, UnitKind};

/// The tasks of an image.
pub(super) const TASKS: usize = 16;

/// The task of programs without one.
const FREE: &str = "free";

/// An instance of a program while its task is put together.
struct Instance<'a> {
    ast: &'a ProgramInstance,
    unit: usize,
    global: GlobalId,
    ty: TypeId,
}

impl<'a> Checker<'a> {
    pub(super) fn configurations(&mut self) {
        // There may be one only. What is wrong in another one is told too.
        for (place, configuration) in self.configurations.clone().into_iter().enumerate() {
            self.configuration(configuration, place == 0);
        }
    }

    fn configuration(&mut self, configuration: &'a ast::Configuration, first: bool) {
        let before = self.program.tasks.len();
        if let [_, second, ..] = &configuration.resources[..] {
            let one =
                Diagnostic::new(Code::NotSupported, second.span.before(), "a second RESOURCE");
            self.tell(one.allowed("one RESOURCE: a program image runs on one processor"));
        }
        let mut placements = self.placements(configuration);
        let mut names: HashMap<&str, Span> = HashMap::new();
        for resource in &configuration.resources {
            for (name, span) in
                resource.tasks.iter().map(|task| (&task.name, task.name.span)).chain(
                    resource.programs.iter().map(|program| (&program.name, program.name.span)),
                )
            {
                if let Some(other) = names.insert(&name.key, span) {
                    self.duplicate(name, other);
                }
            }
            self.refuse_taken(resource);
            self.resource(resource, &mut placements);
            self.warn_of_shared_outputs(resource);
        }
        if first {
            self.refuse_unplaced(&placements);
        }
        let tasks = self.program.tasks.len() - before;
        if tasks > TASKS {
            let span = configuration.name.span;
            let found = format!("{tasks} tasks");
            let one = Diagnostic::new(Code::InvalidTask, span, found);
            self.tell(one.allowed(format!("at most {TASKS}")));
        }
    }

    /// Refuses an instance with the name of a global variable, and a task with the name of the one that is made for
    /// programs without a task: an image has each name once.
    fn refuse_taken(&mut self, resource: &'a Resource) {
        for instance in &resource.programs {
            if let Some(Entry::Global(index)) = self.names.get(&instance.name.key) {
                let other = self.globals[*index].name.span;
                self.duplicate(&instance.name, other);
            }
        }
        let free = resource.programs.iter().find(|instance| instance.task.is_none());
        let named = resource.tasks.iter().find(|task| task.name.key.eq_ignore_ascii_case(FREE));
        if let (Some(free), Some(named)) = (free, named) {
            let found = format!("a task `{}` beside a program without a task", named.name.text);
            let one = Diagnostic::new(Code::DuplicateName, named.name.span, found);
            self.tell(one.related(free.name.span, "this program gets a task of that name"));
        }
    }

    /// A variable with an address lies in one place, so of two instances that write an output the last one counts.
    fn warn_of_shared_outputs(&mut self, resource: &'a Resource) {
        let mut first: HashMap<&str, Span> = HashMap::new();
        for instance in &resource.programs {
            let Some(other) = first.insert(&instance.program.key, instance.name.span) else {
                continue;
            };
            let Some(Entry::Units(units)) = self.names.get(&instance.program.key) else { continue };
            let output = self.units[units[0]].variables.iter().find(|variable| {
                variable.written
                    && matches!(variable.storage, Storage::Global(id)
                        if self.program.global(id).storage.area == crate::hir::Area::Output)
            });
            let Some(output) = output else { continue };
            let (program, output) = (&instance.program.text, &output.name.text);
            let found =
                format!("another instance of `{program}`, which writes the output `{output}` too");
            self.tell(
                Diagnostic::new(Code::SharedOutput, instance.name.span, found)
                    .allowed("one instance of a program with an output at an address")
                    .hint("make it a VAR_OUTPUT, and connect it for each instance: `x => %QX0.0`")
                    .related(other, "the other instance is here"),
            );
        }
    }

    fn resource(&mut self, resource: &'a Resource, placements: &mut Placements<'a>) {
        let mut by_task: HashMap<&str, Vec<Instance<'a>>> = HashMap::new();
        let mut free = Vec::new();
        for program in &resource.programs {
            let instance = self.instance(program);
            match &program.task {
                None => free.extend(instance),
                Some(task) if resource.tasks.iter().any(|known| known.name.key == task.key) => {
                    by_task.entry(&task.key).or_default().extend(instance);
                }
                Some(task) => {
                    let found = format!("there is no task `{}`", task.text);
                    let mut one = Diagnostic::new(Code::UnknownName, task.span, found);
                    let known = resource.tasks.iter().map(|task| &*task.name.text);
                    if let Some(similar) = super::names::similar(&task.key, known) {
                        one = one.hint(format!("did you mean `{similar}`?"));
                    }
                    self.tell(one);
                }
            }
        }
        for task in &resource.tasks {
            let instances = by_task.remove(&*task.name.key).unwrap_or_default();
            let named = |program: &ProgramInstance| {
                program.task.as_ref().is_some_and(|name| name.key == task.name.key)
            };
            if !resource.programs.iter().any(named) {
                let found = format!("the task `{}` has no program", task.name.text);
                let one = Diagnostic::new(Code::InvalidTask, task.name.span, found);
                self.tell(one.allowed("at least one `PROGRAM name WITH task : Program;`"));
            }
            let Some((kind, properties)) = self.task_kind(task) else { continue };
            self.task(&task.name.text, task.name.span, kind, &properties, instances, placements);
        }
        if let Some(first) = free.first() {
            // What has no task runs whenever nothing else does.
            let span = first.ast.name.span;
            let properties = Properties { priority: u8::MAX, ..Properties::default() };
            self.task(FREE, span, TaskKind::Freewheeling, &properties, free, placements);
        }
    }

    fn instance(&mut self, program: &'a ProgramInstance) -> Option<Instance<'a>> {
        let name = &program.program;
        let unit = match self.names.get(&name.key) {
            Some(Entry::Units(units)) if self.units[units[0]].ast.kind == UnitKind::Program => {
                units[0]
            }
            entry => {
                let known = entry.is_some();
                let found = match known {
                    true => format!("`{}` is no program", name.text),
                    false => format!("there is no program `{}`", name.text),
                };
                let code = if known { Code::WrongKind } else { Code::UnknownName };
                let mut one = Diagnostic::new(code, name.span, found);
                let programs = self.units.iter().filter(|unit| unit.ast.kind == UnitKind::Program);
                let programs = programs.map(|unit| &*unit.ast.name.text);
                if let Some(similar) = super::names::similar(&name.key, programs) {
                    one = one.hint(format!("did you mean `{similar}`?"));
                }
                self.tell(one);
                return None;
            }
        };
        let ty = self.unit_type(unit, name.span, false)?;
        let retained = retention(program.retention.map(|(retention, _)| retention));
        let resolved = Resolved::from(ty);
        let global = self.state(&program.name.text, program.name.span, resolved, retained)?;
        Some(Instance { ast: program, unit, global, ty })
    }

    fn task(
        &mut self,
        name: &str,
        span: Span,
        kind: TaskKind,
        properties: &Properties,
        instances: Vec<Instance<'a>>,
        placements: &mut Placements<'a>,
    ) {
        let mut block = Vec::new();
        for instance in instances {
            let (before, behind) = self.connections(&instance);
            let Instance { ast, unit, global, ty } = &instance;
            let (inputs, outputs) = self.place_instance(&ast.name, *unit, *global, *ty, placements);
            block.extend(inputs);
            block.extend(before);
            let place = Place::global(instance.global, instance.ty);
            let Some(routine) = self.units[instance.unit].routine else { continue };
            let location = self.location(instance.ast.name.span);
            block.push(Statement {
                kind: StatementKind::Invoke(place, routine, Vec::new()),
                location,
            });
            block.extend(behind);
            block.extend(outputs);
        }
        let location = self.location(span);
        let entry = self.program.add_routine(Routine {
            name: name.to_owned(),
            instance: None,
            locals: Vec::new(),
            result: None,
            body: block,
            location,
        });
        self.program.tasks.push(Task {
            name: name.to_owned(),
            kind,
            priority: properties.priority,
            budget_ns: properties.budget,
            deadline_ns: properties.deadline,
            entry,
            location,
        });
    }

    /// What is assigned before and behind the body of a program's instance.
    fn connections(&mut self, instance: &Instance<'a>) -> (Vec<Statement>, Vec<Statement>) {
        let (mut before, mut behind) = (Vec::new(), Vec::new());
        let mut connected = HashSet::new();
        for argument in &instance.ast.arguments {
            let (Some((formal, binding)), Some(value)) = (&argument.name, &argument.value) else {
                let one = Diagnostic::new(
                    Code::WrongArguments,
                    argument.span,
                    "a connection without a name",
                );
                self.tell(one.allowed("`input := value` or `output => variable`"));
                continue;
            };
            let entry = &self.units[instance.unit];
            let variable =
                entry.by_key.get(&*formal.key).map(|index| entry.variables[*index].clone());
            let wanted = match binding {
                Binding::Input => SectionKind::Input,
                _ => SectionKind::Output,
            };
            let found = variable.filter(|variable| variable.kind == wanted);
            let Some(variable) = found else {
                let what = if wanted == SectionKind::Input { "input" } else { "output" };
                let found = format!("`{}` has no {what} `{}`", entry.ast.name.text, formal.text);
                self.error(Code::WrongArguments, formal.span, found);
                continue;
            };
            let (Storage::Field(field), Some(ty)) = (variable.storage, variable.ty) else {
                self.refuse_gap(argument.span);
                continue;
            };
            // An output may go to several variables.
            if *binding == Binding::Input && !connected.insert(field) {
                let found = format!("two connections of the input `{}`", formal.text);
                self.error(Code::WrongArguments, argument.span, found);
                continue;
            }
            let place = Place::global(instance.global, instance.ty).field(field, ty);
            let mut body = Body::of_constants(self);
            if *binding == Binding::Input {
                if let Some(value) = body.value_of(value, ty) {
                    let kind = StatementKind::Assign(place, value);
                    before.push(body.statement(kind, argument.span));
                }
            } else if let Some(target) = body.write_place(value) {
                let load = body.expr(ty, ExprKind::Load(place), argument.span);
                let mut operand = Some(Operand::typed(load));
                if *binding == Binding::NegatedOutput {
                    operand = operand.and_then(|operand| {
                        body.unary_operator(ast::UnaryOperator::Not, operand, argument.span)
                    });
                }
                let value =
                    operand.and_then(|operand| body.converted(operand, target.ty, argument.span));
                if let Some(value) = value {
                    let kind = StatementKind::Assign(target, value);
                    behind.push(body.statement(kind, argument.span));
                }
            }
        }
        (before, behind)
    }
}
