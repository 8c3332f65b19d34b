//! Which loops have a visible bound.
//!
//! A WHILE or REPEAT that never ends stops the task with a trap of the loop budget. Whether one ends
//! cannot be known in general; what is looked for is a variable of the condition that the body moves
//! by a step, in the direction in which the condition ends the loop, or an EXIT or RETURN that the body can reach.

use std::collections::HashSet;

use super::Entry;
use super::body::Body;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{
    BinaryOperator, Expression, ExpressionKind, ForLoop, LiteralValue, Statement, StatementKind,
    UnaryOperator,
};

/// A kind of loop with a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Looped {
    While,
    Repeat,
}

/// The way that a variable goes, or has to go so that its loop ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Up,
    Down,
    /// Not known, or either.
    Any,
}

impl Way {
    fn turned(self) -> Self {
        match self {
            Self::Up => Self::Down,
            Self::Down => Self::Up,
            Self::Any => Self::Any,
        }
    }

    fn fits(self, other: Self) -> bool {
        self == other || self == Self::Any || other == Self::Any
    }
}

/// What stands around a statement within a loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Around {
    /// No condition: it is reached in each round.
    Nothing,
    /// Conditions of which none can change while the loop runs.
    Fixed,
    /// A condition that can change.
    Moving,
}

impl Body<'_, '_> {
    pub(super) fn warn_of_loop(
        &mut self,
        kind: Looped,
        condition: &Expression,
        body: &[Statement],
        span: Span,
    ) {
        let mut ends = Vec::new();
        // WHILE ends when its condition is FALSE, REPEAT when it is TRUE.
        towards(condition, kind == Looped::Repeat, &mut ends);
        let mut changes = Changes::default();
        self.changes(body, &mut changes);
        let looked = Look { ends: &ends, changes: &changes };
        if looked.steps(body) || looked.leaves(body, true, Around::Nothing) {
            return;
        }
        let keyword = if kind == Looped::Repeat { "REPEAT" } else { "WHILE" };
        let head = Span { end: span.start + keyword.len() as u32, ..span };
        self.tell(
            Diagnostic::new(
                Code::UnboundedLoop,
                head,
                format!("no bound of this {keyword} can be seen"),
            )
            .allowed("a body that moves a variable of the condition by a step towards its end, or has an EXIT")
            .hint("use FOR where the number of rounds is known; a loop over its budget is a trap"),
        );
    }

    /// Which variables statements may change.
    fn changes<'e>(&self, statements: &'e [Statement], into: &mut Changes<'e>) {
        for statement in statements {
            let mut blocks: Vec<&'e [Statement]> = Vec::new();
            let mut values: Vec<&'e Expression> = Vec::new();
            match &statement.kind {
                StatementKind::Assign { target, value, .. } => {
                    into.assign(target);
                    values.extend([target, value]);
                }
                // What is called may assign its arguments and global variables.
                StatementKind::Call(_) => into.all = true,
                StatementKind::If { branches, otherwise } => {
                    values.extend(branches.iter().map(|(condition, _)| condition));
                    blocks.extend(branches.iter().map(|(_, body)| &**body));
                    blocks.extend(otherwise.as_deref());
                }
                StatementKind::Case { selector, branches, otherwise } => {
                    values.push(selector);
                    blocks.extend(branches.iter().map(|(_, body)| &**body));
                    blocks.extend(otherwise.as_deref());
                }
                StatementKind::For(parts) => {
                    let ForLoop { variable, from, to, by, body } = &**parts;
                    into.names.insert(&variable.key);
                    values.extend([from, to]);
                    values.extend(by);
                    blocks.push(body);
                }
                StatementKind::While(condition, body) | StatementKind::Repeat(body, condition) => {
                    values.push(condition);
                    blocks.push(body);
                }
                StatementKind::Error => into.all = true,
                StatementKind::Exit | StatementKind::Continue | StatementKind::Return => {}
            }
            into.all |= values.iter().any(|value| self.calls_declared(value));
            for block in blocks {
                self.changes(block, into);
            }
        }
    }

    /// Whether an expression calls something that is declared, which may have effects. Functions of the standard have none.
    fn calls_declared(&self, expression: &Expression) -> bool {
        let mut found = false;
        each(expression, &mut |part| {
            if let ExpressionKind::Call(callee, _) = &part.kind {
                found |= match &callee.kind {
                    ExpressionKind::Name(name) => {
                        matches!(self.checker.names.get(&name.key), Some(Entry::Units(_)))
                    }
                    _ => true,
                };
            }
        });
        found
    }
}

