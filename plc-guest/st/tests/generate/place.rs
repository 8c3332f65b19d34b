//! Random places, and indices that mostly are within the bounds.

use takt_st::hir::{
    Arithmetic, Class, Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic, Place, Step,
    Type, TypeId,
};

use super::Generator;
use super::expr::NUMBERS;

impl Generator {
    /// A place of exactly this type among `places`, with random indices. In half of the cases one that has indices, of
    /// which there are few among all variables.
    pub fn place_of(&mut self, places: &[Place], ty: TypeId) -> Option<Place> {
        if self.random.one_in(2) {
            let arrays: Vec<Place> =
                places.iter().filter(|place| self.has_indices(place.ty)).cloned().collect();
            if let Some(found) = self.place_among(&arrays, ty) {
                return Some(found);
            }
        }
        self.place_among(places, ty)
    }

    /// Whether a variable of this type is an array or has one in it.
    fn has_indices(&self, ty: TypeId) -> bool {
        match self.program.types.get(ty) {
            Type::Array { .. } => true,
            Type::Structure(structure) => {
                structure.fields.iter().any(|field| self.has_indices(field.ty))
            }
            _ => false,
        }
    }

    fn place_among(&mut self, places: &[Place], ty: TypeId) -> Option<Place> {
        let start = self.random.below(places.len().max(1));
        for at in 0..places.len() {
            let place = places[(start + at) % places.len()].clone();
            if let Some(found) = self.reach(place, ty) {
                return Some(found);
            }
        }
        None
    }

    fn reach(&mut self, place: Place, ty: TypeId) -> Option<Place> {
        if place.ty == ty {
            return Some(place);
        }
        match self.program.types.get(place.ty).clone() {
            Type::Structure(structure) => {
                let start = self.random.below(structure.fields.len().max(1));
                (0..structure.fields.len()).find_map(|at| {
                    let index = (start + at) % structure.fields.len();
                    self.reach(place.clone().field(index as u32, structure.fields[index].ty), ty)
                })
            }
            Type::Array { element, lower, upper } if self.contains(element, ty) => {
                let index = self.index(lower, upper);
                self.reach(place.index(index, element), ty)
            }
            Type::String { .. } | Type::WString { .. }
                if self.contains(place.ty, ty) && self.random.one_in(12) =>
            {
                let position = self.position();
                let mut character = place;
                character.path.push(Step::Unit(Box::new(position)));
                character.ty = ty;
                Some(character)
            }
            Type::Reference { target } if self.contains(target, ty) && self.random.one_in(3) => {
                let load = self.node(place.ty, ExprKind::Load(place));
                self.reach(Place::deref(load, target), ty)
            }
            _ => None,
        }
    }

    fn contains(&self, ty: TypeId, wanted: TypeId) -> bool {
        ty == wanted
            || match self.program.types.get(ty) {
                Type::Structure(structure) => {
                    structure.fields.iter().any(|field| self.contains(field.ty, wanted))
                }
                Type::Array { element, .. } => self.contains(*element, wanted),
                Type::String { .. } => self.is(wanted, Elementary::Char),
                Type::WString { .. } => self.is(wanted, Elementary::Wchar),
                _ => false,
            }
    }

    fn is(&self, ty: TypeId, elementary: Elementary) -> bool {
        *self.program.types.get(ty) == Type::Elementary(elementary)
    }

    /// A position in a string: mostly its beginning, where there may be a character.
    fn position(&mut self) -> Expr {
        if self.random.one_in(4) {
            return self.index(1, 2);
        }
        let lint = self.elementary(Elementary::Lint);
        let at = 1 + i128::from(self.random.one_in(6));
        self.node(lint, ExprKind::Constant(Constant::Integer(at)))
    }

    /// The variable of a loop and a constant, with all values within the bounds, or seldom one step beside them.
    fn counted_index(&mut self, lower: i64, upper: i64) -> Option<Expr> {
        let (lower, upper) = (i128::from(lower), i128::from(upper));
        let fitting: Vec<_> = self
            .counters
            .iter()
            .filter(|(_, low, high)| high - low <= upper - lower)
            .cloned()
            .collect();
        if fitting.is_empty() {
            return None;
        }
        let (variable, low, high) = self.random.pick(&fitting).clone();
        let slack = (upper - lower - (high - low)) as usize;
        let beside = i128::from(self.random.one_in(20));
        let more = lower - low + self.random.below(slack + 1) as i128 + beside;
        i32::try_from(more).ok()?;
        let own = self.program.types.scalar(variable.ty)?;
        let mut value = self.node(variable.ty, ExprKind::Load(variable));
        // In the variable's own type the sum may wrap.
        let within = |(least, greatest): (i128, i128)| more >= least && more <= greatest;
        if !own.range().is_some_and(within) || self.random.one_in(2) {
            let lint = self.elementary(Elementary::Lint);
            value = self.node(lint, ExprKind::Convert(Conversion::Value, Box::new(value)));
        }
        let ty = value.ty;
        let (operator, more) = if more < 0 && self.random.one_in(2) {
            (Arithmetic::Subtract, -more)
        } else {
            (Arithmetic::Add, more)
        };
        let constant = self.node(ty, ExprKind::Constant(Constant::Integer(more)));
        Some(self.node(ty, ExprKind::Arithmetic(operator, Box::new(value), Box::new(constant))))
    }

