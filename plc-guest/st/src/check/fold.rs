//! The values of constant expressions, computed as the program would.

use super::body::Body;
use super::literal::{real, real_of};
use super::types::is_real;
use crate::hir::{Arithmetic, Comparison, Constant, Conversion, Elementary, Type, TypeId};

impl Body<'_, '_> {
    pub(super) fn fold_conversion(
        &self,
        conversion: Conversion,
        value: &Constant,
        from: TypeId,
        to: TypeId,
    ) -> Option<Constant> {
        let (from, target) = (self.scalar(from)?, self.scalar(to)?);
        match conversion {
            Conversion::Check => match (value, self.checker.program.types.get(to)) {
                (Constant::Integer(number), Type::Subrange { lower, upper, .. })
                    if (lower..=upper).contains(&number) =>
                {
                    Some(value.clone())
                }
                _ => None,
            },
            Conversion::Value => match (value, is_real(target)) {
                (Constant::Integer(number), _)
                    if (from, target) == (Elementary::Wchar, Elementary::Char) =>
                {
                    Some(Constant::Integer(u8::try_from(*number).unwrap_or(b'?').into()))
                }
                (Constant::Integer(number), true) => Some(real_of(target, *number)),
                (Constant::Real(number), true) => Some(real(target, *number)),
                (Constant::Integer(number), false) => Some(Constant::Integer(target.wrap(*number))),
                (Constant::Real(number), false) if target == Elementary::Bool => {
                    Some(Constant::Integer((*number != 0.0).into()))
                }
                (Constant::Real(number), false) => {
                    Some(Constant::Integer(saturated(number.round_ties_even(), target)?))
                }
                _ => None,
            },
            Conversion::Truncate => match value {
                Constant::Real(number) => {
                    Some(Constant::Integer(saturated(number.trunc(), target)?))
                }
                _ => None,
            },
            Conversion::Bits => match (value, is_real(from), is_real(target)) {
                (Constant::Integer(_), false, false) => {
                    let Constant::Integer(number) = value else { return None };
                    Some(Constant::Integer(target.wrap(*number)))
                }
                _ => None,
            },
        }
    }

    /// None if it has no value, such as a division by zero.
    pub(super) fn fold_arithmetic(
        &self,
        operator: Arithmetic,
        left: &Constant,
        right: &Constant,
        ty: TypeId,
    ) -> Option<Constant> {
        let scalar = self.scalar(ty)?;
        match (left, right) {
            (Constant::Integer(a), Constant::Integer(b)) => {
                Some(Constant::Integer(scalar.wrap(integers(operator, *a, *b)?)))
            }
            (Constant::Real(a), Constant::Real(b)) => {
                let value = match operator {
                    Arithmetic::Add => a + b,
                    Arithmetic::Subtract => a - b,
                    Arithmetic::Multiply => a * b,
                    Arithmetic::Divide => a / b,
                    _ => return None,
                };
                Some(real(scalar, value))
            }
            _ => None,
        }
    }
}

/// As if integers had no end.
pub(super) fn integers(operator: Arithmetic, a: i128, b: i128) -> Option<i128> {
    match operator {
        Arithmetic::Add => a.checked_add(b),
        Arithmetic::Subtract => a.checked_sub(b),
        Arithmetic::Multiply => a.checked_mul(b),
        Arithmetic::Divide => a.checked_div(b),
        Arithmetic::Modulo => a.checked_rem(b),
        Arithmetic::And => Some(a & b),
        Arithmetic::Or => Some(a | b),
        Arithmetic::Xor => Some(a ^ b),
    }
}

pub(super) fn compare(operator: Comparison, left: &Constant, right: &Constant) -> Option<bool> {
    use std::cmp::Ordering;
    let order = match (left, right) {
        (Constant::Integer(a), Constant::Integer(b)) => Some(a.cmp(b)),
        (Constant::Real(a), Constant::Real(b)) => a.partial_cmp(b),
        (Constant::String(a), Constant::String(b)) => Some(a.cmp(b)),
        (Constant::WString(a), Constant::WString(b)) => Some(a.cmp(b)),
        _ => return None,
    };
    Some(match operator {
        Comparison::Equal => order == Some(Ordering::Equal),
        Comparison::NotEqual => order != Some(Ordering::Equal),
        Comparison::Less => order == Some(Ordering::Less),
        Comparison::LessEqual => matches!(order, Some(Ordering::Less | Ordering::Equal)),
        Comparison::Greater => order == Some(Ordering::Greater),
        Comparison::GreaterEqual => matches!(order, Some(Ordering::Greater | Ordering::Equal)),
    })
}

/// A whole number as a value of an integer type: the nearest that it has, 0 for NaN.
fn saturated(number: f64, target: Elementary) -> Option<i128> {
    let (least, most) = target.range()?;
    // Conversions to i128 saturate too, and make 0 of NaN.
    Some((number as i128).clamp(least, most))
}
