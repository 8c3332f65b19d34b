//! Initial values.

use super::body::Body;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Field, Section, StructureKind, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{ArrayElement, Initial, Name};

/// The values that an array's initial value may have one by one, which are kept in memory.
const ELEMENTS: u64 = 1 << 20;
/// The values that a program may ask for without writing them: repeated ones, and those that types declare.
const COPIES: u64 = 4 << 20;

impl<'a> Body<'_, 'a> {
    pub(super) fn initial(&mut self, initial: &'a Initial, ty: TypeId) -> Option<Constant> {
        match initial {
            Initial::Value(value) => {
                let types = &self.checker.program.types;
                if types.scalar(ty).is_none() && !types.is_string(ty) {
                    let allowed = match types.get(ty) {
                        Type::Array { .. } => "`[value, value, 3(value)]`",
                        _ => "`(field := value, field := value)`",
                    };
                    let found = format!("one value for {}", self.type_name(ty));
                    self.tell(
                        Diagnostic::new(Code::TypeMismatch, value.span, found).allowed(allowed),
                    );
                    return None;
                }
                self.constant(value, ty)
            }
            Initial::Array(elements, span) => self.array_initial(elements, *span, ty),
            Initial::Structure(fields, span) => self.structure_initial(fields, *span, ty),
        }
    }

    fn array_initial(
        &mut self,
        elements: &'a [ArrayElement],
        span: Span,
        ty: TypeId,
    ) -> Option<Constant> {
        let Type::Array { element, .. } = *self.checker.program.types.get(ty) else {
            let found = format!("a list of values for {}", self.type_name(ty));
            self.error(Code::TypeMismatch, span, found);
            return None;
        };
        // The values of several dimensions may be written in one row, the last index fastest.
        let nested = elements.iter().any(|element| match element {
            ArrayElement::One(Initial::Array(..)) => true,
            ArrayElement::Repeated(_, values) => {
                values.iter().any(|value| matches!(value, Initial::Array(..)))
            }
            ArrayElement::One(_) => false,
        });
        let mut leaf = element;
        let mut shape = vec![self.count(ty)];
        if !nested {
            while let Type::Array { element, .. } = *self.checker.program.types.get(leaf) {
                shape.push(self.count(leaf));
                leaf = element;
            }
        }
        let count = shape.iter().product::<u64>();
        let values = self.element_values(elements, leaf, count, span)?;
        if values.len() == 1 && elements.len() == 1 && count > 1 {
            // `[5(0)]` for five elements.
            return Some(shaped_fill(values.into_iter().next()?, &shape));
        }
        Some(shaped(values, &shape))
    }

    /// An initial value of type `ty` with what it leaves out as the declaration of the type has it.
    pub(super) fn completed(
        &mut self,
        given: Constant,
        declared: &Constant,
        ty: TypeId,
        span: Span,
    ) -> Constant {
        let values = match (given, declared) {
            (given, Constant::Default) => return given,
            (Constant::Default, declared) => return declared.clone(),
            (Constant::Fill(value), Constant::Fill(rest)) => {
                let value = self.completed(*value, rest, self.type_of_part(ty, 0), span);
                return Constant::Fill(Box::new(value));
            }
            (Constant::Fill(value), Constant::Aggregate(_)) if leaves_out(&value) => {
                if !self.may_copy(self.count(ty), span) {
                    return Constant::Fill(value);
                }
                vec![*value; self.count(ty) as usize].into()
            }
            (Constant::Aggregate(values), _) => values,
            (given, _) => return given,
        };
        let all = match declared {
            Constant::Fill(_) => self.count(ty),
            Constant::Aggregate(rest) => rest.len() as u64,
            _ => 0,
        };
        if !self.may_copy(all, span) {
            return Constant::Aggregate(values);
        }
        let mut values = values.iter().cloned();
        let count = values.len().max(all as usize);
        let mut whole = Vec::with_capacity(count);
        for index in 0..count {
            let rest = match declared {
                Constant::Fill(rest) => rest,
                Constant::Aggregate(list) => list.get(index).unwrap_or(&Constant::Default),
                _ => &Constant::Default,
            };
            let value = values.next().unwrap_or(Constant::Default);
            whole.push(self.completed(value, rest, self.type_of_part(ty, index), span));
        }
        Constant::Aggregate(whole.into())
    }

    /// Counts values that are copied. A short source can ask for very many.
    fn may_copy(&mut self, count: u64, span: Span) -> bool {
        let before = self.checker.copied;
        self.checker.copied = before.saturating_add(count);
        let fits = self.checker.copied <= COPIES;
        if !fits && before <= COPIES {
            let found = "too many values that are repeated, or left out and declared by types";
            let one = Diagnostic::new(Code::InvalidRange, span, found);
            let allowed = format!("{COPIES} in all initial values together");
            self.tell(one.allowed(allowed).hint("one value for the whole array is no copy"));
        }
        fits
    }

    /// The type of a field or an element.
    fn type_of_part(&self, ty: TypeId, index: usize) -> TypeId {
        match self.checker.program.types.get(ty) {
            Type::Array { element, .. } => *element,
            Type::Structure(structure) => structure.fields.get(index).map_or(ty, |field| field.ty),
            _ => ty,
        }
    }

    fn too_many_single(&mut self, span: Span, count: u64) {
        let found = format!("{count} single initial values");
        let allowed = format!("{ELEMENTS}, or one value for the whole array");
        self.tell(Diagnostic::new(Code::InvalidRange, span, found).allowed(allowed));
    }

    fn count(&self, ty: TypeId) -> u64 {
        match self.checker.program.types.get(ty) {
            Type::Array { lower, upper, .. } => upper.abs_diff(*lower) + 1,
            _ => 1,
        }
    }

    /// The values one by one; one alone if it is repeated for the whole array.
    fn element_values(
        &mut self,
        elements: &'a [ArrayElement],
        ty: TypeId,
        count: u64,
        span: Span,
    ) -> Option<Vec<Constant>> {
        let mut values = Vec::new();
        for element in elements {
            match element {
                ArrayElement::One(value) => values.push(self.initial(value, ty)?),
                ArrayElement::Repeated(times, list) => {
                    let repeated = self.constant_integer(times)?;
                    let list: Option<Vec<Constant>> =
                        list.iter().map(|value| self.initial(value, ty)).collect();
                    let mut list = list?;
                    if list.is_empty() {
                        list.push(Constant::Default);
                    }
                    let Ok(repeated) = u64::try_from(repeated) else {
                        self.error(Code::InvalidRange, times.span, "a negative repetition");
                        return None;
                    };
                    if elements.len() == 1 && list.len() == 1 && repeated == count {
                        return Some(list);
                    }
                    let total = repeated.saturating_mul(list.len() as u64);
                    if total.saturating_add(values.len() as u64) > count {
                        self.too_many(span, count);
                        return None;
                    }
                    if total > ELEMENTS {
                        self.too_many_single(times.span, total);
                        return None;
                    }
                    if !self.may_copy(total, times.span) {
                        return None;
                    }
                    for _ in 0..repeated {
                        values.extend(list.iter().cloned());
                    }
                }
            }
            if values.len() as u64 > count {
                self.too_many(span, count);
                return None;
            }
        }
        if values.len() == 1 && elements.len() == 1 && count > 1 {
            // One value that is not repeated is only the first element's.
            values.push(Constant::Default);
        }
        Some(values)
    }

    fn too_many(&mut self, span: Span, count: u64) {
        let one = Diagnostic::new(Code::InvalidRange, span, "more values than the array has");
        self.tell(one.allowed(format!("at most {count}")));
    }

    fn structure_initial(
        &mut self,
        fields: &'a [(Name, Initial)],
        span: Span,
        ty: TypeId,
    ) -> Option<Constant> {
        let Some(structure) = self.checker.program.types.structure(ty) else {
            let found = format!("a list of fields for {}", self.type_name(ty));
            self.error(Code::TypeMismatch, span, found);
            return None;
        };
        let known: Vec<(String, TypeId)> = structure
            .fields
            .iter()
            .map(|field| (field.name.to_ascii_uppercase(), field.ty))
            .collect();
        let mut values = vec![Constant::Default; known.len()];
        let mut given = vec![false; known.len()];
        for (name, value) in fields {
            let Some(index) = known.iter().position(|(key, _)| **key == *name.key) else {
                self.no_field(name, ty);
                continue;
            };
            if std::mem::replace(&mut given[index], true) {
                let found = format!("`{}` has two initial values", name.text);
                self.error(Code::DuplicateName, name.span, found);
            }
            let (place, field) = (value.span(), known[index].1);
            if let Some(value) = self.initial(value, field) {
                let types = &self.checker.program.types;
                let declared = types.structure(ty).map(|ty| ty.fields[index].initial.clone());
                let declared = declared.unwrap_or(Constant::Default);
                values[index] = self.completed(value, &declared, field, place);
            }
        }
        Some(Constant::Aggregate(values.into()))
    }

    /// Tells that a structure has no such field.
    pub(super) fn no_field(&mut self, name: &Name, ty: TypeId) {
        let found = format!("{} has no `{}`", self.type_name(ty), name.text);
        let mut one = Diagnostic::new(Code::UnknownName, name.span, found);
        if let Some(structure) = self.checker.program.types.structure(ty) {
            // What only the body of a block uses is no help, nor is a name of the compiler's own.
            let reached = |field: &&Field| {
                let open = structure.kind == StructureKind::Struct
                    || matches!(field.section, Section::Input | Section::Output)
                    || self.in_test();
                open && !field.name.contains('-')
            };
            let fields = structure.fields.iter().filter(reached).map(|field| &*field.name);
            if let Some(similar) = super::names::similar(&name.key, fields.clone()) {
                one = one.hint(format!("did you mean `{similar}`?"));
            }
            let shown: Vec<&str> = fields.take(12).collect();
            one = one.allowed(match shown.is_empty() {
                true => "nothing: it has no member that can be reached".to_owned(),
                false => shown.join(", "),
            });
        }
        self.tell(one);
    }
}

/// Whether some part of a value is not written.
fn leaves_out(value: &Constant) -> bool {
    match value {
        Constant::Default => true,
        Constant::Fill(value) => leaves_out(value),
        // The list may end before the array.
        Constant::Aggregate(_) => true,
        _ => false,
    }
}

/// A row of values as arrays within arrays.
fn shaped(values: Vec<Constant>, shape: &[u64]) -> Constant {
    let inner: u64 = shape[1..].iter().product();
    if shape.len() == 1 {
        return Constant::Aggregate(values.into());
    }
    let mut rows = Vec::new();
    let mut values = values.into_iter().peekable();
    while values.peek().is_some() {
        let row: Vec<Constant> = values.by_ref().take(inner as usize).collect();
        rows.push(shaped(row, &shape[1..]));
    }
    Constant::Aggregate(rows.into())
}

fn shaped_fill(value: Constant, shape: &[u64]) -> Constant {
    shape.iter().fold(value, |value, _| Constant::Fill(Box::new(value)))
}
