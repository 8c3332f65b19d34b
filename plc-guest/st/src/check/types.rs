//! Types by their names, resolved on demand.

use super::body::Body;
use super::names::{elementary, similar};
use super::{Checker, Entry, Progress};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Class, Constant, Elementary, Retention, Section, StructureKind, Type, TypeId};
use crate::limits;
use crate::source::Span;
use crate::syntax::ast::{self, Name, TypeKind, UnitKind};

/// The characters of a STRING or WSTRING whose length is not written.
pub(super) const STRING_LENGTH: u16 = 80;

/// The bytes of a program's state: no variable can be larger.
pub(super) const STATE_BYTES: u64 = 64 << 20;

/// A declared type.
pub(super) struct TypeEntry<'a> {
    pub(super) ast: &'a ast::TypeDeclaration,
    library: bool,
    pub(super) progress: Progress,
    /// A structure has it before its fields are known, so that they can refer to it.
    pub(super) id: Option<TypeId>,
    /// What its variables begin with.
    pub(super) initial: Constant,
}

impl<'a> TypeEntry<'a> {
    pub(super) fn new(ast: &'a ast::TypeDeclaration, library: bool) -> Self {
        Self { ast, library, progress: Progress::Waiting, id: None, initial: Constant::Default }
    }
}

/// A type with what its variables begin with.
#[derive(Clone, Debug)]
pub(super) struct Resolved {
    pub(super) ty: TypeId,
    pub(super) initial: Constant,
}

impl From<TypeId> for Resolved {
    fn from(ty: TypeId) -> Self {
        Self { ty, initial: Constant::Default }
    }
}

impl<'a> Checker<'a> {
    pub(super) fn all_types(&mut self) {
        for index in 0..self.types.len() {
            let span = self.types[index].ast.name.span;
            self.declared_type(index, span);
        }
    }

    fn declared_type(&mut self, index: usize, span: Span) -> Option<Resolved> {
        let library = self.types[index].library;
        self.seen_from(library, |checker| checker.declared_type_here(index, span))
    }

    fn declared_type_here(&mut self, index: usize, span: Span) -> Option<Resolved> {
        let entry = &mut self.types[index];
        match entry.progress {
            Progress::Done => {
                return entry.id.map(|ty| Resolved { ty, initial: entry.initial.clone() });
            }
            Progress::Begun => {
                let found = format!("the type `{}` contains itself", entry.ast.name.text);
                self.tell(
                    Diagnostic::new(Code::Recursion, span, found)
                        .hint("a type can refer to itself with REF_TO"),
                );
                return None;
            }
            Progress::Waiting => {}
        }
        entry.progress = Progress::Begun;
        let ast = entry.ast;
        let resolved = self.deeper(span, |checker| match &ast.spec.kind {
            TypeKind::Structure { fields } => {
                let id = checker.program.types.declare(&ast.name.text, StructureKind::Struct);
                checker.types[index].id = Some(id);
                checker.fields(id, fields, ast.spec.span);
                Some(Resolved::from(id))
            }
            _ => {
                let mut constants = Body::of_constants(checker);
                constants.type_spec(&ast.spec, Some(&ast.name))
            }
        });
        self.types[index].id = resolved.as_ref().map(|resolved| resolved.ty);
        // Before its own initial value, which may name values of an enumeration.
        self.types[index].progress = Progress::Done;
        if let Some(resolved) = resolved {
            // That of a second type of the same name would mean values of the first.
            let initial = ast.initial.as_ref().filter(|_| !self.is_declared_twice(&ast.name));
            let initial = match initial {
                Some(initial) => {
                    let mut constants = Body::of_constants(self);
                    let (ty, declared) = (resolved.ty, resolved.initial);
                    let value = constants.initial(initial, ty).unwrap_or(Constant::Default);
                    constants.completed(value, &declared, ty, initial.span())
                }
                None => resolved.initial,
            };
            self.types[index].initial = initial;
        }
        let entry = &self.types[index];
        entry.id.map(|ty| Resolved { ty, initial: entry.initial.clone() })
    }

    fn fields(&mut self, id: TypeId, fields: &'a [ast::Variables], span: Span) {
        let mut seen: Vec<&Name> = Vec::new();
        for variables in fields {
            if let Some(address) = &variables.address {
                self.error(Code::InvalidDeclaration, address.span, "an address within a structure");
            }
            let mut constants = Body::of_constants(self);
            let Some(resolved) = constants.variable_type(variables) else { continue };
            if matches!(self.program.types.get(resolved.ty), Type::OpenArray { .. }) {
                let span = variables.spec.span;
                let one = Diagnostic::new(Code::InvalidDeclaration, span, "ARRAY[*] for a field");
                self.tell(one.allowed("bounds, or ARRAY[*] for a parameter"));
                continue;
            }
            for name in &variables.names {
                if let Some(other) = seen.iter().find(|other| other.key == name.key) {
                    let other = other.span;
                    self.duplicate(name, other);
                    continue;
                }
                seen.push(name);
                self.field(id, name, resolved.clone(), Section::Variable, Retention::None);
            }
        }
        if fields.is_empty() {
            self.error(Code::InvalidDeclaration, span, "a structure without fields");
        }
        self.program.types.complete(id);
    }

