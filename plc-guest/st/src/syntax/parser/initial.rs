//! Initial values.

use super::{Parse, Parser};
use crate::syntax::ast::{ArrayElement, Initial, Name};
use crate::syntax::token::{Sign, TokenKind};

impl Parser<'_> {
    pub(super) fn initial(&mut self) -> Parse<Initial> {
        self.deeper(|parser| {
            let start = parser.current.span;
            match parser.current.kind {
                TokenKind::Sign(Sign::OpenBracket) => {
                    parser.advance();
                    let elements = parser.array_elements()?;
                    Ok(Initial::Array(elements, start.to(parser.previous)))
                }
                TokenKind::Sign(Sign::OpenParenthesis) if parser.at_structure() => {
                    parser.advance();
                    let fields = parser.structure_elements()?;
                    Ok(Initial::Structure(fields, start.to(parser.previous)))
                }
                _ => Ok(Initial::Value(parser.expression()?)),
            }
        })
    }

    /// Whether the parenthesis opens a list of fields and not an expression.
    fn at_structure(&self) -> bool {
        self.peek(1) == TokenKind::Identifier && self.peek(2) == TokenKind::Sign(Sign::Assign)
    }

    fn structure_elements(&mut self) -> Parse<Vec<(Name, Initial)>> {
        let mut fields = Vec::new();
        loop {
            let name = self.name("the name of a field")?;
            self.expect_sign(Sign::Assign)?;
            fields.push((name, self.initial()?));
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::CloseParenthesis)?;
        Ok(fields)
    }

    fn array_elements(&mut self) -> Parse<Vec<ArrayElement>> {
        let mut elements = Vec::new();
        if self.eat_sign(Sign::CloseBracket).is_some() {
            return Ok(elements);
        }
        loop {
            elements.push(self.array_element()?);
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::CloseBracket)?;
        Ok(elements)
    }

    fn array_element(&mut self) -> Parse<ArrayElement> {
        let repeated = matches!(self.current.kind, TokenKind::Integer | TokenKind::BasedInteger)
            && self.peek(1) == TokenKind::Sign(Sign::OpenParenthesis);
        if !repeated {
            return Ok(ArrayElement::One(self.initial()?));
        }
        let count = self.postfix()?;
        self.expect_sign(Sign::OpenParenthesis)?;
        let mut values = Vec::new();
        if !self.at_sign(Sign::CloseParenthesis) {
            values.push(self.initial()?);
            while self.eat_sign(Sign::Comma).is_some() {
                values.push(self.initial()?);
            }
        }
        self.expect_sign(Sign::CloseParenthesis)?;
        Ok(ArrayElement::Repeated(count, values))
    }
}