    /// An index that is mostly within the bounds.
    pub fn index(&mut self, lower: i64, upper: i64) -> Expr {
        if self.random.one_in(2)
            && let Some(index) = self.counted_index(lower, upper)
        {
            return index;
        }
        let lint = self.elementary(Elementary::Lint);
        match self.random.below(24) {
            0 => {
                let ty = NUMBERS[self.random.below(8)];
                let ty = self.elementary(ty);
                self.expr(ty, 1)
            }
            // One of the two places beside the array now and then.
            1 | 2 => {
                let ty = NUMBERS[self.random.below(8)];
                let ty = self.elementary(ty);
                let any = self.expr(ty, 1);
                self.modulo(any, lower - 1, upper + 1)
            }
            3..=8 => self.small_index(lower, upper),
            9..=12 => {
                let at = lower + self.random.below((upper - lower + 1) as usize) as i64;
                self.node(lint, ExprKind::Constant(Constant::Integer(at.into())))
            }
            13 | 14 => {
                // A loop's variable, which may be anything.
                let dint = self.elementary(Elementary::Dint);
                let places: Vec<Place> =
                    self.readable.iter().filter(|place| place.ty == dint).cloned().collect();
                match self.place_of(&places, dint) {
                    Some(place) => {
                        let load = self.node(dint, ExprKind::Load(place));
                        self.modulo(load, lower, upper)
                    }
                    None => self.index(lower, upper),
                }
            }
            _ => {
                let ty = NUMBERS[self.random.below(8)];
                let ty = self.elementary(ty);
                let any = self.expr(ty, 1);
                self.modulo(any, lower, upper)
            }
        }
    }

    /// An index in a small type of its own, of which more or less is known before the program runs: `x MOD n`, `x AND
    /// mask`, and a number added to it. It mostly is within the bounds, and its type may hold none of them.
    fn small_index(&mut self, lower: i64, upper: i64) -> Expr {
        let small = [
            Elementary::Usint,
            Elementary::Sint,
            Elementary::Uint,
            Elementary::Int,
            Elementary::Byte,
            Elementary::Udint,
            Elementary::Dint,
        ];
        let own = *self.random.pick(&small);
        let ty = self.elementary(own);
        let count = (upper - lower + 1) as i128;
        let number = |generator: &mut Self, value: i128| {
            generator.node(ty, ExprKind::Constant(Constant::Integer(own.wrap(value))))
        };
        let any = self.expr(ty, 1);
        // A power of two below, so that a mask stays within; one above is beside the array now and then.
        let mask = (1 << (127 - count.leading_zeros())) - 1;
        let (operator, right) = match self.random.below(8) {
            0 => (Arithmetic::And, mask * 2 + 1),
            1..=3 => (Arithmetic::And, mask),
            _ => (Arithmetic::Modulo, count + i128::from(self.random.one_in(12))),
        };
        let right = number(self, right.max(1));
        let part = self.node(ty, ExprKind::Arithmetic(operator, Box::new(any), Box::new(right)));
        if lower == 0 && self.random.one_in(2) {
            return part;
        }
        // What lies in front of the array, where a remainder is negative, is left out mostly.
        let part = if own.class() == Class::Signed && !self.random.one_in(12) {
            self.node(ty, ExprKind::Intrinsic(Intrinsic::Abs, vec![part]))
        } else {
            part
        };
        let wide = self.random.one_in(2) || own.range().is_none_or(|(low, _)| low > lower.into());
        let (ty, part) = match wide {
            true => {
                let lint = self.elementary(Elementary::Lint);
                (lint, self.node(lint, ExprKind::Convert(Conversion::Value, Box::new(part))))
            }
            false => (ty, part),
        };
        let first = self.node(ty, ExprKind::Constant(Constant::Integer(lower.into())));
        self.node(ty, ExprKind::Arithmetic(Arithmetic::Add, Box::new(part), Box::new(first)))
    }

    fn modulo(&mut self, any: Expr, lower: i64, upper: i64) -> Expr {
        let (lint, ulint) = (self.elementary(Elementary::Lint), self.elementary(Elementary::Ulint));
        let unsigned = self.node(ulint, ExprKind::Convert(Conversion::Value, Box::new(any)));
        let count =
            self.node(ulint, ExprKind::Constant(Constant::Integer((upper - lower + 1).into())));
        let rest = ExprKind::Arithmetic(Arithmetic::Modulo, Box::new(unsigned), Box::new(count));
        let rest = self.node(ulint, rest);
        let signed = self.node(lint, ExprKind::Convert(Conversion::Value, Box::new(rest)));
        let first = self.node(lint, ExprKind::Constant(Constant::Integer(lower.into())));
        self.node(lint, ExprKind::Arithmetic(Arithmetic::Add, Box::new(signed), Box::new(first)))
    }
}
