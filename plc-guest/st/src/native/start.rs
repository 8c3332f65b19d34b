//! `init`: the initial values of outputs and markers.
//!
//! The state has its initial values in the image, and the kernel copies them. Outputs and markers are zero at a start;
//! those that the source gives another value are assigned here.

use crate::hir::{
    Area, Block, Constant, Expr, ExprKind, GlobalId, Location, Place, Program, Routine, Statement,
    StatementKind, Type,
};

/// The routine. It is no part of the program's own.
pub fn routine(program: &Program) -> Routine {
    let mut body = Block::new();
    for (index, global) in program.globals.iter().enumerate() {
        if matches!(global.storage.area, Area::Output | Area::Marker) {
            let place = Place::global(GlobalId(index as u32), global.ty);
            assign(program, place, &global.initial, global.location, &mut body);
        }
    }
    Routine {
        name: "init".to_owned(),
        instance: None,
        locals: Vec::new(),
        result: None,
        body,
        location: Location::default(),
    }
}

fn assign(program: &Program, place: Place, value: &Constant, location: Location, body: &mut Block) {
    let types = &program.types;
    match types.get(place.ty).clone() {
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
                assign(program, place.clone().field(index as u32, field.ty), value, location, body);
            }
        }
        Type::Array { element, lower, upper } => {
            let Some(lint) = types.iter().find_map(|(id, ty)| {
                matches!(ty, Type::Elementary(crate::hir::Elementary::Lint)).then_some(id)
            }) else {
                return;
            };
            for (at, index) in (lower..=upper).enumerate() {
                let value = match value {
                    Constant::Aggregate(values) => values.get(at).unwrap_or(&Constant::Default),
                    Constant::Fill(value) => value,
                    _ => &Constant::Default,
                };
                let index = ExprKind::Constant(Constant::Integer(index.into()));
                let index = Expr::new(lint, index, location);
                assign(program, place.clone().index(index, element), value, location, body);
            }
        }
        _ => {
            let zero = matches!(value, Constant::Default) && types.first_value(place.ty) == 0;
            if !zero {
                let value = Expr::new(place.ty, ExprKind::Constant(value.clone()), location);
                body.push(Statement { kind: StatementKind::Assign(place, value), location });
            }
        }
    }
}
