//! Statements.

use super::{Parse, Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{Expression, ExpressionKind, ForLoop, Label, Statement, StatementKind};
use crate::syntax::token::{Keyword, Sign, TokenKind};

impl Parser<'_> {
    /// Statements up to a word that begins none: a closing keyword, ELSE, a label of CASE.
    pub(super) fn statements(&mut self) -> Vec<Statement> {
        let mut list = Vec::new();
        loop {
            while self.eat_sign(Sign::Semicolon).is_some() {}
            let start = self.current.span;
            if !self.at_statement() {
                return list;
            }
            match self.deeper(Self::statement) {
                Ok(Some(kind)) => {
                    list.push(Statement { kind, span: start.to(self.previous) });
                }
                Ok(None) => return list,
                Err(Told) => {
                    self.resume_behind_statement(start);
                    let span = start.to(self.previous);
                    list.push(Statement { kind: StatementKind::Error, span });
                }
            }
        }
    }

    /// Whether a statement, a label or something that is neither can be read here.
    fn at_statement(&self) -> bool {
        match self.current.kind {
            TokenKind::End => false,
            TokenKind::Keyword(keyword) => !ends_statements(keyword),
            _ => true,
        }
    }

    /// Skips what is left of a statement that could not be read.
    fn resume_behind_statement(&mut self, start: Span) {
        // At least one word: else it would be tried again.
        if self.current.span == start {
            self.advance();
        }
        self.skip_to(|kind| match kind {
            TokenKind::Sign(Sign::Semicolon) => true,
            TokenKind::Keyword(keyword) => begins_statement(keyword) || ends_statements(keyword),
            _ => false,
        });
    }

    /// One statement with its semicolon. None at a label of CASE.
    fn statement(&mut self) -> Parse<Option<StatementKind>> {
        let TokenKind::Keyword(keyword) = self.current.kind else {
            return self.simple_statement();
        };
        let open = self.current.span;
        let kind = match keyword {
            Keyword::If => self.if_statement(open)?,
            Keyword::Case => self.case_statement(open)?,
            Keyword::For => self.for_statement(open)?,
            Keyword::While => {
                self.advance();
                let condition = self.condition(Keyword::Do)?;
                let body = self.outside_of_case(Self::statements);
                self.close(Keyword::EndWhile, open)?;
                StatementKind::While(condition, body)
            }
            Keyword::Repeat => {
                self.advance();
                let body = self.outside_of_case(Self::statements);
                self.close(Keyword::Until, open)?;
                let condition = self.expression()?;
                self.eat_sign(Sign::Semicolon);
                self.close(Keyword::EndRepeat, open)?;
                StatementKind::Repeat(body, condition)
            }
            Keyword::Exit => return self.alone(StatementKind::Exit),
            Keyword::Continue => return self.alone(StatementKind::Continue),
            Keyword::Return => return self.alone(StatementKind::Return),
            Keyword::Super | Keyword::This => {
                return Err(self.refuse("THIS or SUPER"));
            }
            _ => return self.simple_statement(),
        };
        // As elsewhere, the semicolon behind a closing keyword may be left out.
        self.eat_sign(Sign::Semicolon);
        Ok(Some(kind))
    }

    fn alone(&mut self, kind: StatementKind) -> Parse<Option<StatementKind>> {
        self.advance();
        self.end_of_statement()?;
        Ok(Some(kind))
    }

    /// The semicolon. Where it is missing before the next statement, that one is read all the same.
    fn end_of_statement(&mut self) -> Parse<()> {
        if self.eat_sign(Sign::Semicolon).is_some() {
            return Ok(());
        }
        let told = self.missing(";");
        match self.current.kind {
            TokenKind::Identifier => Ok(()),
            TokenKind::Keyword(keyword)
                if begins_statement(keyword) || ends_statements(keyword) =>
            {
                Ok(())
            }
            _ => Err(told),
        }
    }

    /// An assignment or a call. A label of CASE is left to the parser of CASE.
    fn simple_statement(&mut self) -> Parse<Option<StatementKind>> {
        if self.case && self.at_label() {
            return Ok(None);
        }
        if self.foreign_section() {
            return Ok(None);
        }
        if self.mistaken_keyword() {
            return if self.at_statement() { self.statement() } else { Ok(None) };
        }
        let left = self.expression()?;
        let kind = match self.current.kind {
            TokenKind::Sign(sign @ (Sign::Assign | Sign::AttemptAssign)) => {
                self.advance();
                let value = self.expression()?;
                self.decimal_comma();
                StatementKind::Assign { target: left, value, attempt: sign == Sign::AttemptAssign }
            }
            _ if matches!(left.kind, ExpressionKind::Call(..)) => StatementKind::Call(left),
            _ => return Err(self.no_statement(&left)),
        };
        self.end_of_statement()?;
        Ok(Some(kind))
    }

    fn no_statement(&mut self, left: &Expression) -> Told {
        let mut one = Diagnostic::new(
            Code::Syntax,
            left.span,
            format!("an expression that is no statement, before {}", self.shown()),
        )
        .allowed("`variable := value;` or a call with parentheses");
        let comparison = matches!(
            left.kind,
            ExpressionKind::Binary(crate::syntax::ast::BinaryOperator::Equal, ..)
        );
        if self.at_sign(Sign::Colon) && self.peek(1) == TokenKind::Sign(Sign::Equal) {
            one = one.hint("`:=` is written without a blank");
        } else if comparison {
            one = one.hint("`=` compares; an assignment is written `:=`");
        } else if matches!(left.kind, ExpressionKind::Name(_) | ExpressionKind::Field(..)) {
            one = one.hint("a function block without arguments is called with `()`");
        }
        self.tell(one)
    }

    /// Whether an identifier is a keyword without its underscore, such as `ENDIF`. It is told of and
    /// read as what is meant.
    fn mistaken_keyword(&mut self) -> bool {
        if self.current.kind != TokenKind::Identifier {
            return false;
        }
        let text = self.text(self.current.span);
        let upper = text.to_ascii_uppercase();
        let meant = match upper.as_str() {
            "ENDIF" => Keyword::EndIf,
            "ENDCASE" => Keyword::EndCase,
            "ENDFOR" => Keyword::EndFor,
            "ENDWHILE" => Keyword::EndWhile,
            "ENDREPEAT" => Keyword::EndRepeat,
            "ELSEIF" | "ELSE_IF" => Keyword::Elsif,
            "BREAK" => Keyword::Exit,
            _ => return false,
        };
        let used_as_name = matches!(
            self.peek(1),
            TokenKind::Sign(
                Sign::Assign
                    | Sign::AttemptAssign
                    | Sign::OpenBracket
                    | Sign::Dot
                    | Sign::Caret
                    | Sign::Equal
            )
        ) || meant != Keyword::Elsif
            && self.peek(1) == TokenKind::Sign(Sign::OpenParenthesis);
        if used_as_name {
            return false;
        }
        let found = format!("`{text}` is no keyword");
        let one = Diagnostic::new(Code::Syntax, self.current.span, found)
            .hint(format!("write `{}`", meant.text()));
        self.diagnostics.push(one);
        self.current.kind = TokenKind::Keyword(meant);
        true
    }

    fn condition(&mut self, behind: Keyword) -> Parse<Expression> {
        let condition = self.expression()?;
        if self.eat_keyword(behind).is_some() {
            return Ok(condition);
        }
        if self.at_sign(Sign::Assign) {
            let span = self.current.span;
            let one = Diagnostic::new(Code::Syntax, span, "`:=` in a condition")
                .allowed(format!("a value of type BOOL, then `{}`", behind.text()))
                .hint("`=` compares; `:=` assigns and is a statement of its own");
            self.tell(one);
            self.advance();
            self.expression()?;
            self.expect_keyword(behind)?;
            return Ok(condition);
        }
        // The body is there in most cases: it is read, so that its mistakes are told too.
        self.missing(behind.text());
        if self.at_sign(Sign::Semicolon) {
            self.advance();
        }
        Ok(condition)
    }

    fn if_statement(&mut self, open: Span) -> Parse<StatementKind> {
        let mut branches = Vec::new();
        let mut otherwise = None;
        self.advance();
        loop {
            let condition = self.condition(Keyword::Then)?;
            branches.push((condition, self.outside_of_case(Self::statements)));
            if self.eat_keyword(Keyword::Elsif).is_none() {
                break;
            }
        }
        if self.eat_keyword(Keyword::Else).is_some() {
            if self.at_keyword(Keyword::If) {
                // `ELSE IF` is an IF within ELSE, with an END_IF of its own.
                self.else_if = Some(self.previous.to(self.current.span));
            }
            otherwise = Some(self.outside_of_case(Self::statements));
        }
        self.close(Keyword::EndIf, open)?;
        Ok(StatementKind::If { branches, otherwise })
    }

    fn for_statement(&mut self, open: Span) -> Parse<StatementKind> {
        self.advance();
        let variable = self.name("the control variable")?;
        if self.eat_sign(Sign::Assign).is_none() {
            let missing = self.missing(Sign::Assign.text());
            // What is meant by `=` is clear, and END_FOR shall find what it closes.
            self.eat_sign(Sign::Equal).ok_or(missing)?;
        }
        let from = self.expression()?;
        self.expect_keyword(Keyword::To)?;
        let to = self.expression()?;
        let by = match self.eat_keyword(Keyword::By) {
            Some(_) => Some(self.expression()?),
            None => None,
        };
        if self.eat_keyword(Keyword::Do).is_none() {
            self.missing(Keyword::Do.text());
        }
        let body = self.outside_of_case(Self::statements);
        self.close(Keyword::EndFor, open)?;
        Ok(StatementKind::For(Box::new(ForLoop { variable, from, to, by, body })))
    }

    fn case_statement(&mut self, open: Span) -> Parse<StatementKind> {
        self.advance();
        let selector = self.expression()?;
        self.expect_keyword(Keyword::Of)?;
        let mut branches = Vec::new();
        let mut otherwise = None;
        let outer = std::mem::replace(&mut self.case, true);
        while self.at_statement() {
            match self.labels() {
                Ok(labels) => branches.push((labels, self.statements())),
                Err(Told) => {
                    let start = self.current.span;
                    self.resume_behind_statement(start);
                    // What follows belongs to a branch that could not be read.
                    self.statements();
                }
            }
        }
        self.case = outer;
        if self.eat_keyword(Keyword::Else).is_some() {
            self.eat_sign(Sign::Colon);
            otherwise = Some(self.outside_of_case(Self::statements));
        }
        self.close(Keyword::EndCase, open)?;
        Ok(StatementKind::Case { selector, branches, otherwise })
    }

    fn labels(&mut self) -> Parse<Vec<Label>> {
        let mut labels = Vec::new();
        loop {
            let low = self.expression()?;
            labels.push(match self.eat_sign(Sign::Range) {
                Some(_) => Label::Range(low, self.expression()?),
                None => Label::One(low),
            });
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::Colon)?;
        Ok(labels)
    }

    /// Whether the current word begins a label: it ends at `:`, `,` or `..` and not at `:=`.
    fn at_label(&self) -> bool {
        let behind = match self.current.kind {
            TokenKind::Identifier => 1,
            TokenKind::TypePrefix => match self.peek(1) {
                TokenKind::Sign(Sign::Minus | Sign::Plus) => 3,
                _ => 2,
            },
            TokenKind::Sign(Sign::Minus | Sign::Plus) => return true,
            TokenKind::Integer
            | TokenKind::BasedInteger
            | TokenKind::String
            | TokenKind::WideString
            | TokenKind::Keyword(Keyword::True | Keyword::False) => return true,
            _ => return false,
        };
        matches!(self.peek(behind), TokenKind::Sign(Sign::Colon | Sign::Comma | Sign::Range))
    }

    /// Runs `inner` where names with a colon are no labels.
    fn outside_of_case<T>(&mut self, inner: impl FnOnce(&mut Self) -> T) -> T {
        let outer = std::mem::replace(&mut self.case, false);
        let result = inner(self);
        self.case = outer;
        result
    }
}

