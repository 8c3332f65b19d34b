//! Expressions.

use takt_st::hir::{
    Arithmetic, Class, Comparison, Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic,
    TrapKind, Type, UnaryOperator,
};

use super::{Frame, Machine, Outcome, Value, trap};

impl Machine<'_> {
    fn elementary(&self, expr: &Expr) -> Elementary {
        self.program.types.scalar(expr.ty).expect("a scalar type")
    }

    pub(super) fn expr(&mut self, frame: &Frame, expr: &Expr) -> Outcome<Value> {
        Ok(match &expr.kind {
            ExprKind::Constant(constant) => self.constant(expr, constant),
            ExprKind::Load(place) => {
                let target = self.place(frame, place)?;
                self.load_target(&target, place.ty)
            }
            ExprKind::Unary(operator, operand) => {
                let value = self.expr(frame, operand)?;
                let ty = self.elementary(expr);
                match (operator, value) {
                    (UnaryOperator::Negate, Value::Real(value)) => Value::Real(-value),
                    (UnaryOperator::Negate, value) => Value::Integer(ty.wrap(-value.integer())),
                    (UnaryOperator::Not, value) if ty == Elementary::Bool => {
                        Value::Integer(1 - value.integer())
                    }
                    (UnaryOperator::Not, value) => Value::Integer(ty.wrap(!value.integer())),
                }
            }
            ExprKind::Arithmetic(operator, left, right) => {
                let (left, right) = (self.expr(frame, left)?, self.expr(frame, right)?);
                self.arithmetic(expr, *operator, left, right)?
            }
            ExprKind::Compare(comparison, left, right) => {
                let (left, right) = (self.expr(frame, left)?, self.expr(frame, right)?);
                let order = match (&left, &right) {
                    (Value::Integer(left), Value::Integer(right)) => left.partial_cmp(right),
                    (Value::Real(left), Value::Real(right)) => left.partial_cmp(right),
                    (Value::Text(left), Value::Text(right)) => left.partial_cmp(right),
                    other => panic!("comparison of {other:?}"),
                };
                use std::cmp::Ordering::{Equal, Greater, Less};
                Value::Integer(i128::from(match comparison {
                    Comparison::Equal => order == Some(Equal),
                    Comparison::NotEqual => order != Some(Equal),
                    Comparison::Less => order == Some(Less),
                    Comparison::LessEqual => matches!(order, Some(Less | Equal)),
                    Comparison::Greater => order == Some(Greater),
                    Comparison::GreaterEqual => matches!(order, Some(Greater | Equal)),
                }))
            }
            ExprKind::AndThen(left, right) => match self.expr(frame, left)?.is_true() {
                true => self.expr(frame, right)?,
                false => Value::Integer(0),
            },
            ExprKind::OrElse(left, right) => match self.expr(frame, left)?.is_true() {
                true => Value::Integer(1),
                false => self.expr(frame, right)?,
            },
            ExprKind::Convert(conversion, operand) => {
                let value = self.expr(frame, operand)?;
                self.convert(expr, *conversion, operand, value)?
            }
            ExprKind::Call(routine, arguments) => self
                .call_routine(Some(frame), *routine, 0, arguments)?
                .expect("a function with a result"),
            ExprKind::Intrinsic(intrinsic, arguments) => {
                let values = arguments.iter().map(|argument| self.expr(frame, argument));
                let values = values.collect::<Outcome<Vec<Value>>>()?;
                self.intrinsic(expr, *intrinsic, values)
            }
            ExprKind::Reference(place) => {
                Value::Integer(i128::from(self.place(frame, place)?.address))
            }
            ExprKind::Bound { place, dimension, upper } => {
                let bounds = self.bounds_of(frame, place, place.ty).expect("an open array");
                let (low, high) = bounds[usize::from(*dimension)];
                Value::Integer(i128::from(if *upper { high } else { low }))
            }
        })
    }

    fn constant(&self, expr: &Expr, constant: &Constant) -> Value {
        let types = &self.program.types;
        match constant {
            Constant::Integer(value) => Value::Integer(*value),
            Constant::Real(value) if types.size(expr.ty) == 4 => {
                Value::Real(f64::from(*value as f32))
            }
            Constant::Real(value) => Value::Real(*value),
            Constant::String(bytes) => {
                Value::Text(bytes.iter().map(|&byte| u16::from(byte)).collect())
            }
            Constant::WString(units) => Value::Text(units.clone()),
            Constant::Address(id, fields) => {
                let offset = types.field_offset(self.program.global(*id).ty, fields);
                Value::Integer(i128::from(self.global_address(*id) + u64::from(offset)))
            }
            Constant::Default => match (types.get(expr.ty), types.scalar(expr.ty)) {
                (Type::String { .. } | Type::WString { .. }, _) => Value::Text(Vec::new()),
                (_, Some(elementary)) if elementary.class() == Class::Float => Value::Real(0.0),
                _ => Value::Integer(types.first_value(expr.ty)),
            },
            Constant::Aggregate(_) | Constant::Fill(_) => panic!("an expression is no aggregate"),
        }
    }

    fn arithmetic(
        &self,
        expr: &Expr,
        operator: Arithmetic,
        left: Value,
        right: Value,
    ) -> Outcome<Value> {
        let ty = self.elementary(expr);
        if let (Value::Real(left), Value::Real(right)) = (&left, &right) {
            // A sum, product or quotient of two binary32 numbers that is rounded to binary64 and then to binary32 is
            // the correctly rounded binary32 result.
            let value = match operator {
                Arithmetic::Add => left + right,
                Arithmetic::Subtract => left - right,
                Arithmetic::Multiply => left * right,
                Arithmetic::Divide => left / right,
                other => panic!("{other:?} of reals"),
            };
            return Ok(Value::Real(if ty == Elementary::Real {
                f64::from(value as f32)
            } else {
                value
            }));
        }
        let (left, right) = (left.integer(), right.integer());
        if right == 0 && matches!(operator, Arithmetic::Divide | Arithmetic::Modulo) {
            return trap(TrapKind::ZeroDivide, expr.location);
        }
        Ok(Value::Integer(ty.wrap(match operator {
            Arithmetic::Add => left + right,
            Arithmetic::Subtract => left - right,
            Arithmetic::Multiply => left.wrapping_mul(right),
            Arithmetic::Divide => left / right,
            Arithmetic::Modulo => left % right,
            Arithmetic::And => left & right,
            Arithmetic::Or => left | right,
            Arithmetic::Xor => left ^ right,
        })))
    }

    fn convert(
        &self,
        expr: &Expr,
        conversion: Conversion,
        operand: &Expr,
        value: Value,
    ) -> Outcome<Value> {
        let (from, to) = (self.elementary(operand), self.elementary(expr));
        Ok(match conversion {
            Conversion::Check => {
                let Type::Subrange { lower, upper, .. } = self.program.types.get(expr.ty) else {
                    panic!("no subrange")
                };
                if value.integer() < *lower || value.integer() > *upper {
                    return trap(TrapKind::Subrange, expr.location);
                }
                value
            }
            Conversion::Bits => {
                let bits = match (value, from) {
                    (Value::Real(value), Elementary::Real) => i128::from((value as f32).to_bits()),
                    (Value::Real(value), _) => i128::from(value.to_bits()),
                    (value, _) => value.integer(),
                };
                match to {
                    Elementary::Real => Value::Real(f64::from(f32::from_bits(bits as u32))),
                    Elementary::Lreal => Value::Real(f64::from_bits(bits as u64)),
                    to => Value::Integer(to.wrap(bits)),
                }
            }
            Conversion::Value | Conversion::Truncate => match (value, to) {
                (Value::Real(value), Elementary::Real) => Value::Real(f64::from(value as f32)),
                (Value::Real(value), Elementary::Lreal) => Value::Real(value),
                (Value::Real(value), Elementary::Bool) => Value::Integer(i128::from(value != 0.0)),
                (Value::Real(value), to) => {
                    let whole = if conversion == Conversion::Truncate {
                        value.trunc()
                    } else {
                        value.round_ties_even()
                    };
                    let (least, greatest) = to.range().expect("an integer");
                    // The cast saturates and makes 0 of NaN.
                    Value::Integer((whole as i128).clamp(least, greatest))
                }
                (value, Elementary::Real) => Value::Real(f64::from(value.integer() as f32)),
                (value, Elementary::Lreal) => Value::Real(value.integer() as f64),
                (value, Elementary::Char) if from == Elementary::Wchar => {
                    let known = u8::try_from(value.integer()).unwrap_or(b'?');
                    Value::Integer(i128::from(known))
                }
                (value, to) => Value::Integer(to.wrap(value.integer())),
            },
        })
    }

    fn intrinsic(&self, expr: &Expr, intrinsic: Intrinsic, values: Vec<Value>) -> Value {
        use Intrinsic::*;
        let mut values = values.into_iter();
        let mut next = || values.next().expect("an argument");
        match intrinsic {
            Now => Value::Integer(i128::from(self.job.now_ns)),
            Elapsed => Value::Integer(i128::from(self.job.elapsed_ns)),
            LogLine | ChannelRead(_) | ChannelWrite(_) | Simulate(_) => {
                unreachable!("no generated program calls the kernel")
            }
            Cycle => Value::Integer(i128::from(self.job.cycle)),
            Abs => match next() {
                Value::Real(value) => Value::Real(value.abs()),
                value => Value::Integer(self.elementary(expr).wrap(value.integer().abs())),
            },
            Sqrt | Ln | Log | Exp | Sin | Cos | Tan | Asin | Acos | Atan => {
                Value::Real(self.function(expr, intrinsic, next().real(), 0.0))
            }
            Atan2 | Power => {
                let (left, right) = (next().real(), next().real());
                Value::Real(self.function(expr, intrinsic, left, right))
            }
            Min | Max => {
                let (left, right) = (next(), next());
                let less = match (&left, &right) {
                    (Value::Real(left), Value::Real(right)) if intrinsic == Min => left < right,
                    (Value::Real(left), Value::Real(right)) => left > right,
                    (Value::Text(left), Value::Text(right)) if intrinsic == Min => left < right,
                    (Value::Text(left), Value::Text(right)) => left > right,
                    (left, right) if intrinsic == Min => left.integer() < right.integer(),
                    (left, right) => left.integer() > right.integer(),
                };
                if less { left } else { right }
            }
            Limit => {
                let (least, value, most) = (next().real(), next().real(), next().real());
                let raised = if value < least { least } else { value };
                Value::Real(if most < raised { most } else { raised })
            }
            Select => {
                let (choice, zero, one) = (next(), next(), next());
                if choice.is_true() { one } else { zero }
            }
            ShiftLeft | ShiftRight | RotateLeft | RotateRight => {
                let (value, count) = (next().integer(), next().integer());
                self.shift(self.elementary(expr), intrinsic, value, count)
            }
            Length => Value::Integer(next().text().len() as i128),
            Left | Right | Mid => {
                let (text, count) = (next().text(), next().integer());
                let length = text.len() as i128;
                let start = match intrinsic {
                    Left => 0,
                    Right => length - count.clamp(0, length),
                    _ => next().integer() - 1,
                };
                let end = (start + count.max(0)).clamp(0, length);
                let start = start.clamp(0, end);
                Value::Text(text[start as usize..end as usize].to_vec())
            }
            Concat => {
                let mut text = next().text();
                text.extend(next().text());
                text.truncate(self.capacity(expr));
                Value::Text(text)
            }
            Find => {
                let (text, sought) = (next().text(), next().text());
                let at = match sought.is_empty() {
                    true => None,
                    false => text.windows(sought.len()).position(|window| window == sought),
                };
                Value::Integer(at.map_or(0, |at| at as i128 + 1))
            }
            UnitAt => {
                let (text, position) = (next().text(), next().integer());
                let unit =
                    usize::try_from(position - 1).ok().and_then(|index| text.get(index).copied());
                Value::Integer(i128::from(unit.unwrap_or(0)))
            }
            FromUnit => {
                let mut text = vec![next().integer() as u16];
                text.retain(|unit| *unit != 0);
                text.truncate(self.capacity(expr));
                Value::Text(text)
            }
        }
    }

    fn capacity(&self, expr: &Expr) -> usize {
        match self.program.types.get(expr.ty) {
            Type::String { capacity } | Type::WString { capacity } => usize::from(*capacity),
            other => panic!("{other:?} is no string"),
        }
    }

    fn shift(&self, ty: Elementary, intrinsic: Intrinsic, value: i128, count: i128) -> Value {
        let width = i128::from(ty.size()) * 8;
        let mask = (1i128 << width) - 1;
        let bits = value & mask;
        let rotated = |left: i128| bits << left | bits >> (width - left);
        let shifted = count.clamp(0, width);
        Value::Integer(ty.wrap(match intrinsic {
            Intrinsic::ShiftLeft => bits << shifted,
            Intrinsic::ShiftRight => bits >> shifted,
            Intrinsic::RotateLeft => rotated(count.rem_euclid(width)),
            _ => rotated((-count).rem_euclid(width)),
        }))
    }

    /// The functions of the crate `libm`, as the compiled program has them.
    fn function(&self, expr: &Expr, intrinsic: Intrinsic, x: f64, y: f64) -> f64 {
        use Intrinsic::*;
        if self.elementary(expr) == Elementary::Real {
            let (x, y) = (x as f32, y as f32);
            return f64::from(match intrinsic {
                Sqrt => x.sqrt(),
                Ln => libm::logf(x),
                Log => libm::log10f(x),
                Exp => libm::expf(x),
                Sin => libm::sinf(x),
                Cos => libm::cosf(x),
                Tan => libm::tanf(x),
                Asin => libm::asinf(x),
                Acos => libm::acosf(x),
                Atan => libm::atanf(x),
                Atan2 => libm::atan2f(x, y),
                _ => libm::powf(x, y),
            });
        }
        match intrinsic {
            Sqrt => x.sqrt(),
            Ln => libm::log(x),
            Log => libm::log10(x),
            Exp => libm::exp(x),
            Sin => libm::sin(x),
            Cos => libm::cos(x),
            Tan => libm::tan(x),
            Asin => libm::asin(x),
            Acos => libm::acos(x),
            Atan => libm::atan(x),
            Atan2 => libm::atan2(x, y),
            _ => libm::pow(x, y),
        }
    }
}