/// What the body of a loop may change.
#[derive(Debug, Default)]
struct Changes<'e> {
    names: HashSet<&'e str>,
    /// Anything.
    all: bool,
}

impl<'e> Changes<'e> {
    fn assign(&mut self, target: &'e Expression) {
        match &target.kind {
            ExpressionKind::Name(name) => {
                self.names.insert(&name.key);
            }
            ExpressionKind::Field(base, _)
            | ExpressionKind::Part(base, ..)
            | ExpressionKind::Index(base, _)
            | ExpressionKind::Parenthesised(base) => self.assign(base),
            // Through a reference or an address it may be any variable.
            _ => self.all = true,
        }
    }

    /// Whether the value of an expression may change.
    fn concern(&self, expression: &Expression) -> bool {
        let mut found = self.all;
        each(expression, &mut |part| match &part.kind {
            ExpressionKind::Name(name) => found |= self.names.contains(&*name.key),
            ExpressionKind::Dereference(_) => found = true,
            _ => {}
        });
        found
    }
}

/// Calls `visit` with an expression and all its parts, but for the names of what is called.
fn each<'e>(expression: &'e Expression, visit: &mut impl FnMut(&'e Expression)) {
    visit(expression);
    match &expression.kind {
        ExpressionKind::Field(part, _)
        | ExpressionKind::Part(part, ..)
        | ExpressionKind::Dereference(part)
        | ExpressionKind::Unary(_, part)
        | ExpressionKind::Parenthesised(part) => each(part, visit),
        ExpressionKind::Binary(_, _, left, right) => {
            each(left, visit);
            each(right, visit);
        }
        ExpressionKind::Index(base, indices) => {
            each(base, visit);
            indices.iter().for_each(|index| each(index, visit));
        }
        ExpressionKind::Call(_, arguments) => {
            let values = arguments.iter().filter_map(|argument| argument.value.as_ref());
            values.for_each(|value| each(value, visit));
        }
        ExpressionKind::Name(_)
        | ExpressionKind::Literal(_)
        | ExpressionKind::EnumerationValue(..)
        | ExpressionKind::Address(_)
        | ExpressionKind::Error => {}
    }
}

/// The variables of a condition, each with the way that it has to go until the condition is `wanted`.
fn towards<'e>(condition: &'e Expression, wanted: bool, ends: &mut Vec<(&'e str, Way)>) {
    use BinaryOperator as Op;
    match &condition.kind {
        ExpressionKind::Parenthesised(inner) => towards(inner, wanted, ends),
        ExpressionKind::Unary(UnaryOperator::Not, inner) => towards(inner, !wanted, ends),
        ExpressionKind::Binary(Op::And | Op::AndThen | Op::Or | Op::OrElse, _, left, right) => {
            towards(left, wanted, ends);
            towards(right, wanted, ends);
        }
        ExpressionKind::Binary(operator, _, left, right) => {
            let way = match operator {
                Op::Less | Op::LessEqual => Way::Down,
                Op::Greater | Op::GreaterEqual => Way::Up,
                _ => Way::Any,
            };
            let way = if wanted { way } else { way.turned() };
            side(left, way, ends);
            side(right, way.turned(), ends);
        }
        _ => side(condition, Way::Any, ends),
    }
}

/// A side of a comparison. How a computed one follows its variables is not looked at.
fn side<'e>(side: &'e Expression, way: Way, ends: &mut Vec<(&'e str, Way)>) {
    match &side.kind {
        ExpressionKind::Name(name) => ends.push((&name.key, way)),
        _ => each(side, &mut |part| {
            if let ExpressionKind::Name(name) = &part.kind {
                ends.push((&name.key, Way::Any));
            }
        }),
    }
}

