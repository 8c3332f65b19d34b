//! Tests: their statements, and the task that enters them.

use std::collections::HashMap;

use super::Checker;
use super::body::Body;
use super::types::{Resolved, is_real};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Arithmetic, Assertion, CaseArm, Compared, Comparison, Constant, Elementary, Expr, ExprKind,
    Intrinsic, Location, Place, Retention, Routine, Simulation, Statement, StatementKind, Task,
    TaskKind, Test, TypeId, UnaryOperator,
};
use crate::source::Span;
use crate::syntax::ast::{self, Argument, Expression, Name, UnitKind};

/// The functions that only a test can call, with the forms of their calls.
const FORMS: [(&str, &str); 4] = [
    ("ASSERT", "`ASSERT(condition)` or `ASSERT(condition, 'message')`"),
    ("ASSERT_NEAR", "`ASSERT_NEAR(found, expected, tolerance)`, and a message behind it"),
    ("ADVANCE", "`ADVANCE(T#10ms)`"),
    ("RUN", "`RUN(T#1s)`"),
];

/// The task that enters the tests. No source can write this name.
const TASK: &str = "test-block";

/// How a function of tests is called, if the key is one's.
pub(in crate::check) fn form(key: &str) -> Option<&'static str> {
    FORMS.iter().find(|(name, _)| *name == key).map(|(_, form)| *form)
}

/// The functions that only a test can call.
pub(in crate::check) fn names() -> impl Iterator<Item = &'static str> {
    FORMS.iter().map(|(name, _)| *name)
}

/// Two values that an assertion compares.
struct Pair {
    found: Expr,
    expected: Expr,
    comparison: Comparison,
    tolerance: Option<f64>,
}

