//! Kinds of traps as Cranelift's codes.

use cranelift_codegen::ir::TrapCode;

use crate::hir::TrapKind;

/// The trap code of a kind, and back.
pub fn trap_code(kind: TrapKind) -> TrapCode {
    TrapCode::unwrap_user(match kind {
        TrapKind::Bounds => 1,
        TrapKind::ZeroDivide => 2,
        TrapKind::Null => 3,
        TrapKind::LoopBudget => 4,
        TrapKind::Subrange => 5,
    })
}

/// The kind that a trap code stands for.
pub fn trap_kind(code: TrapCode) -> Option<TrapKind> {
    let all = [
        TrapKind::Bounds,
        TrapKind::ZeroDivide,
        TrapKind::Null,
        TrapKind::LoopBudget,
        TrapKind::Subrange,
    ];
    all.into_iter().find(|kind| trap_code(*kind) == code)
}