fn begins_statement(keyword: Keyword) -> bool {
    matches!(
        keyword,
        Keyword::If
            | Keyword::Case
            | Keyword::For
            | Keyword::While
            | Keyword::Repeat
            | Keyword::Exit
            | Keyword::Continue
            | Keyword::Return
    )
}

/// Whether a list of statements ends before it.
fn ends_statements(keyword: Keyword) -> bool {
    use Keyword::*;
    matches!(
        keyword,
        Else | Elsif
            | Until
            | Action
            | InitialStep
            | Step
            | Transition
            | EndAction
            | EndCase
            | EndClass
            | EndConfiguration
            | EndFor
            | EndFunction
            | EndFunctionBlock
            | EndIf
            | EndInterface
            | EndMethod
            | EndNamespace
            | EndProgram
            | EndProperty
            | EndRepeat
            | EndResource
            | EndStep
            | EndStruct
            | EndTest
            | EndTransition
            | EndType
            | EndVar
            | EndWhile
            | Class
            | Configuration
            | Function
            | FunctionBlock
            | Interface
            | Method
            | Namespace
            | Program
            | Property
            | Test
            | Type
            | Var
            | VarAccess
            | VarConfig
            | VarExternal
            | VarGlobal
            | VarInOut
            | VarInput
            | VarOutput
            | VarTemp
    )
}
