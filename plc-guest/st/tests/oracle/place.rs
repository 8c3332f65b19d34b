//! Places: from a path to an address.

use takt_st::hir::{Expr, ExprKind, Place, Root, Step, TrapKind, Type, TypeId};

use super::{Frame, Machine, Outcome, trap};

/// An address, and the bit of that byte if the place is one.
pub struct Target {
    pub address: u64,
    pub bit: Option<u8>,
}

impl Machine<'_> {
    pub(super) fn place(&mut self, frame: &Frame, place: &Place) -> Outcome<Target> {
        let program = self.program;
        let types = &program.types;
        let mut bit = None;
        let (mut address, mut ty) = match &place.root {
            Root::Global(id) => {
                let global = program.global(*id);
                bit = global.storage.bit;
                (self.global_address(*id), global.ty)
            }
            Root::Local(id) => {
                (frame.locals[id.0 as usize], program.routine(frame.routine).local(*id).ty)
            }
            Root::Instance => {
                (frame.instance, program.routine(frame.routine).instance.expect("an instance"))
            }
            Root::Deref(reference) => {
                let address = self.expr(frame, reference)?.integer() as u64;
                if address == 0 {
                    return trap(TrapKind::Null, reference.location);
                }
                let Type::Reference { target } = types.get(reference.ty) else {
                    panic!("no reference")
                };
                (address, *target)
            }
        };
        for step in &place.path {
            match (step, types.get(ty)) {
                (Step::Field(index), Type::Structure(structure)) => {
                    let field = &structure.fields[*index as usize];
                    address += u64::from(field.offset);
                    ty = field.ty;
                }
                (Step::Index(index), Type::Array { element, lower, upper }) => {
                    let at = self.checked_index(frame, index, *lower, *upper)?;
                    address += at * u64::from(types.size(*element));
                    ty = *element;
                }
                (Step::OpenIndex(indices), Type::OpenArray { element, .. }) => {
                    let Root::Local(id) = place.root else {
                        panic!("an open array that is no parameter")
                    };
                    let bounds = frame.bounds[&id.0].clone();
                    let mut at = 0;
                    for (index, (lower, upper)) in indices.iter().zip(bounds) {
                        at = at * (upper - lower + 1) as u64
                            + self.checked_index(frame, index, lower, upper)?;
                    }
                    address += at * u64::from(types.size(*element));
                    ty = *element;
                }
                (Step::Bit(number), _) => {
                    address += u64::from(number / 8);
                    bit = Some(number % 8);
                }
                (Step::Unit(position), Type::String { .. } | Type::WString { .. }) => {
                    let at = self.expr(frame, position)?.integer();
                    let length = self.load(address, ty).text().len() as i128;
                    if at < 1 || at > length {
                        return trap(TrapKind::Bounds, position.location);
                    }
                    let width = u64::from(types.size(place.ty));
                    address += (at - 1) as u64 * width;
                    ty = place.ty;
                }
                (Step::Part { offset, ty: part }, _) => {
                    address += u64::from(*offset);
                    ty = *part;
                }
                (step, ty) => panic!("{step:?} of {ty:?}"),
            }
        }
        Ok(Target { address, bit })
    }

    fn checked_index(
        &mut self,
        frame: &Frame,
        index: &Expr,
        lower: i64,
        upper: i64,
    ) -> Outcome<u64> {
        let at = self.expr(frame, index)?.integer();
        self.indices += u64::from(!matches!(index.kind, ExprKind::Constant(_)));
        if at < i128::from(lower) || at > i128::from(upper) {
            return trap(TrapKind::Bounds, index.location);
        }
        Ok((at - i128::from(lower)) as u64)
    }

    /// The bounds that a parameter of type `parameter` gets from `place`, if it is an open array.
    pub(super) fn bounds_of(
        &self,
        frame: &Frame,
        place: &Place,
        parameter: TypeId,
    ) -> Option<Vec<(i64, i64)>> {
        let types = &self.program.types;
        let Type::OpenArray { dimensions, .. } = types.get(parameter) else { return None };
        if let (Type::OpenArray { .. }, Root::Local(id)) = (types.get(place.ty), &place.root) {
            return Some(frame.bounds[&id.0].clone());
        }
        let mut ty = place.ty;
        let bounds = (0..*dimensions).map(|_| {
            let Type::Array { element, lower, upper } = types.get(ty) else {
                panic!("too few dimensions")
            };
            ty = *element;
            (*lower, *upper)
        });
        Some(bounds.collect())
    }
}
