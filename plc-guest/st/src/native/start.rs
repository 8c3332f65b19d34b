//! `init`: the initial values of outputs and markers, and of what a kept instance does not keep.
//!
//! The state has its initial values in the image, and the kernel copies them. Outputs and markers are zero at a start;
//! those that the source gives another value are assigned here. The kernel puts back the values that are kept, of an instance
//! all that lie beside each other: so its NON_RETAIN variables begin anew here.

use super::retained::Retained;
use crate::hir::{
    Area, Block, Constant, Expr, ExprKind, GlobalId, Location, Place, Program, Retention, Routine,
    Statement, StatementKind, Type,
};

/// What is in a variable before `init`.
#[derive(Clone, Copy)]
enum Before {
    Zeros,
    /// Its initial value, or if it is retained that of an earlier run; and whether it is NON_RETAIN.
    State(Retention, bool),
}

/// The routine. It is no part of the program's own.
pub fn routine(program: &Program) -> Routine {
    let mut start = Start {
        program,
        retained: Retained::new(&program.types),
        location: Location::default(),
        body: Block::new(),
    };
    for (index, global) in program.globals.iter().enumerate() {
        let before = match global.storage.area {
            Area::Output | Area::Marker => Before::Zeros,
            Area::State => Before::State(global.retention, false),
            Area::Input => continue,
        };
        let place = Place::global(GlobalId(index as u32), global.ty);
        start.location = global.location;
        start.assign(place, &global.initial, before);
    }
    let body = start.body;
    Routine {
        name: "init".to_owned(),
        instance: None,
        locals: Vec::new(),
        result: None,
        body,
        location: Location::default(),
    }
}

/// The routine while it is written.
struct Start<'p> {
    program: &'p Program,
    retained: Retained<'p>,
    location: Location,
    body: Block,
}

impl Start<'_> {
    fn assign(&mut self, place: Place, value: &Constant, before: Before) {
        if let Before::State(retention, anew) = before
            && !self.retained.restarts(place.ty, retention, anew)
        {
            return;
        }
        let (program, location) = (self.program, self.location);
        let types = &program.types;
        match types.get(place.ty) {
            Type::Structure(structure) => {
                for (index, field) in structure.fields.iter().enumerate() {
                    let given = match value {
                        Constant::Aggregate(values) => values.get(index),
                        _ => None,
                    };
                    let value = match given {
                        None | Some(Constant::Default) => &field.initial,
                        Some(given) => given,
                    };
                    let before = match before {
                        Before::Zeros => Before::Zeros,
                        Before::State(outer, anew) => Before::State(
                            outer.max(field.retention),
                            field.retention == Retention::Never
                                || anew && field.retention == Retention::None,
                        ),
                    };
                    self.assign(place.clone().field(index as u32, field.ty), value, before);
                }
            }
            Type::Array { element, lower, upper } => {
                let Some(lint) = types.iter().find_map(|(id, ty)| {
                    matches!(ty, Type::Elementary(crate::hir::Elementary::Lint)).then_some(id)
                }) else {
                    return;
                };
                for (at, index) in (*lower..=*upper).enumerate() {
                    let value = match value {
                        Constant::Aggregate(values) => values.get(at).unwrap_or(&Constant::Default),
                        Constant::Fill(value) => value,
                        _ => &Constant::Default,
                    };
                    let index = ExprKind::Constant(Constant::Integer(index.into()));
                    let index = Expr::new(lint, index, location);
                    self.assign(place.clone().index(index, *element), value, before);
                }
            }
            _ => {
                let zero = matches!(value, Constant::Default) && types.first_value(place.ty) == 0;
                if !zero || matches!(before, Before::State(..)) {
                    let value = Expr::new(place.ty, ExprKind::Constant(value.clone()), location);
                    self.body
                        .push(Statement { kind: StatementKind::Assign(place, value), location });
                }
            }
        }
    }
}
