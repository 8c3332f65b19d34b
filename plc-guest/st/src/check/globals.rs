//! Global variables and variables at direct addresses.

use std::collections::HashSet;

use super::body::Body;
use super::declare::{area, retention};
use super::types::{Resolved, STATE_BYTES};
use super::{Checker, Progress};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{self, Area, Constant, Elementary, GlobalId, Storage, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{self, Name, Width};

/// A global variable.
pub(super) struct GlobalEntry<'a> {
    pub(super) section: &'a ast::Section,
    pub(super) variables: &'a ast::Variables,
    pub(super) name: &'a Name,
    pub(super) library: bool,
    pub(super) progress: Progress,
    pub(super) ty: Option<TypeId>,
    pub(super) id: Option<GlobalId>,
    /// Its value, if it is a constant without a place of its own.
    pub(super) constant: Option<(TypeId, Constant)>,
    pub(super) read: bool,
    pub(super) written: bool,
}

impl<'a> GlobalEntry<'a> {
    pub(super) fn new(
        section: &'a ast::Section,
        variables: &'a ast::Variables,
        name: &'a Name,
        library: bool,
    ) -> Self {
        Self {
            section,
            variables,
            name,
            library,
            progress: Progress::Waiting,
            ty: None,
            id: None,
            constant: None,
            read: false,
            written: false,
        }
    }
}

impl<'a> Checker<'a> {
    pub(super) fn all_globals(&mut self) {
        for index in 0..self.globals.len() {
            let span = self.globals[index].name.span;
            self.resolve_global(index, span);
        }
    }

    /// Resolves a global variable, for which the place at `span` asks.
    pub(super) fn resolve_global(&mut self, index: usize, span: Span) {
        let library = self.globals[index].library;
        self.seen_from(library, |checker| checker.resolve_global_here(index, span));
    }

    fn resolve_global_here(&mut self, index: usize, span: Span) {
        let entry = &mut self.globals[index];
        match entry.progress {
            Progress::Done => return,
            Progress::Begun => {
                let found = format!("`{}` depends on its own value", entry.name.text);
                self.error(Code::Recursion, span, found);
                // Told once: what needs it goes on without its value.
                self.globals[index].progress = Progress::Done;
                return;
            }
            Progress::Waiting => entry.progress = Progress::Begun,
        }
        let (section, variables, name) = (entry.section, entry.variables, entry.name);
        // Names of one declaration have one type, and what is wrong with it is told once.
        let place = variables.spec.span;
        let resolved = match self.global_types.get(&place) {
            Some(known) => known.clone(),
            None => {
                let resolved = self
                    .deeper(span, |checker| Body::of_constants(checker).variable_type(variables));
                self.global_types.insert(place, resolved.clone());
                resolved
            }
        };
        if let Some(resolved) = resolved {
            self.define_global(index, section, variables, name, resolved);
        }
        self.globals[index].progress = Progress::Done;
    }

    fn define_global(
        &mut self,
        index: usize,
        section: &ast::Section,
        variables: &ast::Variables,
        name: &Name,
        resolved: Resolved,
    ) {
        let ty = resolved.ty;
        self.globals[index].ty = Some(ty);
        if matches!(self.program.types.get(ty), Type::OpenArray { .. }) {
            let found = "ARRAY[*] for a global variable";
            self.error(Code::InvalidDeclaration, variables.spec.span, found);
            return;
        }
        if section.constant.is_some() {
            if variables.initial.is_none() {
                let found = format!("the constant `{}` without a value", name.text);
                self.error(Code::InvalidDeclaration, name.span, found);
            }
            if self.program.types.scalar(ty).is_some() || self.program.types.is_string(ty) {
                let value = self.constant_value(ty, resolved.initial);
                self.globals[index].constant = Some((ty, value));
                return;
            }
        }
        let retention = retention(section.retention.map(|(retention, _)| retention));
        self.globals[index].id = match &variables.address {
            Some(address) => self.located(address, &name.text, name.span, resolved, retention),
            None => self.state(&name.text, name.span, resolved, retention),
        };
        if let Some(id) = self.globals[index].id {
            self.program.globals[id.0 as usize].constant = section.constant.is_some();
        }
    }