    /// Adds a field to a structure, unless that grows too large or too deep.
    pub(super) fn field(
        &mut self,
        id: TypeId,
        name: &Name,
        resolved: Resolved,
        section: Section,
        retention: Retention,
    ) -> Option<u32> {
        self.not_too_deep(1 + self.program.types.depth(resolved.ty), name.span)?;
        let types = &mut self.program.types;
        let size = u64::from(types.structure(id).map_or(0, |structure| structure.size));
        if size + u64::from(types.size(resolved.ty)) + 8 > STATE_BYTES {
            self.too_large(name.span);
            return None;
        }
        Some(types.define(id, &name.text, resolved.ty, resolved.initial, section, retention))
    }

    /// Refuses a type that is deeper than what the stages walk by recursion may be.
    pub(super) fn not_too_deep(&mut self, depth: u32, span: Span) -> Option<()> {
        if depth <= limits::DEPTH {
            return Some(());
        }
        let found = format!("a type with {depth} types within each other");
        let allowed = format!("at most {} levels", limits::DEPTH);
        self.tell(Diagnostic::new(Code::TooDeep, span, found).allowed(allowed));
        None
    }

    pub(super) fn too_large(&mut self, span: Span) {
        let found = "more than the state of a program can hold";
        let allowed = format!("{} MiB for all variables", STATE_BYTES >> 20);
        self.tell(Diagnostic::new(Code::InvalidRange, span, found).allowed(allowed));
    }

    /// The type that a name means. `by_reference` if only its address is needed.
    pub(super) fn named_type(&mut self, name: &Name, by_reference: bool) -> Option<Resolved> {
        if let Some(elementary) = elementary(&name.key) {
            return Some(self.elementary(elementary).into());
        }
        match &*name.key {
            "STRING" => return Some(self.program.types.string(STRING_LENGTH).into()),
            "WSTRING" => return Some(self.program.types.wstring(STRING_LENGTH).into()),
            _ => {}
        }
        match self.names.get(&name.key).cloned() {
            Some(Entry::Type(index)) => {
                let entry = &self.types[index];
                if by_reference && let (Progress::Begun, Some(ty)) = (entry.progress, entry.id) {
                    return Some(ty.into());
                }
                self.declared_type(index, name.span)
            }
            Some(Entry::Units(units)) => {
                let unit = units[0];
                match self.units[unit].ast.kind {
                    UnitKind::FunctionBlock => {
                        let ty = self.unit_type(unit, name.span, by_reference)?;
                        Some(ty.into())
                    }
                    kind => {
                        let what = if kind == UnitKind::Program { "program" } else { "function" };
                        let found = format!("`{}` is a {what} and no type", name.text);
                        self.tell(
                            Diagnostic::new(Code::WrongKind, name.span, found)
                                .allowed("a type or a function block"),
                        );
                        None
                    }
                }
            }
            Some(Entry::Global(_)) => {
                let found = format!("`{}` is a variable and no type", name.text);
                self.error(Code::WrongKind, name.span, found);
                None
            }
            None => {
                let found = format!("there is no type `{}`", name.text);
                let mut one = Diagnostic::new(Code::UnknownName, name.span, found);
                let own = self.names.keys();
                let all =
                    own.chain(Elementary::ALL.into_iter().map(|known| -> &str { known.name() }));
                if let Some(similar) = similar(&name.key, all) {
                    one = one.hint(format!("did you mean `{similar}`?"));
                }
                self.tell(one);
                None
            }
        }
    }
}

/// ANY_INT
pub(super) fn is_integer(elementary: Elementary) -> bool {
    use Elementary::*;
    matches!(elementary, Sint | Int | Dint | Lint | Usint | Uint | Udint | Ulint)
}

/// ANY_REAL
pub(super) fn is_real(elementary: Elementary) -> bool {
    elementary.class() == Class::Float
}

/// ANY_BIT
pub(super) fn is_bit_string(elementary: Elementary) -> bool {
    use Elementary::*;
    matches!(elementary, Bool | Byte | Word | Dword | Lword)
}

/// ANY_BIT without BOOL: what has bits to shift.
pub(super) fn is_shiftable(elementary: Elementary) -> bool {
    is_bit_string(elementary) && elementary != Elementary::Bool
}

/// ANY_CHAR
pub(super) fn is_character(elementary: Elementary) -> bool {
    matches!(elementary, Elementary::Char | Elementary::Wchar)
}

/// ANY_DURATION
pub(super) fn is_duration(elementary: Elementary) -> bool {
    matches!(elementary, Elementary::Time | Elementary::Ltime)
}

/// ANY_DATE
pub(super) fn is_date(elementary: Elementary) -> bool {
    use Elementary::*;
    matches!(elementary, Date | Ldate | Tod | Ltod | Dt | Ldt)
}
