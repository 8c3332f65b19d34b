//! Statements.

use super::Entry;
use super::body::{Around, Body};
use super::expression::without_parentheses;
use super::loops::Looped;
use super::place::Access;
use super::types::is_integer;
use super::unit::{Storage, is_part};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Area, Block, CaseArm, Constant, Elementary, Expr, ExprKind, ForLoop as HirFor, Place, Root,
    StatementKind as Hir, StructureKind, Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{
    Expression, ExpressionKind, ForLoop, Label, Name, Statement, StatementKind,
};

impl<'a> Body<'_, 'a> {
    pub(super) fn block(&mut self, statements: &'a [Statement]) -> Block {
        let mut block = Vec::new();
        for statement in statements {
            match self.one(statement) {
                Some(made) => block.extend(made),
                None => self.checker.refuse_gap(statement.span),
            }
        }
        block
    }

    fn one(&mut self, statement: &'a Statement) -> Option<Block> {
        let span = statement.span;
        let kind = match &statement.kind {
            StatementKind::Assign { target, value, attempt: true } => {
                self.attempt(span);
                self.all_apart([target, value]);
                None
            }
            StatementKind::Assign { target, value, attempt: false } => {
                return self.assign(target, value);
            }
            StatementKind::Call(call) => return self.call_statement(call),
            StatementKind::If { branches, otherwise } => {
                let mut arms = Vec::new();
                for (condition, body) in branches {
                    let condition = self.condition(condition);
                    let body = self.block(body);
                    arms.push(condition.map(|condition| (condition, body)));
                }
                let otherwise = otherwise.as_ref().map(|body| self.block(body));
                let arms: Option<Vec<_>> = arms.into_iter().collect();
                arms.map(|arms| Hir::If(arms, otherwise.unwrap_or_default()))
            }
            StatementKind::Case { selector, branches, otherwise } => {
                self.case(selector, branches, otherwise.as_deref())
            }
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                self.for_loop(variable, (from, to, by.as_ref()), body)
            }
            StatementKind::While(condition, body) => {
                self.warn_of_loop(Looped::While, condition, body, span);
                let condition = self.condition(condition);
                let body = self.looped(body);
                condition.map(|condition| Hir::While(condition, body))
            }
            StatementKind::Repeat(body, condition) => {
                self.warn_of_loop(Looped::Repeat, condition, body, span);
                let body = self.looped(body);
                self.condition(condition).map(|condition| Hir::Repeat(body, condition))
            }
            StatementKind::Exit => self.within_loop("EXIT", Hir::Exit, span),
            StatementKind::Continue => self.within_loop("CONTINUE", Hir::Continue, span),
            StatementKind::Return => Some(Hir::Return),
            StatementKind::Error => None,
        };
        Some(vec![self.statement(kind?, span)])
    }

    fn attempt(&mut self, span: Span) {
        let one = Diagnostic::new(Code::NotSupported, span, "`?=`, an attempted assignment");
        self.tell(one.allowed("`:=` with references of one type"));
    }

    fn within_loop(&mut self, word: &str, kind: Hir, span: Span) -> Option<Hir> {
        if self.loops > 0 {
            return Some(kind);
        }
        let one =
            Diagnostic::new(Code::MisplacedStatement, span, format!("{word} outside of a loop"));
        self.tell(one.allowed("within FOR, WHILE or REPEAT").hint("RETURN leaves the whole unit"));
        None
    }

    fn looped(&mut self, body: &'a [Statement]) -> Block {
        self.loops += 1;
        let block = self.block(body);
        self.loops -= 1;
        block
    }

    fn condition(&mut self, condition: &'a Expression) -> Option<Expr> {
        let ty = self.elementary(Elementary::Bool);
        let operand = self.operand(condition, Some(ty))?;
        if operand.expr.ty == ty {
            return Some(operand.expr);
        }
        let found = format!("a condition of type {}", self.type_name(operand.expr.ty));
        let mut one = Diagnostic::new(Code::TypeMismatch, condition.span, found).allowed("BOOL");
        if self.plain(operand.expr.ty).is_some() {
            one = one.hint("compare it, such as `<> 0`");
        }
        self.tell(one);
        None
    }

    fn assign(&mut self, target: &'a Expression, value: &'a Expression) -> Option<Block> {
        if let ExpressionKind::Call(callee, arguments) = &value.kind
            && let ExpressionKind::Name(name) = &callee.kind
            && arguments.iter().any(|argument| {
                let formal = argument.name.as_ref().map(|(name, _)| &*name.key);
                matches!(formal, Some("EN" | "ENO"))
            })
        {
            return self.enabled_assignment(target, name, arguments, value.span);
        }
        let place = self.write_place(target);
        let Some(place) = place else {
            // What is wrong in the value is told all the same.
            self.apart(value);
            return None;
        };
        let ty = place.ty;
        let instance = self.checker.program.types.structure(ty);
        if instance.is_some_and(|structure| structure.kind != StructureKind::Struct) {
            let found = format!("an assignment of a whole instance of {}", self.type_name(ty));
            let one = Diagnostic::new(Code::NotAssignable, target.span, found);
            self.tell(one.hint("assign its inputs, or call it"));
            self.apart(value);
            return None;
        }
        if matches!(self.checker.program.types.get(ty), Type::OpenArray { .. }) {
            let found = "an assignment of a whole ARRAY[*]";
            let one = Diagnostic::new(Code::NotAssignable, target.span, found);
            self.tell(one.hint("assign its elements one by one"));
            self.apart(value);
            return None;
        }
        let span = target.span;
        // A call that is the whole value may have statements around it.
        let call = matches!(without_parentheses(value).kind, ExpressionKind::Call(..));
        self.around = call.then(Around::default);
        let value = self.value_of(value, ty);
        let Around { before: mut block, behind } = self.around.take().unwrap_or_default();
        block.extend(self.called_assignment(place, value?, behind, span));
        Some(block)
    }

    /// An assignment with what has to be done behind the call that is its value. That comes first: the place on the
    /// left is evaluated behind the call, and may depend on its outputs or be one.
    pub(super) fn called_assignment(
        &mut self,
        place: Place,
        mut value: Expr,
        behind: Block,
        span: Span,
    ) -> Block {
        let mut block = Vec::new();
        if !behind.is_empty() {
            let ty = value.ty;
            let kept = Place::local(self.temporary("'value", ty), ty);
            block.push(self.statement(Hir::Assign(kept.clone(), value), span));
            block.extend(behind);
            value = self.expr(ty, ExprKind::Load(kept), span);
        }
        block.push(self.statement(Hir::Assign(place, value), span));
        block
    }

    fn for_loop(
        &mut self,
        name: &'a Name,
        (from, to, by): (&'a Expression, &'a Expression, Option<&'a Expression>),
        body: &'a [Statement],
    ) -> Option<Hir> {
        let Some(place) = self.control_variable(name) else {
            self.all_apart([from, to].into_iter().chain(by));
            self.looped(body);
            return None;
        };
        let ty = place.ty;
        let from = self.value_of(from, ty);
        let to = self.value_of(to, ty);
        let by_span = by.map_or(name.span, |by| by.span);
        let by = match by {
            Some(by) => self.value_of(by, ty),
            None => Some(self.integer(ty, 1, name.span)),
        };
        self.counting.push(place.clone());
        let body = self.looped(body);
        self.counting.pop();
        let (from, to, by) = (from?, to?, by?);
        let constant = |expr: &Expr| match expr.kind {
            ExprKind::Constant(Constant::Integer(value)) => Some(value),
            _ => None,
        };
        if constant(&by) == Some(0) {
            let one = Diagnostic::new(
                Code::OutOfRange,
                by_span,
                "a step of 0, with which FOR never ends",
            );
            self.tell(one);
            return None;
        }
        if let (Some(first), Some(last), Some(step)) =
            (constant(&from), constant(&to), constant(&by))
            && (step > 0 && first > last || step < 0 && first < last)
        {
            let found = format!("a loop from {first} to {last} by {step}, which never runs");
            let one = Diagnostic::new(Code::NoEffect, name.span, found);
            self.tell(one.hint("`BY -1` counts down"));
        }
        Some(Hir::For(Box::new(HirFor { variable: place, from, to, by, body })))
    }

    /// The place of a loop's variable: of an integer type, without an index or reference on the way.
    fn control_variable(&mut self, name: &'a Name) -> Option<Place> {
        let index = self.variable(name);
        let place = match index {
            Some(index) => {
                let variable = &mut self.variables[index];
                variable.read = true;
                variable.written = true;
                let (ty, storage) = (variable.ty?, variable.storage.clone());
                let wrong = match &storage {
                    Storage::Reference(..) => Some("a VAR_IN_OUT"),
                    Storage::Constant(..) => Some("a constant"),
                    _ if variable.kind == crate::syntax::ast::SectionKind::Input => {
                        Some("an input of this unit")
                    }
                    _ => None,
                };
                if let Some(wrong) = wrong {
                    self.no_control_variable(name, wrong);
                    return None;
                }
                self.checker.variable_place(self.unit, &storage, ty)?
            }
            None if self.is_result(name) => self.result(name, Access::Write)?,
            None => self.global_control(name)?,
        };
        let wrong = match place.root {
            _ if self.counting.contains(&place) => {
                Some("the control variable of a FOR around this one")
            }
            Root::Global(id)
                if self.checker.program.global(id).storage.area == Area::Input
                    && !self.in_test() =>
            {
                Some("an input, which comes from outside")
            }
            _ => None,
        };
        if let Some(wrong) = wrong {
            self.no_control_variable(name, wrong);
            return None;
        }
        if !self.plain(place.ty).is_some_and(is_integer) || is_part(&place) {
            let found = format!("a control variable of type {}", self.type_name(place.ty));
            let one = Diagnostic::new(Code::TypeMismatch, name.span, found);
            self.tell(one.allowed("an integer type"));
            return None;
        }
        Some(place)
    }

    fn no_control_variable(&mut self, name: &Name, wrong: &str) {
        let found = format!("`{}` is {wrong}", name.text);
        let one = Diagnostic::new(Code::NotAssignable, name.span, found);
        self.tell(one.allowed("a variable of this unit, of an integer type"));
    }

    fn global_control(&mut self, name: &Name) -> Option<Place> {
        let Some(Entry::Global(global)) = self.checker.names.get(&name.key) else {
            self.unknown(name);
            return None;
        };
        let entry = &mut self.checker.globals[*global];
        entry.read = true;
        entry.written = true;
        match entry.id {
            Some(id) if !self.checker.program.global(id).constant => {
                Some(Place::global(id, entry.ty?))
            }
            _ => {
                self.not_assignable(name.span, "a constant");
                None
            }
        }
    }

    fn case(
        &mut self,
        selector: &'a Expression,
        branches: &'a [(Vec<Label>, Vec<Statement>)],
        otherwise: Option<&'a [Statement]>,
    ) -> Option<Hir> {
        let checked = self.operand(selector, None);
        let checked = checked.map(|operand| self.without_subrange(operand, selector.span));
        let selected = checked.filter(|operand| {
            let integral = self
                .scalar(operand.expr.ty)
                .is_some_and(|scalar| scalar.range().is_some() && scalar != Elementary::Bool);
            let reference =
                matches!(self.checker.program.types.get(operand.expr.ty), Type::Reference { .. });
            if !integral || reference {
                let found = format!("CASE of {}", self.type_name(operand.expr.ty));
                let one = Diagnostic::new(Code::TypeMismatch, selector.span, found);
                self.tell(one.allowed("an integer, a bit string or an enumeration"));
            }
            integral && !reference
        });
        let ty = selected.as_ref().map(|operand| operand.expr.ty);
        let mut seen = Vec::new();
        let mut arms = Vec::new();
        for (labels, body) in branches {
            let mut ranges = Vec::new();
            for label in labels {
                let Some(ty) = ty else {
                    self.label_apart(label);
                    continue;
                };
                if let Some((low, high, span)) = self.label(label, ty) {
                    seen.push((low, high, span));
                    ranges.push((low, high));
                }
            }
            arms.push(CaseArm { ranges, body: self.block(body) });
        }
        self.refuse_doubled(seen);
        let otherwise = otherwise.map(|body| self.block(body)).unwrap_or_default();
        Some(Hir::Case(selected?.expr, arms, otherwise))
    }

    fn label(&mut self, label: &'a Label, ty: TypeId) -> Option<(i128, i128, Span)> {
        let (low, high) = match label {
            Label::One(value) => (value, value),
            Label::Range(low, high) => (low, high),
        };
        let span = low.span.to(high.span);
        let mut number = |value: &'a Expression| match self.constant(value, ty)? {
            Constant::Integer(number) => Some(number),
            _ => None,
        };
        let first = number(low)?;
        let last = if std::ptr::eq(low, high) { first } else { number(high)? };
        if first > last {
            let found = format!("the label {first}..{last} has no value");
            let one = Diagnostic::new(Code::InvalidCase, span, found);
            self.tell(one.allowed("the lower value first"));
            return None;
        }
        Some((first, last, span))
    }

    fn refuse_doubled(&mut self, mut labels: Vec<(i128, i128, Span)>) {
        labels.sort_by_key(|(low, high, span)| (*low, *high, span.start));
        let mut before: Option<(i128, i128, Span)> = None;
        for (low, high, span) in labels {
            if let Some((_, last, other)) = before
                && low <= last
            {
                let (first, second) =
                    if other.start < span.start { (other, span) } else { (span, other) };
                let one = Diagnostic::new(
                    Code::InvalidCase,
                    second,
                    format!("the value {low} has two branches"),
                );
                self.tell(one.related(first, "the other one is here"));
            }
            if before.is_none_or(|(_, last, _)| high > last) {
                before = Some((low, high, span));
            }
        }
    }
}
