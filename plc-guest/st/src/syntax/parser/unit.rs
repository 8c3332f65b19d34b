//! What a file declares at its top: units, types, global variables, configurations.

use super::{Parse, Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::ast::{Declaration, File, Name, SectionKind, Unit, UnitKind};
use crate::syntax::token::{Keyword, Sign, TokenKind};

const TOP: &str = "PROGRAM, FUNCTION, FUNCTION_BLOCK, TYPE, VAR_GLOBAL, CONFIGURATION or TEST";

impl Parser<'_> {
    pub(super) fn file(&mut self) -> File {
        let mut file = File::default();
        while self.current.kind != TokenKind::End {
            let start = self.current.span;
            if self.declaration(&mut file.declarations).is_err() {
                if self.current.span == start {
                    self.advance();
                }
                self.skip_to(begins_declaration);
            }
        }
        file
    }

    fn declaration(&mut self, into: &mut Vec<Declaration>) -> Parse<()> {
        let TokenKind::Keyword(keyword) = self.current.kind else {
            return Err(self.unexpected(TOP));
        };
        match keyword {
            Keyword::Program => into.push(Declaration::Unit(self.unit(UnitKind::Program)?)),
            Keyword::Function => into.push(Declaration::Unit(self.unit(UnitKind::Function)?)),
            Keyword::FunctionBlock => {
                into.push(Declaration::Unit(self.unit(UnitKind::FunctionBlock)?));
            }
            Keyword::Test => into.push(Declaration::Unit(self.unit(UnitKind::Test)?)),
            Keyword::Type => self.type_block(into)?,
            Keyword::VarGlobal => {
                if let Some(section) = self.section()? {
                    into.push(Declaration::Globals(section));
                }
            }
            Keyword::Configuration => {
                into.push(Declaration::Configuration(self.configuration()?));
            }
            Keyword::Namespace => {
                // What is within it is read: only the grouping is refused.
                self.refuse("NAMESPACE");
                self.advance();
                self.skip_to(begins_declaration);
            }
            Keyword::Using => {
                self.refuse("USING (namespaces)");
                self.advance();
                self.skip_to(|kind| kind == TokenKind::Sign(Sign::Semicolon));
                self.eat_sign(Sign::Semicolon);
            }
            Keyword::EndNamespace => {
                self.advance();
            }
            _ => {
                if !self.refuse_block() {
                    return Err(self.unexpected(TOP));
                }
            }
        }
        Ok(())
    }

    fn unit(&mut self, kind: UnitKind) -> Parse<Unit> {
        let (end, what) = match kind {
            UnitKind::Program => (Keyword::EndProgram, "the name of the program"),
            UnitKind::Function => (Keyword::EndFunction, "the name of the function"),
            UnitKind::FunctionBlock => {
                (Keyword::EndFunctionBlock, "the name of the function block")
            }
            UnitKind::Test => (Keyword::EndTest, "the name of the test"),
        };
        let open = self.advance();
        self.refuse_modifiers();
        let name = match kind {
            UnitKind::Test => self.test_name()?,
            _ => self.name(what)?,
        };
        self.refuse_modifiers();
        let mut result = None;
        if self.at_sign(Sign::Colon) {
            if kind == UnitKind::Function {
                self.advance();
                // An error in it does not spoil the rest.
                result = self.type_spec().ok();
            } else {
                let found = "a type of the result, which only a FUNCTION has";
                self.tell(Diagnostic::new(Code::Syntax, self.current.span, found));
                self.advance();
                let _ = self.type_spec();
            }
        }
        self.eat_sign(Sign::Semicolon);
        let (mut sections, mut body) = (Vec::new(), Vec::new());
        loop {
            body.append(&mut self.statements());
            let TokenKind::Keyword(keyword) = self.current.kind else { break };
            if keyword == end {
                break;
            }
            if begins_section(keyword) {
                if !body.is_empty() {
                    let found = "variables behind the first statement";
                    let one = Diagnostic::new(Code::Syntax, self.current.span, found)
                        .allowed("all VAR sections before the first statement");
                    self.tell(one);
                }
                match self.section() {
                    Ok(section) => sections.extend(section),
                    Err(Told) => self.resume_behind_section(),
                }
            } else if keyword == Keyword::EndVar {
                self.stray(keyword);
            } else if !self.refuse_block() {
                if begins_declaration(self.current.kind) || is_other_end(keyword) {
                    break;
                }
                // A closing keyword of something that is not open.
                self.stray(keyword);
                self.eat_sign(Sign::Semicolon);
            }
        }
        let end = match self.close(end, open) {
            Ok(span) => span,
            // The unit is there all the same: others may use it.
            Err(Told) => {
                if let TokenKind::Keyword(keyword) = self.current.kind
                    && is_other_end(keyword)
                {
                    self.advance();
                }
                self.previous
            }
        };
        self.eat_sign(Sign::Semicolon);
        Ok(Unit { kind, name, result, sections, body, span: open.to(end), end })
    }

    /// The name of a test, which is a string.
    fn test_name(&mut self) -> Parse<Name> {
        let span = self.current.span;
        match self.current.kind {
            TokenKind::String | TokenKind::WideString => {
                self.advance();
                let text = self.text(span);
                Ok(Name::new(text.get(1..text.len() - 1).unwrap_or("").trim(), span))
            }
            _ => Err(self.unexpected("the name of the test, as a string: `TEST 'fills in time'`")),
        }
    }

    fn stray(&mut self, keyword: Keyword) {
        let found = format!("`{}` without what it closes", keyword.text());
        let hint = "look for what was closed twice, or is not opened, above";
        self.tell(Diagnostic::new(Code::Syntax, self.current.span, found).hint(hint));
        self.advance();
    }

    /// Goes to where the statements or sections behind a broken section begin.
    fn resume_behind_section(&mut self) {
        self.skip_to(|kind| match kind {
            TokenKind::Keyword(keyword) => {
                keyword == Keyword::EndVar
                    || begins_section(keyword)
                    || is_other_end(keyword)
                    || begins_declaration(kind)
            }
            _ => false,
        });
        self.eat_keyword(Keyword::EndVar);
    }
}

/// Whether a declaration at the top of a file begins with it.
pub(super) fn begins_declaration(kind: TokenKind) -> bool {
    use Keyword::*;
    matches!(
        kind,
        TokenKind::Keyword(
            Program
                | Function
                | FunctionBlock
                | Type
                | VarGlobal
                | Configuration
                | Test
                | Class
                | Interface
                | Namespace
                | EndNamespace
                | Using
        )
    )
}

/// Whether a unit or configuration ends with it.
fn is_other_end(keyword: Keyword) -> bool {
    matches!(
        keyword,
        Keyword::EndProgram
            | Keyword::EndFunction
            | Keyword::EndFunctionBlock
            | Keyword::EndConfiguration
            | Keyword::EndResource
            | Keyword::EndTest
            | Keyword::EndType
            | Keyword::EndNamespace
    )
}

/// The kind of a section, by its keyword.
pub(super) fn section_kind(keyword: Keyword) -> Option<SectionKind> {
    Some(match keyword {
        Keyword::Var => SectionKind::Local,
        Keyword::VarInput => SectionKind::Input,
        Keyword::VarOutput => SectionKind::Output,
        Keyword::VarInOut => SectionKind::InOut,
        Keyword::VarTemp => SectionKind::Temporary,
        Keyword::VarExternal => SectionKind::External,
        Keyword::VarGlobal => SectionKind::Global,
        _ => return None,
    })
}

fn begins_section(keyword: Keyword) -> bool {
    section_kind(keyword).is_some()
}