impl<'a> Body<'_, 'a> {
    /// A call of one of the functions of tests.
    pub(super) fn test_statement(
        &mut self,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
        let mut values = Vec::new();
        for argument in arguments {
            match (&argument.name, &argument.value) {
                (None, Some(value)) => values.push(value),
                _ => return self.wrong_form(name, span),
            }
        }
        match (&*name.key, &values[..]) {
            ("ASSERT", [condition]) => self.assert(condition, None, span),
            ("ASSERT", [condition, message]) => self.assert(condition, Some(message), span),
            ("ASSERT_NEAR", [found, expected, tolerance]) => {
                self.assert_near([found, expected, tolerance], None, span)
            }
            ("ASSERT_NEAR", [found, expected, tolerance, message]) => {
                self.assert_near([found, expected, tolerance], Some(message), span)
            }
            ("ADVANCE", [duration]) => self.pass(Simulation::Advance, duration, span),
            ("RUN", [duration]) => self.pass(Simulation::Run, duration, span),
            _ => self.wrong_form(name, span),
        }
    }

    fn wrong_form<T>(&mut self, name: &Name, span: Span) -> Option<T> {
        let found = format!("`{}` with other arguments", name.text);
        let one = Diagnostic::new(Code::WrongArguments, span, found);
        self.tell(one.allowed(form(&name.key).unwrap_or_default()));
        None
    }

    fn assert(
        &mut self,
        condition: &'a Expression,
        message: Option<&'a Expression>,
        span: Span,
    ) -> Option<Vec<Statement>> {
        let bool_type = self.elementary(Elementary::Bool);
        let value = self.value_of(condition, bool_type);
        let (value, message) = (value?, self.message(message)?);
        let ExprKind::Compare(comparison, found, expected) = value.kind else {
            let holds = self.fails_unless(value, message, None, span);
            return Some(vec![holds]);
        };
        let pair = Pair { found: *found, expected: *expected, comparison, tolerance: None };
        self.assert_pair(pair, message, span)
    }

    fn assert_near(
        &mut self,
        [found, expected, tolerance]: [&'a Expression; 3],
        message: Option<&'a Expression>,
        span: Span,
    ) -> Option<Vec<Statement>> {
        let operands = [self.operand(found, None), self.operand(expected, None)];
        let long = self.elementary(Elementary::Lreal);
        let tolerance_value = self.constant(tolerance, long);
        let message = self.message(message);
        let [found_operand, expected_operand] = operands;
        let places = (found.span, expected.span);
        let (a, b) = ((found_operand?, places.0), (expected_operand?, places.1));
        let (a_type, b_type) = (a.0.expr.ty, b.0.expr.ty);
        let joined =
            self.joined(a, b, None).filter(|(_, _, ty, _)| self.plain(*ty).is_some_and(is_real));
        let Some((found, expected, _, _)) = joined else {
            let found = format!("{} and {}", self.type_name(a_type), self.type_name(b_type));
            let one = Diagnostic::new(Code::TypeMismatch, span, found);
            self.tell(one.allowed("REAL or LREAL").hint("ASSERT compares values of other types"));
            return None;
        };
        let tolerance = match tolerance_value? {
            Constant::Real(value) if value >= 0.0 => value,
            _ => {
                let one = Diagnostic::new(Code::OutOfRange, tolerance.span, "no tolerance");
                self.tell(one.allowed("a number of at least 0"));
                return None;
            }
        };
        let comparison = Comparison::Equal;
        self.assert_pair(
            Pair { found, expected, comparison, tolerance: Some(tolerance) },
            message?,
            span,
        )
    }

    /// The text of a message. The outer `None` after an error.
    #[allow(clippy::option_option)]
    fn message(&mut self, message: Option<&'a Expression>) -> Option<Option<String>> {
        let Some(message) = message else { return Some(None) };
        let ty = self.checker.program.types.string(u16::MAX);
        match self.constant(message, ty)? {
            Constant::String(bytes) => Some(Some(bytes.into_iter().map(char::from).collect())),
            _ => Some(None),
        }
    }

    /// Keeps both values where the runner finds them, and compares what was kept.
    fn assert_pair(
        &mut self,
        pair: Pair,
        message: Option<String>,
        span: Span,
    ) -> Option<Vec<Statement>> {
        let (found_type, expected_type) = (pair.found.ty, pair.expected.ty);
        let found = self.keeper("found", found_type, span)?;
        let expected = self.keeper("expected", expected_type, span)?;
        let [left, right] = [(found, found_type), (expected, expected_type)]
            .map(|(id, ty)| self.expr(ty, ExprKind::Load(Place::global(id, ty)), span));
        let bool_type = self.elementary(Elementary::Bool);
        let holds = match pair.tolerance {
            None => ExprKind::Compare(pair.comparison, Box::new(left), Box::new(right)),
            Some(tolerance) => {
                let kind =
                    ExprKind::Arithmetic(Arithmetic::Subtract, Box::new(left), Box::new(right));
                let difference = self.expr(found_type, kind, span);
                let kind = ExprKind::Intrinsic(Intrinsic::Abs, vec![difference]);
                let distance = self.expr(found_type, kind, span);
                let tolerance = ExprKind::Constant(Constant::Real(tolerance));
                let most = self.expr(found_type, tolerance, span);
                ExprKind::Compare(Comparison::LessEqual, Box::new(distance), Box::new(most))
            }
        };
        let holds = self.expr(bool_type, holds, span);
        let compared = Compared {
            found,
            found_type,
            expected,
            expected_type,
            comparison: pair.comparison,
            tolerance: pair.tolerance,
        };
        let keep_found = StatementKind::Assign(Place::global(found, found_type), pair.found);
        let keep_expected =
            StatementKind::Assign(Place::global(expected, expected_type), pair.expected);
        let first = self.statement(keep_found, span);
        let second = self.statement(keep_expected, span);
        Some(vec![first, second, self.fails_unless(holds, message, Some(compared), span)])
    }

    /// The variable for one side of all comparisons of a type: a test ends at the first that does not hold.
    fn keeper(
        &mut self,
        side: &'static str,
        ty: TypeId,
        span: Span,
    ) -> Option<crate::hir::GlobalId> {
        if let Some(id) = self.checker.kept.get(&(side, ty)) {
            return Some(*id);
        }
        let name = format!("test.{side}.{}", ty.0);
        let id = self.checker.state(&name, span, Resolved::from(ty), Retention::None)?;
        self.checker.kept.insert((side, ty), id);
        Some(id)
    }

    fn fails_unless(
        &mut self,
        holds: Expr,
        message: Option<String>,
        compared: Option<Compared>,
        span: Span,
    ) -> Statement {
        let (text, location) = (self.checker.sources.text(span).to_owned(), self.location(span));
        let assertions = &mut self.checker.program.tests.assertions;
        let number = assertions.len() as i128;
        assertions.push(Assertion { text, message, compared, location });
        let bool_type = self.elementary(Elementary::Bool);
        let long = self.elementary(Elementary::Lint);
        let number = self.integer(long, number, span);
        let fail = self.request(Simulation::Fail, number, span);
        let fails = ExprKind::Unary(UnaryOperator::Not, Box::new(holds));
        let fails = self.expr(bool_type, fails, span);
        self.statement(StatementKind::If(vec![(fails, vec![fail])], Vec::new()), span)
    }

    /// `ADVANCE(duration)` and `RUN(duration)`.
    fn pass(
        &mut self,
        simulation: Simulation,
        duration: &'a Expression,
        span: Span,
    ) -> Option<Vec<Statement>> {
        if simulation == Simulation::Run && self.checker.configurations.is_empty() {
            let found = "RUN in a project without a CONFIGURATION, which has no task to run";
            let one = Diagnostic::new(Code::InvalidTask, span, found);
            self.tell(one.hint("call the instance, and let time pass with ADVANCE"));
            return None;
        }
        let time = self.elementary(Elementary::Time);
        let value = self.value_of(duration, time)?;
        if let ExprKind::Constant(Constant::Integer(..0)) = value.kind {
            let one = Diagnostic::new(Code::OutOfRange, duration.span, "a negative duration");
            self.tell(one.hint("time does not go back"));
            return None;
        }
        let long = self.elementary(Elementary::Lint);
        let nanoseconds = self.convert(crate::hir::Conversion::Bits, value, long, span);
        Some(vec![self.request(simulation, nanoseconds, span)])
    }

    fn request(&mut self, simulation: Simulation, value: Expr, span: Span) -> Statement {
        let kind = ExprKind::Intrinsic(Intrinsic::Simulate(simulation), vec![value]);
        self.evaluated(kind, span)
    }

    /// A call of the kernel whose result, a LINT, is dropped.
    pub(super) fn evaluated(&mut self, kind: ExprKind, span: Span) -> Statement {
        let long = self.elementary(Elementary::Lint);
        let call = self.expr(long, kind, span);
        let dropped = self.temporary("'dropped", long);
        self.statement(StatementKind::Assign(Place::local(dropped, long), call), span)
    }
}

