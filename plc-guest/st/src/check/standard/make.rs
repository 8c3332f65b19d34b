//! What a call of a standard function becomes.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::operator::Written;
use super::super::types::{is_integer, is_real, is_shiftable};
use super::Given;
use super::table::{Function, Make};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Conversion, Elementary, Expr, Intrinsic, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Name};

impl<'a> Body<'_, 'a> {
    pub(super) fn make(
        &mut self,
        function: &Function,
        name: &Name,
        mut given: Vec<Given>,
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        match function.make {
            Make::Operator(operator) => self.chain(operator, name, given, span, hint),
            Make::Comparison(operator) => self.comparisons(operator, name, given, span),
            Make::Power => {
                let (exponent, base) = (given.pop()?, given.pop()?);
                let operator = BinaryOperator::Power;
                let power = Written { operator, place: name.span, span, needed: hint };
                self.binary_operands(power, base, exponent)
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
                if self.plain(ty).is_some_and(is_real) {
                    let list = vec![least, value, most];
                    return Some(self.intrinsic(Intrinsic::Limit, list, ty, span));
                }
                let above = self.intrinsic(Intrinsic::Max, vec![least, value], ty, span).expr;
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
                let needed = hint.filter(|ty| {
                    self.plain(*ty).is_some_and(is_shiftable) && self.takes(&value, *ty)
                });
                let value = match needed {
                    Some(ty) if value.untyped => self.converted(value, ty, at)?,
                    None if value.untyped => {
                        self.no_type(name, at);
                        return None;
                    }
                    _ => value.expr,
                };
                let ty = value.ty;
                let count = match intrinsic {
                    // The low bits of the count are enough.
                    Intrinsic::RotateLeft | Intrinsic::RotateRight => self.as_long(count, place)?,
                    _ => self.as_length(count, place)?,
                };
                Some(self.intrinsic(intrinsic, vec![value, count], ty, span))
            }
            Make::Text(intrinsic) => {
                let ty = self.string_result(&given[..1])?;
                let mut given = given.into_iter();
                let mut list = vec![given.next()?.0.expr];
                for (operand, place) in given {
                    list.push(self.as_length(operand, place)?);
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
                let longest = match self.checker.program.types.get(given.first()?.0.expr.ty) {
                    Type::String { capacity } | Type::WString { capacity } => *capacity,
                    _ => u16::MAX,
                };
                let long = self.elementary(Elementary::Lint);
                let list = given.into_iter().map(|(operand, _)| operand.expr).collect();
                let measured = self.intrinsic(intrinsic, list, long, span).expr;
                let (ty, fits) = self.integer_result(hint, 0..=longest.into(), span);
                Some(Operand::typed(match fits {
                    true => self.convert(Conversion::Value, measured, ty, span),
                    false => self.of_needed_type(measured, Some(ty), span),
                }))
            }
            Make::LogLine => {
                let (line, place) = given.pop()?;
                if let Type::WString { .. } = self.checker.program.types.get(line.expr.ty) {
                    let found = "a WSTRING as a line of the log";
                    let one = Diagnostic::new(Code::TypeMismatch, place, found);
                    self.tell(one.allowed("STRING").hint("convert it: `WSTRING_TO_STRING(...)`"));
                    return None;
                }
                let long = self.elementary(Elementary::Lint);
                Some(self.intrinsic(Intrinsic::LogLine, vec![line.expr], long, span))
            }
            Make::Truncate => {
                let (operand, _) = given.pop()?;
                let values = i32::MIN.into()..=i32::MAX.into();
                let (ty, _) = self.integer_result(hint, values, span);
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
}