    /// What a constant of a scalar type or string is, also where nothing is written.
    pub(super) fn constant_value(&self, ty: TypeId, value: Constant) -> Constant {
        match (value, self.program.types.get(ty)) {
            (Constant::Default, Type::String { .. }) => Constant::String(Vec::new()),
            (Constant::Default, Type::WString { .. }) => Constant::WString(Vec::new()),
            (Constant::Default, Type::Elementary(Elementary::Real | Elementary::Lreal)) => {
                Constant::Real(0.0)
            }
            (Constant::Default, _) => Constant::Integer(self.program.types.first_value(ty)),
            (value, _) => value,
        }
    }

    /// A variable in the state.
    pub(super) fn state(
        &mut self,
        name: &str,
        span: Span,
        resolved: Resolved,
        retention: hir::Retention,
    ) -> Option<GlobalId> {
        let used = u64::from(self.state_end);
        if used + u64::from(self.program.types.size(resolved.ty)) + 8 > STATE_BYTES {
            self.too_large(span);
            return None;
        }
        let align = self.program.types.align(resolved.ty).max(1);
        let offset = self.state_end.next_multiple_of(align);
        self.state_end = offset + self.program.types.size(resolved.ty);
        let location = self.location(span);
        Some(self.program.add_global(hir::Global {
            name: name.to_owned(),
            ty: resolved.ty,
            storage: Storage { area: Area::State, offset, bit: None },
            initial: resolved.initial,
            retention,
            constant: false,
            location,
        }))
    }

    /// A variable at an address.
    pub(super) fn located(
        &mut self,
        address: &ast::Address,
        name: &str,
        span: Span,
        resolved: Resolved,
        retention: hir::Retention,
    ) -> Option<GlobalId> {
        let ty = resolved.ty;
        let storage = self.storage_at(address, ty)?;
        let location = self.location(span);
        if retention != hir::Retention::None {
            let found = "retention of a variable with an address";
            self.tell(
                Diagnostic::new(Code::InvalidDeclaration, span, found)
                    .allowed("RETAIN and PERSISTENT without AT")
                    .hint("inputs, outputs and markers begin anew; keep a copy in a variable without AT"),
            );
        }
        if address.area == ast::Area::Input && resolved.initial != Constant::Default {
            let found = "an initial value of an input, which comes from outside";
            self.error(Code::InvalidDeclaration, span, found);
        }
        let id = self.program.add_global(hir::Global {
            name: name.to_owned(),
            ty,
            storage,
            initial: resolved.initial,
            retention: hir::Retention::None,
            constant: false,
            location,
        });
        match address.place {
            None => self.floating.push((id, address.span)),
            Some(_) if address.area == ast::Area::Output => self.outputs.push((id, address.span)),
            Some(_) => {}
        }
        Some(id)
    }

    /// Where a variable of this type lies at an address; at the beginning if its place is chosen later.
    pub(super) fn storage_at(&mut self, address: &ast::Address, ty: TypeId) -> Option<Storage> {
        self.check_width(address, ty)?;
        Some(match address.place {
            Some(place) => {
                let bit = (place.width == Width::Bit).then_some(place.bit);
                Storage { area: area(address.area), offset: place.byte, bit }
            }
            None => Storage { area: area(address.area), offset: 0, bit: None },
        })
    }

    /// The type has the width of its address; of an array, the elements have.
    pub(super) fn check_width(&mut self, address: &ast::Address, ty: TypeId) -> Option<()> {
        let mut element = ty;
        while let Type::Array { element: inner, .. } = self.program.types.get(element) {
            element = *inner;
        }
        if let (ast::Area::Input, Type::Subrange { base, .. }) =
            (address.area, self.program.types.get(element))
        {
            let base = base.name();
            let address_text = self.sources.text(address.span);
            let found =
                format!("{} at `{address_text}`, where any {base} may come", self.type_name(ty));
            self.tell(
                Diagnostic::new(Code::TypeMismatch, address.span, found)
                    .allowed(base)
                    .hint("assign the input to a variable of the subrange: that is checked"),
            );
            return None;
        }
        let scalar = match self.program.types.get(element) {
            Type::Reference { .. } => None,
            _ => self.program.types.scalar(element),
        };
        let allowed = match address.place.map(|place| place.width) {
            None if scalar.is_some() => return Some(()),
            None => "an elementary type or an array of one",
            Some(Width::Bit) if scalar == Some(Elementary::Bool) && element == ty => {
                return Some(());
            }
            Some(Width::Bit) => "BOOL",
            Some(width) => {
                let (bytes, allowed) = match width {
                    Width::Bit | Width::Byte => (1, "a type of 8 bits other than BOOL"),
                    Width::Word => (2, "a type of 16 bits, such as INT or WORD"),
                    Width::Double => (4, "a type of 32 bits, such as DINT or REAL"),
                    Width::Long => (8, "a type of 64 bits, such as LINT or LREAL"),
                };
                let fits =
                    |scalar: &Elementary| scalar.size() == bytes && *scalar != Elementary::Bool;
                if scalar.as_ref().is_some_and(fits) {
                    return Some(());
                }
                allowed
            }
        };
        let found = format!("{} at `{}`", self.type_name(ty), self.sources.text(address.span));
        self.tell(Diagnostic::new(Code::TypeMismatch, address.span, found).allowed(allowed));
        None
    }

