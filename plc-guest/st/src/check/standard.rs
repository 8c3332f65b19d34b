//! The standard functions that the compiler makes itself, by a table of their signatures.
//!
//! What is here is generic over ANY_* or has no form in ST: every other function of the standard is
//! written in ST, in the library. A function of the library with a name of this table would never be
//! called.

mod bounds;
mod conversion;
mod table;

use table::{Function, Group, Make, Parameter};

use super::body::Body;
use super::expression::Operand;
use super::names::similar;
use super::types::{is_bit_string, is_integer, is_real};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, BinaryOperator, Binding, Name};

/// A checked argument with its place.
type Given = (Operand, Span);

impl<'a> Body<'_, 'a> {
    /// A call of something that the project does not declare.
    pub(super) fn standard_call(
        &mut self,
        name: &'a Name,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        match &*name.key {
            "REF" => return self.reference(arguments, span),
            "LOWER_BOUND" | "UPPER_BOUND" => return self.bound(name, arguments, span, hint),
            _ => {}
        }
        let Some(function) = table::function(&name.key) else {
            return match self.conversion_call(name, arguments, span) {
                Some(result) => result,
                None => {
                    self.unknown_function(name);
                    None
                }
            };
        };
        let given = self.given(function, name, arguments, span, hint)?;
        self.make(function, name, given, span, hint)
    }

    fn unknown_function(&mut self, name: &Name) {
        let found = format!("there is no function `{}`", name.text);
        let mut one = Diagnostic::new(Code::UnknownName, name.span, found);
        let known = table::FUNCTIONS.iter().map(|function| function.name);
        let known = known.chain(self.checker.names.keys());
        let known = known.chain(self.variables.iter().map(|variable| &*variable.name.text));
        if let Some(similar) = similar(&name.key, known) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        self.tell(one);
    }

    /// The arguments in the order of the parameters, of types that those allow.
    fn given(
        &mut self,
        function: &Function,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Vec<Given>> {
        let mut order: Vec<Option<&'a Argument>> = Vec::new();
        for (at, argument) in arguments.iter().enumerate() {
            let at = match &argument.name {
                None => Some(at),
                Some((formal, Binding::Input)) => function.place(&formal.key),
                Some(_) => None,
            };
            let free = at.filter(|at| *at < 1000 && order.get(*at).is_none_or(Option::is_none));
            let Some(at) = free else {
                let found = format!("this argument of `{}`", name.text);
                let one = Diagnostic::new(Code::WrongArguments, argument.span, found);
                self.tell(one.allowed(function.form()));
                return None;
            };
            if order.len() <= at {
                order.resize(at + 1, None);
            }
            order[at] = Some(argument);
        }
        let count = order.len();
        let fits = count >= function.least()
            && (count <= function.parameters.len() || function.extensible)
            && order.iter().all(Option::is_some);
        if !fits {
            let found = format!("{} arguments for `{}`", arguments.len(), name.text);
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed(function.form()));
            return None;
        }
        let mut given = Vec::new();
        let mut complete = true;
        for (at, argument) in order.into_iter().flatten().enumerate() {
            let value = argument.value.as_ref()?;
            let parameter = function.parameter(at);
            let hint = if parameter.is_group() { hint } else { None };
            let operand = self.operand(value, hint);
            let operand = operand.map(|operand| self.without_subrange(operand, value.span));
            match operand {
                Some(operand) => {
                    complete &= self.allowed(function, parameter, &operand, value.span);
                    given.push((operand, value.span));
                }
                None => complete = false,
            }
        }
        complete.then_some(given)
    }

    fn allowed(
        &mut self,
        function: &Function,
        parameter: Parameter,
        operand: &Operand,
        span: Span,
    ) -> bool {
        let ty = operand.expr.ty;
        let elementary = self.plain(ty);
        let is = |test: fn(Elementary) -> bool| elementary.is_some_and(test);
        let types = &self.checker.program.types;
        let (fits, allowed) = match parameter {
            Parameter::Bool => (elementary == Some(Elementary::Bool), "BOOL"),
            Parameter::Integer => (is(is_integer), "an integer"),
            Parameter::Same(group) => match group {
                Group::Number => (is(is_integer) || is(is_real), "a number"),
                Group::Real => (
                    is(is_real)
                        || elementary
                            .is_some_and(|elementary| operand.untyped && is_integer(elementary)),
                    "REAL or LREAL",
                ),
                Group::Bits => (is(is_bit_string) || operand.untyped, "a bit string"),
                Group::String => {
                    let character =
                        matches!(elementary, Some(Elementary::Char | Elementary::Wchar))
                            && function.make == Make::Concatenate;
                    (types.is_string(ty) || character, "STRING or WSTRING")
                }
                Group::Scalar => (elementary.is_some(), "an elementary value that is no string"),
                Group::Any => (
                    types.scalar(ty).is_some() || types.is_string(ty),
                    "an elementary value, an enumeration or a reference",
                ),
                // The operator says what it takes.
                Group::Operands => (true, ""),
            },
        };
        if !fits {
            let found = format!("{} for `{}`", self.type_name(ty), function.name);
            let mut one = Diagnostic::new(Code::TypeMismatch, span, found).allowed(allowed);
            if let (Parameter::Same(Group::Real), Some(integer)) = (parameter, elementary)
                && is_integer(integer)
            {
                one = one.hint(format!("convert it: `{}_TO_LREAL(...)`", integer.name()));
            }
            self.tell(one);
        }
        fits
    }

    fn make(
        &mut self,
        function: &Function,
        name: &Name,
        mut given: Vec<Given>,
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        match function.make {
            Make::Operator(operator) => self.chain(operator, name, given, span),
            Make::Comparison(operator) => self.comparisons(operator, name, given, span),
            Make::Power => {
                let (exponent, base) = (given.pop()?, given.pop()?);
                self.binary_operands(BinaryOperator::Power, name.span, base, exponent, span)
            }
            Make::Intrinsic(intrinsic) => {
                let ty = self.same(&given, function, hint)?;
                let list = self.all_as(given, ty)?;
                Some(self.intrinsic(intrinsic, list, ty, span))
            }
            Make::Fold(intrinsic) => {
                let ty = self.same(&given, function, hint)?;
                let mut list = self.all_as(given, ty)?.into_iter();
                let mut result = list.next()?;
                for next in list {
                    result = self.intrinsic(intrinsic, vec![result, next], ty, span).expr;
                }
                Some(Operand::typed(result))
            }
            Make::Limit => {
                let ty = self.same(&given, function, hint)?;
                let [least, value, most] = <[Expr; 3]>::try_from(self.all_as(given, ty)?).ok()?;
                let above = self.intrinsic(Intrinsic::Max, vec![value, least], ty, span).expr;
                Some(self.intrinsic(Intrinsic::Min, vec![above, most], ty, span))
            }
            Make::Move => {
                let (operand, _) = given.pop()?;
                Some(operand)
            }
            Make::Select => {
                let (selector, _) = given.remove(0);
                let ty = self.same(&given, function, hint)?;
                let mut list = vec![selector.expr];
                list.extend(self.all_as(given, ty)?);
                Some(self.intrinsic(Intrinsic::Select, list, ty, span))
            }
            Make::Multiplex => self.multiplex(given, function, name, hint, span),
            Make::Shift(intrinsic) => {
                let (count, place) = given.pop()?;
                let (value, at) = given.pop()?;
                let ty = value.expr.ty;
                if value.untyped {
                    self.no_type(name, at);
                    return None;
                }
                let count = self.as_long(count, place)?;
                Some(self.intrinsic(intrinsic, vec![value.expr, count], ty, span))
            }
            Make::Text(intrinsic) => {
                let ty = self.string_result(&given[..1])?;
                let mut given = given.into_iter();
                let mut list = vec![given.next()?.0.expr];
                for (operand, place) in given {
                    list.push(self.as_long(operand, place)?);
                }
                Some(self.intrinsic(intrinsic, list, ty, span))
            }
            Make::Concatenate => self.concatenate(given, span),
            Make::Unit => {
                let (position, place) = given.pop()?;
                let (text, _) = given.pop()?;
                let wide =
                    matches!(self.checker.program.types.get(text.expr.ty), Type::WString { .. });
                let ty = self.elementary(if wide { Elementary::Word } else { Elementary::Byte });
                let position = self.as_long(position, place)?;
                Some(self.intrinsic(Intrinsic::UnitAt, vec![text.expr, position], ty, span))
            }
            Make::Measure(intrinsic) => {
                if let [(a, _), (b, place)] = &given[..]
                    && !self.both_strings(a.expr.ty, b.expr.ty)
                {
                    let (a, b, place) = (a.expr.ty, b.expr.ty, *place);
                    self.no_conversion(b, a, place);
                    return None;
                }
                let long = self.elementary(Elementary::Lint);
                let list = given.into_iter().map(|(operand, _)| operand.expr).collect();
                let measured = self.intrinsic(intrinsic, list, long, span);
                let ty = self.integer_result(hint);
                Some(Operand::typed(self.convert(Conversion::Value, measured.expr, ty, span)))
            }
            Make::Truncate => {
                let (operand, _) = given.pop()?;
                let ty = self.integer_result(hint);
                let mut expr = operand.expr;
                if self.plain(expr.ty).is_some_and(is_integer) {
                    let real = self.elementary(Elementary::Lreal);
                    expr = self.convert(Conversion::Value, expr, real, span);
                }
                Some(Operand::typed(self.convert(Conversion::Truncate, expr, ty, span)))
            }
            Make::Clock(intrinsic, elementary) => {
                let ty = self.elementary(elementary);
                Some(self.intrinsic(intrinsic, Vec::new(), ty, span))
            }
        }
    }

    fn intrinsic(&self, intrinsic: Intrinsic, list: Vec<Expr>, ty: TypeId, span: Span) -> Operand {
        Operand::typed(self.expr(ty, ExprKind::Intrinsic(intrinsic, list), span))
    }

    fn no_type(&mut self, name: &Name, span: Span) {
        let found = format!("a number without a type for `{}`", name.text);
        let one = Diagnostic::new(Code::TypeMismatch, span, found);
        self.tell(one.hint("write its type: `WORD#16#00FF`"));
    }

    /// The type that all arguments of a group are brought to.
    fn same(
        &mut self,
        given: &[Given],
        function: &Function,
        hint: Option<TypeId>,
    ) -> Option<TypeId> {
        let real = function.parameters.contains(&Parameter::Same(Group::Real));
        let group = || given.iter().filter(|(operand, _)| !operand.untyped);
        let first = group().next().map(|(operand, _)| operand.expr.ty);
        let Some(mut ty) = first else {
            // Numbers alone: what is needed, if they fit.
            let (operand, _) = given.first()?;
            if self.checker.program.types.is_string(operand.expr.ty) {
                // Text alone: the longest. One of another kind is told where it is converted.
                let all = given.iter().map(|(operand, _)| operand.expr.ty);
                let strings = all.filter(|ty| self.both_strings(*ty, operand.expr.ty));
                return strings.reduce(|a, b| self.longer(a, b));
            }
            let hinted = hint.filter(|hint| {
                let number = self
                    .plain(*hint)
                    .is_some_and(|hint| is_real(hint) || !real && is_integer(hint));
                number && given.iter().all(|(operand, _)| self.fits(operand, *hint, false))
            });
            let long = self.elementary(Elementary::Lreal);
            let reals = given.iter().any(|(operand, _)| operand.expr.ty == long);
            let own = if real || reals { long } else { self.widest(given)? };
            return Some(hinted.unwrap_or(own));
        };
        for (operand, span) in given {
            let next = operand.expr.ty;
            if self.both_strings(ty, next) {
                ty = self.longer(ty, next);
                continue;
            }
            if next == ty || operand.untyped && self.fits(operand, ty, false) {
                continue;
            }
            let joined = match (self.plain(ty), self.plain(next)) {
                (Some(a), Some(b)) => super::convert::common(a, b),
                _ => None,
            };
            let Some(joined) = joined else {
                self.no_conversion(next, ty, *span);
                return None;
            };
            ty = self.elementary(joined);
        }
        Some(ty)
    }

    fn widest(&mut self, given: &[Given]) -> Option<TypeId> {
        let mut widest = self.plain(given.first()?.0.expr.ty);
        for (operand, _) in given {
            widest = super::convert::common(widest?, self.plain(operand.expr.ty)?);
        }
        Some(self.elementary(widest?))
    }

    fn longer(&self, a: TypeId, b: TypeId) -> TypeId {
        let types = &self.checker.program.types;
        if types.size(a) >= types.size(b) { a } else { b }
    }

    fn all_as(&mut self, given: Vec<Given>, ty: TypeId) -> Option<Vec<Expr>> {
        given
            .into_iter()
            .map(|(operand, span)| {
                if self.both_strings(operand.expr.ty, ty) {
                    return Some(operand.expr);
                }
                self.converted(operand, ty, span)
            })
            .collect()
    }

    fn as_long(&mut self, operand: Operand, span: Span) -> Option<Expr> {
        let long = self.elementary(Elementary::Lint);
        if operand.untyped || operand.expr.ty == long {
            return self.converted(operand, long, span);
        }
        Some(self.convert(Conversion::Value, operand.expr, long, span))
    }

    /// The integer type that is needed, else DINT.
    fn integer_result(&mut self, hint: Option<TypeId>) -> TypeId {
        let hinted = hint.filter(|hint| self.plain(*hint).is_some_and(is_integer));
        match hinted {
            Some(hinted) => hinted,
            None => self.elementary(Elementary::Dint),
        }
    }

    /// The type of what is made of these strings: as long as all together, so that nothing is cut.
    fn string_result(&mut self, given: &[Given]) -> Option<TypeId> {
        let (mut total, mut wide) = (0_u32, false);
        for (operand, _) in given {
            match self.checker.program.types.get(operand.expr.ty) {
                Type::String { capacity } => total += u32::from(*capacity),
                Type::WString { capacity } => {
                    total += u32::from(*capacity);
                    wide = true;
                }
                _ => return None,
            }
        }
        let capacity = u16::try_from(total).unwrap_or(u16::MAX);
        let types = &mut self.checker.program.types;
        Some(if wide { types.wstring(capacity) } else { types.string(capacity) })
    }

    /// A character is a string of one.
    fn character_as_text(&mut self, operand: Operand, span: Span) -> Operand {
        let ty = match self.plain(operand.expr.ty) {
            Some(Elementary::Char) => self.checker.program.types.string(1),
            Some(Elementary::Wchar) => self.checker.program.types.wstring(1),
            _ => return operand,
        };
        self.intrinsic(Intrinsic::FromUnit, vec![operand.expr], ty, span)
    }

    fn concatenate(&mut self, given: Vec<Given>, span: Span) -> Option<Operand> {
        let given: Vec<Given> = given
            .into_iter()
            .map(|(operand, place)| (self.character_as_text(operand, place), place))
            .collect();
        let first = given.first()?.0.expr.ty;
        for (operand, place) in &given {
            if !self.both_strings(first, operand.expr.ty) {
                self.no_conversion(operand.expr.ty, first, *place);
                return None;
            }
        }
        let mut rest = given.into_iter();
        let mut result = rest.next()?;
        for next in rest {
            let ty = self.string_result(&[result.clone(), next.clone()])?;
            let list = vec![result.0.expr, next.0.expr];
            result = (self.intrinsic(Intrinsic::Concat, list, ty, span), span);
        }
        Some(Operand::typed(result.0.expr))
    }

    fn chain(
        &mut self,
        operator: BinaryOperator,
        name: &Name,
        given: Vec<Given>,
        span: Span,
    ) -> Option<Operand> {
        let mut rest = given.into_iter();
        let mut result = rest.next()?;
        for next in rest {
            let operand = self.binary_operands(operator, name.span, result, next, span)?;
            result = (operand, span);
        }
        Some(result.0)
    }

    /// `GT(a, b, c)` is `a > b AND b > c`.
    fn comparisons(
        &mut self,
        operator: BinaryOperator,
        name: &Name,
        given: Vec<Given>,
        span: Span,
    ) -> Option<Operand> {
        let mut result: Option<Operand> = None;
        for pair in given.windows(2) {
            let [left, right] = pair else { return None };
            let one =
                self.binary_operands(operator, name.span, left.clone(), right.clone(), span)?;
            result = Some(match result {
                None => one,
                Some(before) => self.binary_operands(
                    BinaryOperator::And,
                    name.span,
                    (before, span),
                    (one, span),
                    span,
                )?,
            });
        }
        if given.len() > 2 && given[1..given.len() - 1].iter().any(|(one, _)| has_call(&one.expr)) {
            self.twice(name, span);
            return None;
        }
        result
    }

    fn twice(&mut self, name: &Name, span: Span) {
        let found = format!("a call as an argument of `{}` that is used twice", name.text);
        let one = Diagnostic::new(Code::NotSupported, span, found);
        self.tell(one.hint("assign its result to a variable first"));
    }

    fn multiplex(
        &mut self,
        mut given: Vec<Given>,
        function: &Function,
        name: &Name,
        hint: Option<TypeId>,
        span: Span,
    ) -> Option<Operand> {
        let (selector, place) = given.remove(0);
        let selector = self.as_long(selector, place)?;
        if given.len() > 2 && has_call(&selector) {
            self.twice(name, span);
            return None;
        }
        if let ExprKind::Constant(Constant::Integer(value)) = selector.kind
            && !(0..given.len() as i128).contains(&value)
        {
            let found = format!("the selector {value} of {} inputs", given.len());
            let one = Diagnostic::new(Code::OutOfRange, place, found);
            self.tell(one.allowed(format!("0..{}", given.len() - 1)));
            return None;
        }
        let ty = self.same(&given, function, hint)?;
        let mut list = self.all_as(given, ty)?.into_iter();
        let mut result = list.next()?;
        let bool_type = self.elementary(Elementary::Bool);
        for (at, next) in list.enumerate() {
            let number = self.integer(selector.ty, at as i128 + 1, place);
            // A selector above the last input selects the last.
            let kind = ExprKind::Compare(
                crate::hir::Comparison::GreaterEqual,
                Box::new(selector.clone()),
                Box::new(number),
            );
            let here = self.expr(bool_type, kind, place);
            let list = vec![here, result, next];
            result = self.intrinsic(Intrinsic::Select, list, ty, span).expr;
        }
        Some(Operand::typed(result))
    }
}

/// Whether an expression calls anything, which must not happen twice.
fn has_call(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Call(..) => true,
        ExprKind::Constant(_) | ExprKind::Bound { .. } => false,
        ExprKind::Load(place) | ExprKind::Reference(place) => place_has_call(place),
        ExprKind::Unary(_, part) | ExprKind::Convert(_, part) => has_call(part),
        ExprKind::Arithmetic(_, left, right)
        | ExprKind::Compare(_, left, right)
        | ExprKind::AndThen(left, right)
        | ExprKind::OrElse(left, right) => has_call(left) || has_call(right),
        ExprKind::Intrinsic(_, list) => list.iter().any(has_call),
    }
}

fn place_has_call(place: &crate::hir::Place) -> bool {
    use crate::hir::{Root, Step};
    let root = matches!(&place.root, Root::Deref(reference) if has_call(reference));
    root || place.path.iter().any(|step| match step {
        Step::Index(index) => has_call(index),
        Step::OpenIndex(list) => list.iter().any(has_call),
        _ => false,
    })
}
