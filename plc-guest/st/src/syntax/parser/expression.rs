//! Expressions, by the binding powers of the standard's grammar (IEC 61131-3:2013, annex A).
//!
//! All operators with two operands group to the left, `**` too; a sign binds tighter than `**`, so
//! `-2 ** 2` is 4.

use super::super::literal;
use super::{Parse, Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::limits;
use crate::source::Span;
use crate::syntax::ast::{
    Argument, BinaryOperator, Binding, Expression, ExpressionKind, Literal, LiteralValue, Name,
    UnaryOperator, Width,
};
use crate::syntax::token::{Keyword, Sign, TokenKind};

const VALUE: &str = "a value: a variable, a literal, a call or `(`";

impl Parser<'_> {
    pub(super) fn expression(&mut self) -> Parse<Expression> {
        self.binary(0)
    }

    /// An expression of operators that bind at least as tight as `least`.
    fn binary(&mut self, least: u8) -> Parse<Expression> {
        let mut left = self.unary()?;
        loop {
            self.foreign_operator(&mut left)?;
            let Some((operator, power)) = operator(self.current.kind) else { break };
            if power < least {
                break;
            }
            let place = self.advance();
            self.foreign_sign(&left, place)?;
            let right = self.deeper(|parser| parser.binary(power + 1))?;
            let span = left.span.to(right.span);
            let kind = ExpressionKind::Binary(operator, place, Box::new(left), Box::new(right));
            left = self.grown(kind, span)?;
        }
        Ok(left)
    }

    fn unary(&mut self) -> Parse<Expression> {
        let operator = match self.current.kind {
            TokenKind::Sign(Sign::Minus) => UnaryOperator::Negate,
            TokenKind::Sign(Sign::Plus) => UnaryOperator::Plus,
            TokenKind::Keyword(Keyword::Not) => UnaryOperator::Not,
            _ => return self.postfix(),
        };
        let start = self.advance();
        let operand = self.deeper(Self::unary)?;
        let span = start.to(operand.span);
        self.grown(ExpressionKind::Unary(operator, Box::new(operand)), span)
    }

    /// A value with its fields, indices, dereferences and calls.
    pub(super) fn postfix(&mut self) -> Parse<Expression> {
        let mut base = self.primary()?;
        loop {
            let start = base.span;
            let kind = match self.current.kind {
                TokenKind::Sign(Sign::Dot) => {
                    self.advance();
                    self.member(base)?
                }
                TokenKind::Sign(Sign::OpenBracket) => {
                    self.advance();
                    let indices = self.deeper(Self::expressions)?;
                    self.expect_sign(Sign::CloseBracket)?;
                    ExpressionKind::Index(Box::new(base), indices)
                }
                TokenKind::Sign(Sign::Caret) => {
                    self.advance();
                    ExpressionKind::Dereference(Box::new(base))
                }
                TokenKind::Sign(Sign::OpenParenthesis) if callable(&base) => {
                    self.advance();
                    let arguments = self.deeper(Self::arguments)?;
                    ExpressionKind::Call(Box::new(base), arguments)
                }
                _ => return Ok(base),
            };
            let span = start.to(self.previous);
            base = self.grown(kind, span)?;
        }
    }

    fn member(&mut self, base: Expression) -> Parse<ExpressionKind> {
        let place = self.current.span;
        match self.current.kind {
            TokenKind::Integer => {
                let number = self.text(place).parse().unwrap_or(u32::MAX);
                self.advance();
                Ok(ExpressionKind::Part(Box::new(base), Width::Bit, number, place))
            }
            TokenKind::Address => {
                let (width, number) = self.part()?;
                Ok(ExpressionKind::Part(Box::new(base), width, number, place))
            }
            _ => {
                let name = self.name("the name of a field or the number of a bit")?;
                Ok(ExpressionKind::Field(Box::new(base), name))
            }
        }
    }

    pub(super) fn expressions(&mut self) -> Parse<Vec<Expression>> {
        let mut list = vec![self.expression()?];
        while self.eat_sign(Sign::Comma).is_some() {
            list.push(self.expression()?);
        }
        Ok(list)
    }

    fn primary(&mut self) -> Parse<Expression> {
        let span = self.current.span;
        let kind = match self.current.kind {
            TokenKind::Identifier => {
                self.advance();
                ExpressionKind::Name(Name::new(self.text(span), span))
            }
            TokenKind::Address => ExpressionKind::Address(self.address()?),
            TokenKind::TypePrefix => return self.prefixed(),
            TokenKind::Sign(Sign::OpenParenthesis) => {
                self.advance();
                let inner = self.deeper(Self::expression)?;
                self.expect_sign(Sign::CloseParenthesis)?;
                ExpressionKind::Parenthesised(Box::new(inner))
            }
            // The functions that are named as operators: `AND(a, b)`.
            TokenKind::Keyword(Keyword::And | Keyword::Or | Keyword::Xor | Keyword::Mod)
                if self.peek(1) == TokenKind::Sign(Sign::OpenParenthesis) =>
            {
                self.advance();
                ExpressionKind::Name(Name::new(self.text(span), span))
            }
            TokenKind::Keyword(Keyword::This | Keyword::Super) => {
                return Err(self.refuse("THIS or SUPER"));
            }
            _ => match self.literal_value()? {
                Some(value) => ExpressionKind::Literal(Literal { prefix: None, value }),
                None => return Err(self.unexpected(VALUE)),
            },
        };
        self.grown(kind, span.to(self.previous))
    }

    /// `INT#5`, `BOOL#TRUE`, `Colour#Red`.
    fn prefixed(&mut self) -> Parse<Expression> {
        let start = self.advance();
        let text = self.text(start);
        let prefix = text.strip_suffix('#').unwrap_or(text);
        let place = Span { end: start.end.saturating_sub(1), ..start };
        if self.current.kind == TokenKind::Identifier {
            let value = self.name("a value of the enumeration")?;
            let span = start.to(value.span);
            let kind =
                ExpressionKind::EnumerationValue(Box::new((Name::new(prefix, place), value)));
            return Ok(Expression::new(kind, span));
        }
        let sign = match self.current.kind {
            TokenKind::Sign(Sign::Minus) => Some(UnaryOperator::Negate),
            TokenKind::Sign(Sign::Plus) => Some(UnaryOperator::Plus),
            _ => None,
        };
        if sign.is_some() {
            self.advance();
        }
        let Some(value) = self.literal_value()? else {
            return Err(self.unexpected("a literal or a value of an enumeration behind `#`"));
        };
        let span = start.to(self.previous);
        let prefix = Some(prefix.to_ascii_uppercase().into());
        let kind = ExpressionKind::Literal(Literal { prefix, value });
        let inner = Expression::new(kind, span);
        Ok(match sign {
            Some(sign) => Expression::new(ExpressionKind::Unary(sign, Box::new(inner)), span),
            None => inner,
        })
    }

    /// The literal at the current word. A wrong one is told of and taken.
    fn literal_value(&mut self) -> Parse<Option<LiteralValue>> {
        let span = self.current.span;
        let text = self.text(span);
        let value = match self.current.kind {
            TokenKind::Integer => literal::integer(text),
            TokenKind::BasedInteger => literal::based(text),
            TokenKind::Real => literal::real(text),
            TokenKind::Duration => literal::duration(text),
            TokenKind::Date => literal::date(text),
            TokenKind::TimeOfDay => literal::time_of_day(text),
            TokenKind::DateAndTime => literal::date_and_time(text),
            TokenKind::String => literal::string(text),
            TokenKind::WideString => literal::wide_string(text),
            TokenKind::Keyword(Keyword::True) => Ok(LiteralValue::Bool(true)),
            TokenKind::Keyword(Keyword::False) => Ok(LiteralValue::Bool(false)),
            TokenKind::Keyword(Keyword::Null) => Ok(LiteralValue::Null),
            _ => return Ok(None),
        };
        let value = value.unwrap_or_else(|(found, allowed)| {
            self.tell(Diagnostic::new(Code::InvalidLiteral, span, found).allowed(allowed));
            // The build fails in any case; what stands for it must only be of no other type.
            match self.current.kind {
                TokenKind::String => LiteralValue::String(Vec::new()),
                TokenKind::WideString => LiteralValue::WideString(Vec::new()),
                TokenKind::Duration => LiteralValue::Duration { nanoseconds: 0, long: false },
                TokenKind::Date => LiteralValue::Date { nanoseconds: 0, long: false },
                TokenKind::TimeOfDay => LiteralValue::TimeOfDay { nanoseconds: 0, long: false },
                TokenKind::DateAndTime => LiteralValue::DateAndTime { nanoseconds: 0, long: false },
                _ => LiteralValue::Integer(1),
            }
        });
        self.advance();
        Ok(Some(value))
    }

    /// The arguments behind `(`, with the `)`.
    pub(super) fn arguments(&mut self) -> Parse<Vec<Argument>> {
        let mut arguments = Vec::new();
        if self.eat_sign(Sign::CloseParenthesis).is_some() {
            return Ok(arguments);
        }
        loop {
            arguments.push(self.argument()?);
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        if self.eat_sign(Sign::CloseParenthesis).is_none() {
            return Err(self.missing(")"));
        }
        Ok(arguments)
    }

    fn argument(&mut self) -> Parse<Argument> {
        let first = self.expression()?;
        let start = first.span;
        let binding = match (&first.kind, self.current.kind) {
            (ExpressionKind::Name(name), TokenKind::Sign(Sign::Assign)) => {
                Some((name.clone(), Binding::Input))
            }
            (ExpressionKind::Name(name), TokenKind::Sign(Sign::OutputAssign)) => {
                Some((name.clone(), Binding::Output))
            }
            (
                ExpressionKind::Unary(UnaryOperator::Not, name),
                TokenKind::Sign(Sign::OutputAssign),
            ) => match &name.kind {
                ExpressionKind::Name(name) => Some((name.clone(), Binding::NegatedOutput)),
                _ => None,
            },
            _ => None,
        };
        let Some(binding) = binding else {
            return Ok(Argument { name: None, value: Some(first), span: start });
        };
        self.advance();
        let unconnected = binding.1 != Binding::Input
            && matches!(self.current.kind, TokenKind::Sign(Sign::Comma | Sign::CloseParenthesis));
        let value = if unconnected { None } else { Some(self.expression()?) };
        Ok(Argument { name: Some(binding), value, span: start.to(self.previous) })
    }

    /// A node, unless the tree would grow too high.
    fn grown(&mut self, kind: ExpressionKind, span: Span) -> Parse<Expression> {
        let grown = Expression::new(kind, span);
        if grown.height <= limits::HEIGHT {
            return Ok(grown);
        }
        let found = "an expression with too many parts";
        let allowed = format!(
            "at most {} operators and arguments in a row or within each other",
            limits::HEIGHT
        );
        let one = Diagnostic::new(Code::TooDeep, span, found).allowed(allowed);
        self.tell(one.hint("use several statements"));
        Err(Told)
    }
}

fn callable(base: &Expression) -> bool {
    matches!(
        base.kind,
        ExpressionKind::Name(_)
            | ExpressionKind::Field(..)
            | ExpressionKind::Index(..)
            | ExpressionKind::Dereference(_)
    )
}

/// The operator of a word, and how tight it binds.
fn operator(kind: TokenKind) -> Option<(BinaryOperator, u8)> {
    use BinaryOperator as Op;
    Some(match kind {
        TokenKind::Keyword(Keyword::Or) => (Op::Or, 1),
        TokenKind::Keyword(Keyword::OrElse) => (Op::OrElse, 1),
        TokenKind::Keyword(Keyword::Xor) => (Op::Xor, 2),
        TokenKind::Keyword(Keyword::And) | TokenKind::Sign(Sign::Ampersand) => (Op::And, 3),
        TokenKind::Keyword(Keyword::AndThen) => (Op::AndThen, 3),
        TokenKind::Sign(Sign::Equal) => (Op::Equal, 4),
        TokenKind::Sign(Sign::NotEqual) => (Op::NotEqual, 4),
        TokenKind::Sign(Sign::Less) => (Op::Less, 5),
        TokenKind::Sign(Sign::Greater) => (Op::Greater, 5),
        TokenKind::Sign(Sign::LessEqual) => (Op::LessEqual, 5),
        TokenKind::Sign(Sign::GreaterEqual) => (Op::GreaterEqual, 5),
        TokenKind::Sign(Sign::Plus) => (Op::Add, 6),
        TokenKind::Sign(Sign::Minus) => (Op::Subtract, 6),
        TokenKind::Sign(Sign::Times) => (Op::Multiply, 7),
        TokenKind::Sign(Sign::Divide) => (Op::Divide, 7),
        TokenKind::Keyword(Keyword::Mod) => (Op::Modulo, 7),
        TokenKind::Sign(Sign::Power) => (Op::Power, 8),
        _ => return None,
    })
}
