//! What is known while the declarations and statements of one unit are checked.

use std::collections::{HashMap, HashSet};

use super::Checker;
use super::unit::{Storage, Variable};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Block, Constant, Elementary, Expr, ExprKind, Local, LocalId, LocalKind, Location, Place,
    Statement, StatementKind, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Name};

/// A unit while it is checked, or only the names at the top for the constants of a declaration.
pub(super) struct Body<'c, 'a> {
    pub(super) checker: &'c mut Checker<'a>,
    /// The unit's index.
    pub(super) unit: Option<usize>,
    /// The variables declared so far.
    pub(super) variables: Vec<Variable<'a>>,
    /// Their indices by key.
    pub(super) by_key: HashMap<&'a str, usize>,
    /// The locals of the unit's routine.
    pub(super) locals: Vec<Local>,
    /// How many loops are around the statement.
    pub(super) loops: u32,
    /// What has to be done around the call that is checked. None within an expression, where nothing can be.
    pub(super) around: Option<Around>,
    /// Where the expression stands whose value is needed as it is, and not to compute with.
    pub(super) whole: Option<Span>,
    /// The control variables of the FOR loops around the statement.
    pub(super) counting: Vec<Place>,
    /// Names that were already told to be unknown.
    pub(super) unknown: HashSet<String>,
    /// Whether the function's result is assigned anywhere.
    pub(super) result_assigned: bool,
}

/// Statements of the compiler's own around a call that is a statement, or the whole value of one.
#[derive(Default)]
pub(super) struct Around {
    pub(super) before: Block,
    pub(super) behind: Block,
}

impl<'c, 'a> Body<'c, 'a> {
    /// For constants outside of any unit.
    pub(super) fn of_constants(checker: &'c mut Checker<'a>) -> Self {
        Self {
            checker,
            unit: None,
            variables: Vec::new(),
            by_key: HashMap::new(),
            locals: Vec::new(),
            loops: 0,
            around: None,
            whole: None,
            counting: Vec::new(),
            unknown: HashSet::new(),
            result_assigned: false,
        }
    }

    pub(super) fn tell(&mut self, one: Diagnostic) {
        self.checker.tell(one);
    }

    pub(super) fn error(&mut self, code: Code, span: Span, found: impl Into<String>) {
        self.checker.error(code, span, found);
    }

    pub(super) fn elementary(&mut self, elementary: Elementary) -> TypeId {
        self.checker.elementary(elementary)
    }

    pub(super) fn type_name(&self, ty: TypeId) -> String {
        self.checker.type_name(ty)
    }

    pub(super) fn scalar(&self, ty: TypeId) -> Option<Elementary> {
        self.checker.program.types.scalar(ty)
    }

    pub(super) fn location(&self, span: Span) -> Location {
        self.checker.location(span)
    }

    pub(super) fn expr(&self, ty: TypeId, kind: ExprKind, span: Span) -> Expr {
        Expr::new(ty, kind, self.location(span))
    }

    pub(super) fn integer(&self, ty: TypeId, value: i128, span: Span) -> Expr {
        self.expr(ty, ExprKind::Constant(Constant::Integer(value)), span)
    }

    pub(super) fn statement(&self, kind: StatementKind, span: Span) -> Statement {
        Statement { kind, location: self.location(span) }
    }

    /// The variable of this name in the unit.
    pub(super) fn variable(&self, name: &Name) -> Option<usize> {
        self.by_key.get(&*name.key).copied()
    }

    /// Adds a variable of the compiler's own.
    pub(super) fn temporary(&mut self, name: &str, ty: TypeId) -> LocalId {
        self.locals.push(Local {
            name: name.to_owned(),
            ty,
            kind: LocalKind::Variable,
            initial: Constant::Default,
        });
        LocalId(self.locals.len() as u32 - 1)
    }

    /// Declares a variable of the unit, unless its name is taken.
    pub(super) fn declare(&mut self, variable: Variable<'a>) {
        // In a function its name is the variable of its result.
        if self.is_result(variable.name) {
            let function = self.unit.map(|unit| self.checker.units[unit].ast.name.span);
            self.checker.duplicate(variable.name, function.unwrap_or(variable.name.span));
            return;
        }
        if let Some(other) = self.by_key.get(&*variable.name.key) {
            let other = self.variables[*other].name.span;
            self.checker.duplicate(variable.name, other);
            return;
        }
        self.by_key.insert(&variable.name.key, self.variables.len());
        self.variables.push(variable);
    }

    /// The value of an expression that must be known when the program is built.
    pub(super) fn constant(
        &mut self,
        expression: &'a ast::Expression,
        ty: TypeId,
    ) -> Option<Constant> {
        let expr = self.value_of(expression, ty)?;
        match expr.kind {
            ExprKind::Constant(constant) => Some(constant),
            ExprKind::Reference(place) => self.constant_reference(&place, expression.span),
            _ => {
                self.not_constant(expression.span);
                None
            }
        }
    }

    /// The value of an expression of an integer type that must be known when the program is built.
    pub(super) fn constant_integer(&mut self, expression: &'a ast::Expression) -> Option<i128> {
        let operand = self.operand(expression, None)?;
        let scalar = self.scalar(operand.expr.ty);
        match operand.expr.kind {
            ExprKind::Constant(Constant::Integer(value))
                if scalar.is_some_and(|scalar| scalar.range().is_some()) =>
            {
                Some(value)
            }
            ExprKind::Constant(_) => {
                let found = format!("a value of type {}", self.type_name(operand.expr.ty));
                let one = Diagnostic::new(Code::TypeMismatch, expression.span, found);
                self.tell(one.allowed("an integer"));
                None
            }
            _ => {
                self.not_constant(expression.span);
                None
            }
        }
    }

    fn not_constant(&mut self, span: Span) {
        self.tell(
            Diagnostic::new(
                Code::InvalidConstant,
                span,
                "a value that is known only when the program runs",
            )
            .allowed("literals, constants (VAR CONSTANT) and operators on them"),
        );
    }

    /// `REF(variable)` as an initial value: of a global variable and its fields.
    fn constant_reference(&mut self, place: &crate::hir::Place, span: Span) -> Option<Constant> {
        use crate::hir::{Area, Root, Step};
        if let Root::Global(id) = place.root
            && self.checker.program.global(id).storage.area == Area::State
        {
            let fields = place.path.iter().map(|step| match step {
                Step::Field(index) => Some(*index),
                _ => None,
            });
            if let Some(fields) = fields.collect() {
                return Some(Constant::Address(id, fields));
            }
        }
        self.tell(
            Diagnostic::new(
                Code::InvalidConstant,
                span,
                "a reference to something without a fixed address as initial value",
            )
            .allowed("REF of a global variable or of a field of one"),
        );
        None
    }

    /// The constant that a variable stands for, if it is one.
    pub(super) fn constant_of(&self, variable: usize) -> Option<(TypeId, Constant)> {
        match &self.variables[variable].storage {
            Storage::Constant(ty, constant) => Some((*ty, constant.clone())),
            _ => None,
        }
    }
}
