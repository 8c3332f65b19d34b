//! TYPE blocks, and types as they are written.

use super::{Parse, Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::Elementary;
use crate::source::Span;
use crate::syntax::ast::{
    ArrayRange, Declaration, EnumerationValue, Expression, Name, TypeDeclaration, TypeKind,
    TypeSpec,
};
use crate::syntax::token::{Keyword, Sign, TokenKind};

const TYPE: &str =
    "a type: a name, ARRAY, STRING, REF_TO, STRUCT or `(` with the values of an enumeration";

impl Parser<'_> {
    pub(super) fn type_block(&mut self, into: &mut Vec<Declaration>) -> Parse<()> {
        let open = self.advance();
        loop {
            while self.eat_sign(Sign::Semicolon).is_some() {}
            // A keyword before a colon was meant as a name.
            let named = self.current.kind == TokenKind::Identifier
                || self.peek(1) == TokenKind::Sign(Sign::Colon);
            if !named {
                break;
            }
            let start = self.current.span;
            match self.type_declaration() {
                Ok(declaration) => into.push(Declaration::Type(declaration)),
                Err(Told) => {
                    // At least one word: else `END_TYPE :` would be tried again and again.
                    if self.current.span == start {
                        self.advance();
                    }
                    self.skip_to(|kind| {
                        matches!(
                            kind,
                            TokenKind::Sign(Sign::Semicolon) | TokenKind::Keyword(Keyword::EndType)
                        ) || super::unit::begins_declaration(kind)
                    });
                }
            }
        }
        self.close(Keyword::EndType, open)?;
        self.eat_sign(Sign::Semicolon);
        Ok(())
    }

    fn type_declaration(&mut self) -> Parse<TypeDeclaration> {
        let name = self.name("the name of a type")?;
        self.refuse_extended_structure();
        self.expect_sign(Sign::Colon)?;
        let spec = self.type_spec()?;
        let initial = match self.eat_sign(Sign::Assign) {
            Some(_) => Some(self.initial()?),
            None => None,
        };
        self.end_of_declaration()?;
        let span = name.span.to(self.previous);
        Ok(TypeDeclaration { name, spec, initial, span })
    }

    pub(super) fn type_spec(&mut self) -> Parse<TypeSpec> {
        let start = self.current.span;
        let kind = self.deeper(Self::type_kind)?;
        Ok(TypeSpec { kind, span: start.to(self.previous) })
    }

    fn type_kind(&mut self) -> Parse<TypeKind> {
        let open = self.current.span;
        match self.current.kind {
            TokenKind::Keyword(Keyword::Array) => {
                self.advance();
                self.array()
            }
            TokenKind::Keyword(Keyword::Struct) => {
                self.advance();
                if self.at_keyword(Keyword::Overlap) {
                    self.refuse("OVERLAP");
                    self.advance();
                }
                self.refuse_extended_structure();
                let mut fields = Vec::new();
                self.variables(&mut fields);
                self.close(Keyword::EndStruct, open)?;
                Ok(TypeKind::Structure { fields })
            }
            TokenKind::Keyword(Keyword::RefTo) => {
                self.advance();
                Ok(TypeKind::Reference(Box::new(self.type_spec()?)))
            }
            TokenKind::Sign(Sign::OpenParenthesis) => {
                let values = self.enumeration_values()?;
                Ok(TypeKind::Enumeration { base: self.base_behind(open), values })
            }
            // A type may have this name.
            TokenKind::Identifier
                if self.text(open).eq_ignore_ascii_case("UNION")
                    && self.peek(1) == TokenKind::Identifier =>
            {
                Ok(TypeKind::Structure { fields: self.union() })
            }
            TokenKind::Identifier => self.named_type(),
            _ => Err(self.unexpected(TYPE)),
        }
    }

    fn array(&mut self) -> Parse<TypeKind> {
        self.expect_sign(Sign::OpenBracket)?;
        let mut ranges = Vec::new();
        loop {
            if let Some(span) = self.eat_sign(Sign::Times) {
                ranges.push(ArrayRange::Open(span));
            } else {
                let low = self.expression()?;
                if self.eat_sign(Sign::Range).is_none() {
                    let found = "one bound of an array";
                    let one = Diagnostic::new(Code::Syntax, low.span, found)
                        .allowed("`[low..high]`, both bounds included")
                        .hint(format!("write `[0..{} - 1]` or `[1..{0}]`", self.text(low.span)));
                    return Err(self.tell(one));
                }
                let high = self.expression()?;
                ranges.push(ArrayRange::Fixed(Box::new((low, high))));
            }
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::CloseBracket)?;
        self.expect_keyword(Keyword::Of)?;
        let element = Box::new(self.type_spec()?);
        Ok(TypeKind::Array { ranges, element })
    }

    /// A name, and what may stand behind one: a length, a range or the values of an enumeration.
    fn named_type(&mut self) -> Parse<TypeKind> {
        let name = self.name(TYPE)?;
        let wide = match &*name.key {
            "STRING" => Some(false),
            "WSTRING" => Some(true),
            "POINTER" | "REFERENCE" if self.at_keyword(Keyword::To) => {
                let found = format!("`{} TO`, which is not of the standard", name.text);
                let one = Diagnostic::new(Code::NotSupported, name.span, found)
                    .allowed("`REF_TO type`, with `REF(variable)` and `reference^`");
                return Err(self.tell(one));
            }
            _ => None,
        };
        if let Some(wide) = wide {
            return self.text_type(&name, wide);
        }
        if self.at_sign(Sign::Dot) {
            self.refuse("a qualified name (namespaces)");
            return Err(Told);
        }
        if !self.at_sign(Sign::OpenParenthesis) {
            return Ok(TypeKind::Named(name));
        }
        let values = self.peek(1) == TokenKind::Identifier
            && matches!(
                self.peek(2),
                TokenKind::Sign(Sign::Comma | Sign::Assign | Sign::CloseParenthesis)
            );
        // `fb : TON (PT := T#1s)` looks like an enumeration, but those have an elementary base.
        let elementary = Elementary::ALL.iter().any(|known| known.name() == &*name.key);
        if values && !elementary {
            return Ok(TypeKind::Named(name));
        }
        if values {
            let values = self.enumeration_values()?;
            return Ok(TypeKind::Enumeration { base: Some(name), values });
        }
        self.advance();
        let low = Box::new(self.expression()?);
        self.expect_sign(Sign::Range)?;
        let high = Box::new(self.expression()?);
        self.expect_sign(Sign::CloseParenthesis)?;
        Ok(TypeKind::Subrange { base: name, low, high })
    }

    fn text_type(&mut self, name: &Name, wide: bool) -> Parse<TypeKind> {
        if self.at_sign(Sign::OpenParenthesis) {
            let found = format!("`(` behind {}", name.text);
            let one = Diagnostic::new(Code::Syntax, self.current.span, found)
                .allowed(format!("`{}[80]`: the length in square brackets", name.text));
            return Err(self.tell(one));
        }
        let mut length: Option<Box<Expression>> = None;
        if self.eat_sign(Sign::OpenBracket).is_some() {
            length = Some(Box::new(self.expression()?));
            self.expect_sign(Sign::CloseBracket)?;
        }
        Ok(TypeKind::Text { wide, length })
    }

    /// The type of an enumeration behind its values, where other tools have it. It is told of and taken.
    fn base_behind(&mut self, values: Span) -> Option<Name> {
        let span = self.current.span;
        let text = self.text(span);
        let known = Elementary::ALL.iter().any(|known| known.name().eq_ignore_ascii_case(text));
        if self.current.kind != TokenKind::Identifier || !known {
            return None;
        }
        let found = format!("the type `{text}` behind the values of an enumeration");
        let list = self.text(values.to(self.previous));
        let mut one =
            Diagnostic::new(Code::Syntax, span, found).allowed("the type before the values");
        if list.len() < 60 {
            one = one.hint(format!("write `{text} {list}`"));
        }
        self.tell(one);
        self.advance();
        Some(Name::new(text, span))
    }

    fn enumeration_values(&mut self) -> Parse<Vec<EnumerationValue>> {
        self.expect_sign(Sign::OpenParenthesis)?;
        let mut values = Vec::new();
        loop {
            let name = self.name("the name of a value")?;
            let value = match self.eat_sign(Sign::Assign) {
                Some(_) => Some(self.expression()?),
                None => None,
            };
            values.push(EnumerationValue { name, value });
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::CloseParenthesis)?;
        Ok(values)
    }
}