impl Checker<'_> {
    /// Gives each test an instance, and all of them a task.
    pub(super) fn tests(&mut self) {
        let tests: Vec<usize> = (0..self.units.len())
            .filter(|unit| self.units[*unit].ast.kind == UnitKind::Test)
            .collect();
        let Some(first) = tests.first() else { return };
        let span = self.units[*first].ast.name.span;
        let long = self.elementary(Elementary::Lint);
        let wanted = self.state("test.wanted", span, Resolved::from(long), Retention::None);
        let Some(wanted) = wanted else { return };
        self.program.tests.wanted = Some(wanted);
        let mut names: HashMap<&str, Span> = HashMap::new();
        let mut arms = Vec::new();
        for (number, unit) in tests.into_iter().enumerate() {
            let ast = self.units[unit].ast;
            if let Some(other) = names.insert(&ast.name.text, ast.name.span) {
                self.duplicate(&ast.name, other);
            }
            let (Some(structure), Some(routine)) =
                (self.units[unit].structure, self.units[unit].routine)
            else {
                continue;
            };
            let name = format!("test.{number}");
            let resolved = Resolved::from(structure);
            let Some(id) = self.state(&name, ast.name.span, resolved, Retention::None) else {
                return;
            };
            let location = self.location(ast.span);
            let place = Place::global(id, structure);
            let body = vec![Statement {
                kind: StatementKind::Invoke(place, routine, Vec::new()),
                location,
            }];
            self.warn_of_no_assertion(ast);
            arms.push(CaseArm { ranges: vec![(number as i128, number as i128)], body });
            self.program.tests.list.push(Test { name: ast.name.text.to_string(), location });
        }
        let location = self.location(span);
        let selector = Expr::new(long, ExprKind::Load(Place::global(wanted, long)), location);
        let kind = StatementKind::Case(selector, arms, Vec::new());
        let entry = self.program.add_routine(Routine {
            name: "test".to_owned(),
            instance: None,
            locals: Vec::new(),
            result: None,
            body: vec![Statement { kind, location }],
            location,
        });
        if self.program.tasks.len() >= super::configuration::TASKS {
            let found = format!("a test of a project with {} tasks", self.program.tasks.len());
            let one = Diagnostic::new(Code::InvalidTask, span, found);
            self.tell(one.allowed("at most 15: the tests take one of the 16 that an image has"));
        }
        self.program.tasks.push(Task {
            name: TASK.to_owned(),
            kind: TaskKind::Freewheeling,
            priority: u8::MAX,
            budget_ns: 0,
            deadline_ns: 0,
            entry,
            location,
        });
    }

    /// Warns of a test without an assertion: it fails only if the program faults.
    fn warn_of_no_assertion(&mut self, test: &ast::Unit) {
        let Span { start, end, .. } = test.span;
        let [first, last] = [start, end].map(|at| {
            let Location { file, line, column } =
                self.location(Span { start: at, end: at, ..test.span });
            (file, line, column)
        });
        let within = |assertion: &Assertion| {
            let Location { file, line, column } = assertion.location;
            (first..last).contains(&(file, line, column))
        };
        // One with an error may be missing.
        if !self.diagnostics.has_errors() && !self.program.tests.assertions.iter().any(within) {
            let one =
                Diagnostic::new(Code::NoEffect, test.name.span, "a TEST without an assertion");
            self.tell(one.allowed("a TEST with ASSERT or ASSERT_NEAR"));
        }
    }
}
