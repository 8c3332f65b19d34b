//! Which loops have a visible bound.
//!
//! A WHILE or REPEAT that never ends stops the task with a trap of the loop budget. Whether one ends
//! cannot be known in general; what is looked for is a variable of the condition that the body moves
//! by a step, or an EXIT or RETURN.

use super::body::Body;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Expression, ExpressionKind, Statement, StatementKind};

impl Body<'_, '_> {
    pub(super) fn warn_of_loop(&mut self, condition: &Expression, body: &[Statement], span: Span) {
        let mut names = Vec::new();
        collect(condition, &mut names);
        if steps(body, &names, true) {
            return;
        }
        let text = self.checker.sources.text(span);
        let keyword = text.get(..6).unwrap_or(text).trim_end();
        let keyword = if keyword.eq_ignore_ascii_case("REPEAT") { "REPEAT" } else { "WHILE" };
        let head = Span { end: span.start + keyword.len() as u32, ..span };
        self.tell(
            Diagnostic::new(
                Code::UnboundedLoop,
                head,
                format!("no bound of this {keyword} can be seen"),
            )
            .allowed("a body that moves a variable of the condition by a step, or has an EXIT")
            .hint("use FOR where the number of rounds is known; a loop over its budget is a trap"),
        );
    }
}

/// The names in an expression.
fn collect<'e>(expression: &'e Expression, names: &mut Vec<&'e str>) {
    match &expression.kind {
        ExpressionKind::Name(name) => names.push(&name.key),
        ExpressionKind::Field(part, _)
        | ExpressionKind::Part(part, ..)
        | ExpressionKind::Dereference(part)
        | ExpressionKind::Unary(_, part)
        | ExpressionKind::Parenthesised(part) => collect(part, names),
        ExpressionKind::Binary(_, _, left, right) => {
            collect(left, names);
            collect(right, names);
        }
        ExpressionKind::Index(base, indices) => {
            collect(base, names);
            indices.iter().for_each(|index| collect(index, names));
        }
        ExpressionKind::Call(_, arguments) => arguments
            .iter()
            .filter_map(|argument| argument.value.as_ref())
            .for_each(|value| collect(value, names)),
        ExpressionKind::Literal(_)
        | ExpressionKind::EnumerationValue(..)
        | ExpressionKind::Address(_)
        | ExpressionKind::Error => {}
    }
}

/// Whether one of the statements moves a variable by a step or leaves the loop.
fn steps(statements: &[Statement], names: &[&str], inner: bool) -> bool {
    statements.iter().any(|statement| match &statement.kind {
        StatementKind::Exit => inner,
        StatementKind::Return => true,
        StatementKind::Assign { target, value, .. } => {
            let ExpressionKind::Name(target) = &target.kind else { return false };
            let by_step = match &value.kind {
                ExpressionKind::Binary(operator, _, left, right) => {
                    let mut moved = Vec::new();
                    collect(left, &mut moved);
                    collect(right, &mut moved);
                    let steps = matches!(
                        operator,
                        BinaryOperator::Add
                            | BinaryOperator::Subtract
                            | BinaryOperator::Multiply
                            | BinaryOperator::Divide
                    );
                    steps && moved.contains(&&*target.key)
                }
                _ => false,
            };
            by_step && names.contains(&&*target.key)
        }
        StatementKind::If { branches, otherwise } => {
            branches.iter().any(|(_, body)| steps(body, names, inner))
                || otherwise.as_ref().is_some_and(|body| steps(body, names, inner))
        }
        StatementKind::Case { branches, otherwise, .. } => {
            branches.iter().any(|(_, body)| steps(body, names, inner))
                || otherwise.as_ref().is_some_and(|body| steps(body, names, inner))
        }
        StatementKind::For { body, .. }
        | StatementKind::While(_, body)
        | StatementKind::Repeat(body, _) => steps(body, names, false),
        StatementKind::Call(_) | StatementKind::Continue | StatementKind::Error => false,
    })
}
