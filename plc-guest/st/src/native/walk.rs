//! Walks over the tree.

use crate::hir::{
    Argument, Block, Expr, ExprKind, Intrinsic, Place, Root, Statement, StatementKind, Step,
};

/// Calls `visit` for each statement, outer ones first.
pub fn statements(block: &Block, visit: &mut dyn FnMut(&Statement)) {
    for statement in block {
        visit(statement);
        match &statement.kind {
            StatementKind::If(arms, otherwise) => {
                arms.iter().for_each(|(_, block)| statements(block, visit));
                statements(otherwise, visit);
            }
            StatementKind::Case(_, arms, otherwise) => {
                arms.iter().for_each(|arm| statements(&arm.body, visit));
                statements(otherwise, visit);
            }
            StatementKind::For(parts) => statements(&parts.body, visit),
            StatementKind::While(_, body) | StatementKind::Repeat(body, _) => {
                statements(body, visit);
            }
            _ => {}
        }
    }
}

/// Calls `visit` for each expression, outer ones first.
pub fn expressions(block: &Block, visit: &mut dyn FnMut(&Expr)) {
    places_and_expressions(block, &mut |expr| visit(expr), &mut |_, _| {});
}

/// Calls `place` for each place, and says whether its address leaves the routine.
pub fn places(block: &Block, place: &mut dyn FnMut(&Place, bool)) {
    places_and_expressions(block, &mut |_| {}, place);
}

/// Whether an expression calls what may change variables: a routine, or the kernel for a message.
fn is_call(expr: &Expr) -> bool {
    matches!(expr.kind, ExprKind::Call(..) | ExprKind::Intrinsic(Intrinsic::ChannelRead(_), _))
}

/// Whether an expression calls a routine.
pub fn calls(expr: &Expr) -> bool {
    let mut found = false;
    Walk { expr: &mut |expr| found |= is_call(expr), place: &mut |_, _| {} }.expr(expr);
    found
}

/// Whether the path of a place calls a routine.
pub fn path_calls(place: &Place) -> bool {
    let mut found = false;
    Walk { expr: &mut |expr| found |= is_call(expr), place: &mut |_, _| {} }.place(place, false);
    found
}

fn places_and_expressions(
    block: &Block,
    expr: &mut dyn FnMut(&Expr),
    place: &mut dyn FnMut(&Place, bool),
) {
    let mut walk = Walk { expr, place };
    statements(block, &mut |statement| match &statement.kind {
        StatementKind::Assign(place, value) => {
            walk.expr(value);
            walk.place(place, false);
        }
        StatementKind::Call(_, arguments) => walk.arguments(arguments),
        StatementKind::Invoke(place, _, arguments) => {
            walk.place(place, true);
            walk.arguments(arguments);
        }
        StatementKind::If(arms, _) => arms.iter().for_each(|(condition, _)| walk.expr(condition)),
        StatementKind::Case(expr, ..)
        | StatementKind::While(expr, _)
        | StatementKind::Repeat(_, expr) => {
            walk.expr(expr);
        }
        StatementKind::For(parts) => {
            [&parts.from, &parts.to, &parts.by].into_iter().for_each(|expr| walk.expr(expr));
            walk.place(&parts.variable, false);
        }
        StatementKind::Exit | StatementKind::Continue | StatementKind::Return => {}
    });
}

struct Walk<'v> {
    expr: &'v mut dyn FnMut(&Expr),
    place: &'v mut dyn FnMut(&Place, bool),
}

impl Walk<'_> {
    fn place(&mut self, place: &Place, exposed: bool) {
        (self.place)(place, exposed);
        if let Root::Deref(reference) = &place.root {
            self.expr(reference);
        }
        for step in &place.path {
            match step {
                Step::Index(index) | Step::Unit(index) => self.expr(index),
                Step::OpenIndex(indices) => indices.iter().for_each(|index| self.expr(index)),
                Step::Field(_) | Step::Bit(_) | Step::Part { .. } => {}
            }
        }
    }

    fn arguments(&mut self, arguments: &[Argument]) {
        for argument in arguments {
            match argument {
                Argument::Value(value) => self.expr(value),
                Argument::Reference(place) => self.place(place, true),
                Argument::Output(Some(place)) => self.place(place, false),
                Argument::Output(None) => {}
            }
        }
    }

    fn expr(&mut self, expr: &Expr) {
        (self.expr)(expr);
        match &expr.kind {
            ExprKind::Constant(_) => {}
            ExprKind::Load(place) | ExprKind::Bound { place, .. } => self.place(place, false),
            ExprKind::Reference(place) => self.place(place, true),
            ExprKind::Unary(_, operand) | ExprKind::Convert(_, operand) => self.expr(operand),
            ExprKind::Arithmetic(_, left, right)
            | ExprKind::Compare(_, left, right)
            | ExprKind::AndThen(left, right)
            | ExprKind::OrElse(left, right) => {
                self.expr(left);
                self.expr(right);
            }
            ExprKind::Call(_, arguments) => self.arguments(arguments),
            ExprKind::Intrinsic(_, arguments) => {
                arguments.iter().for_each(|argument| self.expr(argument))
            }
        }
    }
}