    /// The variable that an address in an expression means.
    pub(super) fn direct(&mut self, address: &ast::Address) -> Option<(GlobalId, TypeId)> {
        let Some(place) = address.place else {
            let found = "an address without a place in an expression";
            self.error(Code::InvalidAddress, address.span, found);
            return None;
        };
        let ty = self.elementary(match place.width {
            Width::Bit => Elementary::Bool,
            Width::Byte => Elementary::Byte,
            Width::Word => Elementary::Word,
            Width::Double => Elementary::Dword,
            Width::Long => Elementary::Lword,
        });
        if let Some(id) = self.addresses.get(&(address.area, place)) {
            return Some((*id, ty));
        }
        let bit = (place.width == Width::Bit).then_some(place.bit);
        let location = self.location(address.span);
        let id = self.program.add_global(hir::Global {
            name: self.sources.text(address.span).to_ascii_uppercase(),
            ty,
            storage: Storage { area: area(address.area), offset: place.byte, bit },
            initial: Constant::Default,
            retention: hir::Retention::None,
            constant: false,
            location,
        });
        self.addresses.insert((address.area, place), id);
        Some((id, ty))
    }

    /// Gives every variable at `%I*`, `%Q*` or `%M*` a place behind those that are written.
    pub(super) fn place_floating(&mut self) {
        let floating = std::mem::take(&mut self.floating);
        let moving: HashSet<usize> = floating.iter().map(|(id, _)| id.0 as usize).collect();
        let mut ends = [0; 4];
        for (index, global) in self.program.globals.iter().enumerate() {
            if !moving.contains(&index) {
                let end = global.storage.offset + self.program.types.size(global.ty);
                let known = &mut ends[global.storage.area as usize];
                *known = end.max(*known);
            }
        }
        for (id, span) in floating {
            let global = self.program.global(id);
            let (area, ty) = (global.storage.area, global.ty);
            let align = self.program.types.align(ty).max(1);
            let behind = ends[area as usize].next_multiple_of(align);
            let end = u64::from(behind) + u64::from(self.program.types.size(ty));
            if end > 64 << 10 {
                self.error(Code::InvalidAddress, span, "no room is left in this image of 64 KiB");
                return;
            }
            ends[area as usize] = end as u32;
            self.program.globals[id.0 as usize].storage.offset = behind;
        }
    }

    /// Refuses two variables at one output.
    pub(super) fn refuse_shared_outputs(&mut self) {
        let mut places: Vec<(u64, u64, GlobalId, Span)> = Vec::new();
        for (id, span) in std::mem::take(&mut self.outputs) {
            let global = self.program.global(id);
            let start = u64::from(global.storage.offset) * 8;
            places.push(match global.storage.bit {
                Some(bit) => (start + u64::from(bit), start + u64::from(bit) + 1, id, span),
                None => {
                    (start, start + u64::from(self.program.types.size(global.ty)) * 8, id, span)
                }
            });
        }
        places.sort_by_key(|place| (place.0, place.1));
        for pair in places.windows(2) {
            let [first, second] = pair else { continue };
            if second.0 < first.1 {
                let name = &self.program.global(second.2).name;
                let found = format!("the output of `{name}` is a part of another variable's");
                self.tell(
                    Diagnostic::new(Code::AddressConflict, second.3, found)
                        .allowed("one variable for each output")
                        .related(first.3, "the other variable is here"),
                );
            }
        }
    }
}