/// The way of a variable that is assigned this; none if it is no step of it.
fn step(target: &str, value: &Expression) -> Option<Way> {
    let ExpressionKind::Binary(operator, _, left, right) = &value.kind else { return None };
    let is_target = |side: &Expression| matches!(&side.kind, ExpressionKind::Name(name) if &*name.key == target);
    let mut moved = false;
    each(value, &mut |part| moved |= is_target(part));
    let positive = |side: &Expression| match &side.kind {
        ExpressionKind::Literal(literal) => match literal.value {
            LiteralValue::Integer(number) => number > 0,
            _ => false,
        },
        _ => false,
    };
    let way = match operator {
        BinaryOperator::Add if is_target(left) && positive(right) => Way::Up,
        BinaryOperator::Add if is_target(right) && positive(left) => Way::Up,
        BinaryOperator::Subtract if is_target(left) && positive(right) => Way::Down,
        BinaryOperator::Add
        | BinaryOperator::Subtract
        | BinaryOperator::Multiply
        | BinaryOperator::Divide => Way::Any,
        _ => return None,
    };
    moved.then_some(way)
}

/// What is looked for in the body of a loop.
struct Look<'l, 'e> {
    ends: &'l [(&'e str, Way)],
    changes: &'l Changes<'e>,
}

impl Look<'_, '_> {
    /// Whether one of the statements moves a variable by a step towards the end of the loop.
    fn steps(&self, statements: &[Statement]) -> bool {
        statements.iter().any(|statement| match &statement.kind {
            StatementKind::Assign { target, value, .. } => {
                let ExpressionKind::Name(target) = &target.kind else { return false };
                step(&target.key, value).is_some_and(|way| {
                    self.ends.iter().any(|(name, end)| *name == &*target.key && end.fits(way))
                })
            }
            StatementKind::If { branches, otherwise } => {
                branches.iter().any(|(_, body)| self.steps(body))
                    || otherwise.as_ref().is_some_and(|body| self.steps(body))
            }
            StatementKind::Case { branches, otherwise, .. } => {
                branches.iter().any(|(_, body)| self.steps(body))
                    || otherwise.as_ref().is_some_and(|body| self.steps(body))
            }
            StatementKind::For(parts) => self.steps(&parts.body),
            StatementKind::While(_, body) | StatementKind::Repeat(body, _) => self.steps(body),
            _ => false,
        })
    }

    /// Whether one of the statements can leave the loop: in each round, or by a condition that can change.
    fn leaves(&self, statements: &[Statement], inner: bool, around: Around) -> bool {
        let below = |moves: bool| match around {
            Around::Moving => Around::Moving,
            _ if moves => Around::Moving,
            _ => Around::Fixed,
        };
        statements.iter().any(|statement| match &statement.kind {
            StatementKind::Exit => inner && around != Around::Fixed,
            StatementKind::Return => around != Around::Fixed,
            StatementKind::If { branches, otherwise } => {
                // A branch is reached by its condition and all before it.
                let mut moves = false;
                let reached = branches.iter().any(|(condition, body)| {
                    moves |= self.changes.concern(condition);
                    self.leaves(body, inner, below(moves))
                });
                let otherwise = otherwise.as_ref();
                reached || otherwise.is_some_and(|body| self.leaves(body, inner, below(moves)))
            }
            StatementKind::Case { selector, branches, otherwise } => {
                let all = below(self.changes.concern(selector));
                branches.iter().any(|(_, body)| self.leaves(body, inner, all))
                    || otherwise.as_ref().is_some_and(|body| self.leaves(body, inner, all))
            }
            StatementKind::For(parts) => self.leaves(&parts.body, false, around),
            StatementKind::While(_, body) | StatementKind::Repeat(body, _) => {
                self.leaves(body, false, around)
            }
            _ => false,
        })
    }
}
