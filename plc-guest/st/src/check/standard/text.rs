//! Strings that are made of strings and characters.

use super::super::body::Body;
use super::super::expression::Operand;
use super::Given;
use crate::hir::{Elementary, Intrinsic, Type, TypeId};
use crate::source::Span;

impl<'a> Body<'_, 'a> {
    /// The type of what is made of these strings: as long as all together, so that nothing is cut.
    pub(super) fn string_result(&mut self, given: &[Given]) -> Option<TypeId> {
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

    pub(super) fn concatenate(&mut self, given: Vec<Given>, span: Span) -> Option<Operand> {
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
}
