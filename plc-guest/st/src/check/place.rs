//! Places: variables and their parts, as they are read and assigned.

use super::Entry;
use super::body::Body;
use super::expression::Operand;
use super::names::similar;
use super::types::{is_bit_string, is_integer};
use super::unit::Storage;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Area, Constant, Elementary, ExprKind, Place, Root, Section, Step, StructureKind, Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Expression, ExpressionKind, Name, SectionKind, UnitKind, Width};

/// What a place is needed for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    Read,
    Write,
}

impl<'a> Body<'_, 'a> {
    /// A place to read from.
    pub(super) fn read_place(&mut self, expression: &'a Expression) -> Option<Place> {
        self.place(expression, Access::Read)
    }

    /// A place to assign, to hand on by reference or to call.
    pub(super) fn write_place(&mut self, expression: &'a Expression) -> Option<Place> {
        let place = self.place(expression, Access::Write)?;
        if let Root::Global(id) = place.root {
            let global = self.checker.program.global(id);
            let wrong = match global.storage.area {
                Area::Input if !self.in_test() => Some("an input, which comes from outside"),
                _ if global.constant => Some("a constant"),
                _ => None,
            };
            if let Some(wrong) = wrong {
                self.not_assignable(expression.span, wrong);
                return None;
            }
        }
        Some(place)
    }

    pub(super) fn not_assignable(&mut self, span: Span, what: &str) {
        let found = format!("`{}` is {what}", self.checker.sources.text(span));
        let one = Diagnostic::new(Code::NotAssignable, span, found);
        self.tell(one.allowed("a variable that this unit may assign"));
    }

    fn place(&mut self, expression: &'a Expression, access: Access) -> Option<Place> {
        let span = expression.span;
        match &expression.kind {
            ExpressionKind::Name(name) => self.named_place(name, access),
            ExpressionKind::Address(address) => {
                let (id, ty) = self.checker.direct(address)?;
                Some(Place::global(id, ty))
            }
            ExpressionKind::Parenthesised(inner) if access == Access::Read => {
                self.place(inner, access)
            }
            ExpressionKind::Field(base, name) => self.field_place(base, name, access),
            ExpressionKind::Index(base, indices) => self.element(base, indices, access),
            ExpressionKind::Part(base, width, number, place) => {
                self.part(base, *width, *number, *place, access)
            }
            ExpressionKind::Dereference(base) => {
                let operand = self.operand(base, None)?;
                let ty = operand.expr.ty;
                let Type::Reference { target } = *self.checker.program.types.get(ty) else {
                    let found = format!("`^` behind {}", self.type_name(ty));
                    let one = Diagnostic::new(Code::TypeMismatch, span, found);
                    self.tell(one.allowed("a reference (REF_TO)"));
                    return None;
                };
                Some(Place::deref(operand.expr, target))
            }
            ExpressionKind::Error => None,
            _ => {
                self.not_assignable(span, "a value and no variable");
                None
            }
        }
    }

    fn named_place(&mut self, name: &'a Name, access: Access) -> Option<Place> {
        let place = self.any_named_place(name, access)?;
        if access == Access::Write && self.counting.contains(&place) {
            let found = format!("`{}` is the control variable of a FOR around it", name.text);
            let one = Diagnostic::new(Code::NotAssignable, name.span, found);
            self.tell(one.hint("leave the loop with EXIT, or use WHILE"));
            return None;
        }
        Some(place)
    }

    fn any_named_place(&mut self, name: &'a Name, access: Access) -> Option<Place> {
        if let Some(index) = self.variable(name) {
            return self.own_variable(index, name, access);
        }
        if self.is_result(name) {
            return self.result(name, access);
        }
        match self.checker.names.get(&name.key).cloned() {
            Some(Entry::Global(global)) => {
                self.checker.resolve_global(global, name.span);
                let entry = &mut self.checker.globals[global];
                entry.read |= access == Access::Read;
                entry.written |= access == Access::Write;
                if entry.constant.is_some() {
                    match access {
                        Access::Read => self.part_of_constant(name),
                        Access::Write => self.not_assignable(name.span, "a constant"),
                    }
                    return None;
                }
                Some(Place::global(entry.id?, entry.ty?))
            }
            Some(entry) => {
                self.no_variable(name, &entry);
                None
            }
            None => {
                self.unknown(name);
                None
            }
        }
    }

    /// Whether the name is that of the function whose body this is.
    pub(super) fn is_result(&self, name: &Name) -> bool {
        self.unit.is_some_and(|unit| {
            let ast = self.checker.units[unit].ast;
            ast.name.key == name.key && ast.kind == UnitKind::Function
        })
    }

    /// The variable of the function's result.
    pub(super) fn result(&mut self, name: &Name, access: Access) -> Option<Place> {
        if let Some((local, ty)) = self.unit.and_then(|unit| self.checker.units[unit].result) {
            self.result_assigned |= access == Access::Write;
            return Some(Place::local(local, ty));
        }
        let found = format!("the function `{}` has no result", name.text);
        let one = Diagnostic::new(Code::WrongKind, name.span, found);
        self.tell(one.hint("write the type of the result behind its name"));
        None
    }

    /// Tells that a part of a constant is read, which is a value and lies nowhere.
    fn part_of_constant(&mut self, name: &Name) {
        let found = format!("a part of `{}`, which is a constant", name.text);
        let one = Diagnostic::new(Code::NotAssignable, name.span, found);
        self.tell(one.allowed("a part of a variable").hint("copy it to a variable first"));
    }

    fn own_variable(&mut self, index: usize, name: &Name, access: Access) -> Option<Place> {
        let variable = &mut self.variables[index];
        variable.read |= access == Access::Read;
        variable.written |= access == Access::Write;
        if access == Access::Write {
            let types = &self.checker.program.types;
            let instance = variable.ty.is_some_and(|ty| types.has_instance(ty));
            let wrong = match variable.kind {
                _ if variable.constant => Some("a constant"),
                SectionKind::Input if instance => {
                    let found = format!(
                        "`{}` is an input of this unit, and only a copy of what is given",
                        name.text
                    );
                    let one = Diagnostic::new(Code::NotAssignable, name.span, found);
                    let one = one.allowed("its outputs to read");
                    self.tell(one.hint("declare it in VAR_IN_OUT, which stands for the instance"));
                    return None;
                }
                SectionKind::Input => Some("an input of this unit"),
                _ if variable.address.is_some_and(|address| address.area == ast::Area::Input)
                    && matches!(variable.storage, Storage::Field(_)) =>
                {
                    Some("an input, which comes from outside")
                }
                _ => None,
            };
            if let Some(wrong) = wrong {
                self.not_assignable(name.span, wrong);
                return None;
            }
        }
        let variable = &self.variables[index];
        let (ty, storage) = (variable.ty?, variable.storage.clone());
        if let Storage::External(global) = storage {
            self.resolve_external(index, global);
        }
        let storage = self.variables[index].storage.clone();
        if let Storage::Constant(..) = storage {
            self.part_of_constant(name);
            return None;
        }
        self.mark_external(name, access);
        self.checker.variable_place(self.unit, &storage, ty)
    }

    /// What happens to a VAR_EXTERNAL happens to the global variable.
    pub(super) fn mark_external(&mut self, name: &Name, access: Access) {
        let external =
            self.variable(name).is_some_and(|at| self.variables[at].kind == SectionKind::External);
        if external && let Some(Entry::Global(global)) = self.checker.names.get(&name.key) {
            let entry = &mut self.checker.globals[*global];
            entry.read |= access == Access::Read;
            entry.written |= access == Access::Write;
        }
    }

    fn no_variable(&mut self, name: &Name, entry: &Entry) {
        let (what, hint) = match entry {
            Entry::Type(_) => ("a type", "declare a variable of it in VAR"),
            Entry::Units(units) => match self.checker.units[units[0]].ast.kind {
                UnitKind::Function => ("a function", "call it with parentheses"),
                UnitKind::FunctionBlock => ("a function block", "declare an instance of it in VAR"),
                UnitKind::Program | UnitKind::Test => (
                    "a program",
                    "its variables are its own; share a global variable or an address",
                ),
            },
            Entry::Global(_) => ("a variable", ""),
        };
        let found = format!("`{}` is {what} and no variable", name.text);
        self.tell(Diagnostic::new(Code::WrongKind, name.span, found).hint(hint));
    }

    /// Tells that there is no such variable; once for each name of a unit.
    pub(super) fn unknown(&mut self, name: &Name) {
        if !self.unknown.insert(name.key.to_string()) {
            return;
        }
        let found = format!("there is no variable `{}`", name.text);
        let mut one = Diagnostic::new(Code::UnknownName, name.span, found);
        if &*name.key == "DEFAULT" {
            one = one.hint("what is done with all other values of a CASE stands behind `ELSE`");
        }
        let own = self.variables.iter().map(|variable| &*variable.name.text);
        let globals = self.checker.globals.iter().map(|global| &*global.name.text);
        if let Some(similar) = similar(&name.key, own.chain(globals)) {
            one = one.hint(format!("did you mean `{similar}`?"));
            let place = self
                .variables
                .iter()
                .map(|variable| variable.name)
                .chain(self.checker.globals.iter().map(|global| global.name))
                .find(|name| &*name.text == similar);
            if let Some(place) = place {
                one = one.related(place.span, format!("`{similar}` is declared here"));
            }
        }
        self.tell(one);
    }

    fn field_place(
        &mut self,
        base: &'a Expression,
        name: &'a Name,
        access: Access,
    ) -> Option<Place> {
        if let ExpressionKind::Name(ty) = &base.kind
            && self.variable(ty).is_none()
            && let Some(Entry::Type(_)) = self.checker.names.get(&ty.key)
        {
            let found = format!("`{}` is a type and no variable", ty.text);
            let hint = format!("a value of an enumeration is written `{}#{}`", ty.text, name.text);
            self.tell(Diagnostic::new(Code::WrongKind, ty.span, found).hint(hint));
            return None;
        }
        let place = self.place(base, access)?;
        let ty = place.ty;
        let Some(structure) = self.checker.program.types.structure(ty) else {
            let found = format!("`.{}` behind {}", name.text, self.type_name(ty));
            let mut one = Diagnostic::new(Code::TypeMismatch, name.span, found)
                .allowed("a structure or an instance of a function block");
            if let Type::Reference { .. } = self.checker.program.types.get(ty) {
                one = one.hint(format!("write `^.{}`", name.text));
            }
            self.tell(one);
            return None;
        };
        let found =
            structure.fields.iter().position(|field| field.name.eq_ignore_ascii_case(&name.text));
        let kind = structure.kind;
        let (field_type, section) = match found {
            Some(index) => (structure.fields[index].ty, structure.fields[index].section),
            None if self.is_of_the_call(ty, name) => (ty, Section::InOut),
            None => {
                self.no_field(name, ty);
                return None;
            }
        };
        let refused = match section {
            _ if kind == StructureKind::Struct => None,
            Section::Variable if self.in_test() => None,
            Section::Variable => Some("a variable of its own, which only its body uses"),
            Section::InOut => Some("a VAR_IN_OUT, which is given in a call"),
            Section::Output if access == Access::Write => {
                Some("an output, which only its body assigns")
            }
            Section::Input | Section::Output => None,
        };
        if let Some(refused) = refused {
            let found = format!("`{}` of {} is {refused}", name.text, self.type_name(ty));
            let one = Diagnostic::new(Code::NotAssignable, name.span, found);
            self.tell(one.allowed("its inputs, and its outputs to read"));
            return None;
        }
        Some(place.field(found? as u32, field_type))
    }

    /// Whether a function block has a parameter of this name that is no field, as an ARRAY[*] is none.
    fn is_of_the_call(&self, ty: TypeId, name: &Name) -> bool {
        let block = self.checker.units.iter().find(|unit| unit.structure == Some(ty));
        let variable = block.and_then(|unit| Some(&unit.variables[*unit.by_key.get(&*name.key)?]));
        variable.is_some_and(|variable| {
            variable.kind == SectionKind::InOut && matches!(variable.storage, Storage::Local(_))
        })
    }

    fn element(
        &mut self,
        base: &'a Expression,
        indices: &'a [Expression],
        access: Access,
    ) -> Option<Place> {
        let place = self.place(base, access);
        // What is wrong in an index is told whatever is wrong before it.
        let mut operands: Vec<Option<Operand>> = match &place {
            Some(_) => indices.iter().map(|index| self.index(index)).collect(),
            None => {
                self.all_apart(indices);
                Vec::new()
            }
        };
        let mut place = place?;
        let whole = place.ty;
        if let Type::OpenArray { element, dimensions } = *self.checker.program.types.get(whole) {
            if indices.len() != usize::from(dimensions) {
                self.wrong_indices(base.span, whole, indices.len());
                return None;
            }
            let list: Option<Vec<_>> =
                operands.into_iter().map(|index| index.map(|index| index.expr)).collect();
            place.path.push(Step::OpenIndex(list?));
            place.ty = element;
            return Some(place);
        }
        if self.checker.program.types.is_string(whole)
            && let ([index], [operand]) = (indices, &mut operands[..])
        {
            return self.character(place, operand.take()?, index.span);
        }
        for (index, operand) in indices.iter().zip(operands) {
            let Type::Array { element, lower, upper } = *self.checker.program.types.get(place.ty)
            else {
                self.wrong_indices(base.span, whole, indices.len());
                return None;
            };
            let operand = operand?;
            if let Some(Constant::Integer(value)) = operand.constant()
                && !(i128::from(lower)..=i128::from(upper)).contains(value)
            {
                let found = format!("the index {value} of an array from {lower} to {upper}");
                let one = Diagnostic::new(Code::OutOfRange, index.span, found);
                self.tell(one.allowed(format!("{lower}..{upper}")));
                return None;
            }
            place = place.index(operand.expr, element);
        }
        Some(place)
    }

    /// A character of a string.
    fn character(&mut self, mut place: Place, operand: Operand, span: Span) -> Option<Place> {
        let (capacity, character) = match *self.checker.program.types.get(place.ty) {
            Type::String { capacity } => (capacity, Elementary::Char),
            Type::WString { capacity } => (capacity, Elementary::Wchar),
            _ => return None,
        };
        if let Some(Constant::Integer(value)) = operand.constant()
            && !(1..=i128::from(capacity)).contains(value)
        {
            let found = format!("the position {value} in {}", self.type_name(place.ty));
            let one = Diagnostic::new(Code::OutOfRange, span, found);
            self.tell(one.allowed(format!("1..{capacity}")));
            return None;
        }
        place.path.push(Step::Unit(Box::new(operand.expr)));
        place.ty = self.elementary(character);
        Some(place)
    }

    fn wrong_indices(&mut self, span: Span, ty: TypeId, count: usize) {
        let mut dimensions = 0;
        let mut inner = ty;
        loop {
            match self.checker.program.types.get(inner) {
                Type::Array { element, .. } => (inner, dimensions) = (*element, dimensions + 1),
                Type::OpenArray { dimensions: open, .. } => {
                    dimensions += usize::from(*open);
                    break;
                }
                Type::String { .. } | Type::WString { .. } if dimensions == 0 => {
                    dimensions = 1;
                    break;
                }
                _ => break,
            }
        }
        let found = format!("{count} indices for {}", self.type_name(ty));
        let allowed = match dimensions {
            0 => "no index: it is neither array nor string".to_owned(),
            _ => format!("{dimensions} of them"),
        };
        self.tell(Diagnostic::new(Code::TypeMismatch, span, found).allowed(allowed));
    }

    fn index(&mut self, index: &'a Expression) -> Option<Operand> {
        let operand = self.operand(index, None)?;
        let operand = self.without_subrange(operand, index.span);
        let fits = self.plain(operand.expr.ty).is_some_and(is_integer)
            && !matches!(operand.expr.kind, ExprKind::Constant(Constant::Real(_)));
        if !fits {
            let found = format!("an index of type {}", self.type_name(operand.expr.ty));
            let one = Diagnostic::new(Code::TypeMismatch, index.span, found);
            self.tell(one.allowed("an integer"));
            return None;
        }
        Some(operand)
    }

    fn part(
        &mut self,
        base: &'a Expression,
        width: Width,
        number: u32,
        span: Span,
        access: Access,
    ) -> Option<Place> {
        let mut place = self.place(base, access)?;
        let elementary = self.plain(place.ty).filter(|elementary| {
            *elementary != Elementary::Bool
                && (is_bit_string(*elementary) || is_integer(*elementary))
        });
        let Some(elementary) = elementary else {
            let found = format!("a bit or part of {}", self.type_name(place.ty));
            let one = Diagnostic::new(Code::TypeMismatch, span, found);
            self.tell(one.allowed("a part of BYTE, WORD, DWORD, LWORD or an integer"));
            return None;
        };
        let (size, ty) = match width {
            Width::Bit => (0, Elementary::Bool),
            Width::Byte => (1, Elementary::Byte),
            Width::Word => (2, Elementary::Word),
            Width::Double => (4, Elementary::Dword),
            Width::Long => (8, Elementary::Lword),
        };
        let count = elementary.size().checked_div(size).unwrap_or(elementary.size() * 8);
        if number >= count {
            let found = format!("part {number} of {}", elementary.name());
            let allowed = match count {
                0 => "a smaller part".to_owned(),
                _ => format!("0..{}", count - 1),
            };
            self.tell(Diagnostic::new(Code::OutOfRange, span, found).allowed(allowed));
            return None;
        }
        let ty = self.elementary(ty);
        place.path.push(match width {
            Width::Bit => Step::Bit(number as u8),
            _ => Step::Part { offset: number * size, ty },
        });
        place.ty = ty;
        Some(place)
    }
}
