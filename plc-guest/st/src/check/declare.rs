//! The variables of a section of a unit.

use super::body::Body;
use super::types::Resolved;
use super::unit::{Storage, Variable};
use super::{Entry, Progress};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Area, Constant, Elementary, Local, LocalId, LocalKind, Retention, Section, Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Name, SectionKind, UnitKind};

impl<'a> Body<'_, 'a> {
    pub(super) fn section(&mut self, section: &'a ast::Section, structure: Option<TypeId>) {
        if section.kind == SectionKind::Global {
            self.tell(
                Diagnostic::new(Code::InvalidDeclaration, section.span, "VAR_GLOBAL within a unit")
                    .allowed("VAR_GLOBAL outside of units, in a file or a CONFIGURATION"),
            );
            return;
        }
        let in_program =
            self.unit.is_some_and(|unit| self.checker.units[unit].ast.kind == UnitKind::Program);
        if in_program && section.kind == SectionKind::InOut {
            // A task calls a program, and has no variable to hand on by reference.
            let one = Diagnostic::new(Code::NotSupported, section.span, "VAR_IN_OUT of a program");
            self.tell(one.allowed("VAR_INPUT and VAR_OUTPUT, or VAR_GLOBAL"));
        }
        let interface =
            matches!(section.kind, SectionKind::Input | SectionKind::Output | SectionKind::InOut);
        if self.in_test() && interface {
            let found = "parameters of a test, which nothing calls";
            let one = Diagnostic::new(Code::InvalidDeclaration, section.span, found);
            self.tell(one.allowed("VAR, VAR_TEMP and VAR_EXTERNAL"));
        }
        self.check_qualifiers(section, structure);
        for variables in &section.variables {
            if section.kind == SectionKind::External {
                for name in &variables.names {
                    self.external(section, variables, name);
                }
                continue;
            }
            let resolved = self.variable_type(variables);
            if let Some(resolved) = &resolved {
                self.check_variable_type(section, variables, resolved.ty);
            }
            for name in &variables.names {
                // Its body decides then what ENO is; else the call does.
                let eno = &*name.key == "ENO" && section.kind == SectionKind::Output;
                if eno && resolved.as_ref().is_some_and(|resolved| !self.is_bool(resolved.ty)) {
                    let found = "an ENO that is no BOOL";
                    self.error(Code::TypeMismatch, name.span, found);
                    continue;
                }
                if !eno && self.checker.refuse_reserved(name) {
                    continue;
                }
                self.one_variable(section, variables, name, resolved.clone(), structure);
            }
        }
    }

    fn is_bool(&self, ty: TypeId) -> bool {
        self.plain(ty) == Some(Elementary::Bool)
    }

    fn check_qualifiers(&mut self, section: &ast::Section, structure: Option<TypeId>) {
        if let Some((_, span)) = section.retention
            && (structure.is_none() || section.kind == SectionKind::Temporary)
        {
            let found = "retention of variables that do not outlive a call";
            self.error(Code::InvalidDeclaration, span, found);
        }
        if let (Some(constant), Some((_, span))) = (section.constant, section.retention) {
            self.tell(
                Diagnostic::new(Code::InvalidDeclaration, span, "retention of a constant")
                    .related(constant, "CONSTANT is here"),
            );
        }
        if let Some(span) = section.constant
            && !matches!(section.kind, SectionKind::Local | SectionKind::External)
        {
            let found = "CONSTANT for parameters or temporary variables";
            let one = Diagnostic::new(Code::InvalidDeclaration, span, found);
            self.tell(one.allowed("VAR CONSTANT, VAR_GLOBAL CONSTANT or VAR_EXTERNAL CONSTANT"));
        }
    }

    /// Refuses types that a kind of variable cannot have.
    fn check_variable_type(
        &mut self,
        section: &ast::Section,
        variables: &ast::Variables,
        ty: TypeId,
    ) {
        let types = &self.checker.program.types;
        let open = matches!(types.get(ty), Type::OpenArray { .. });
        let parameter =
            matches!(section.kind, SectionKind::Input | SectionKind::Output | SectionKind::InOut);
        if open && !parameter {
            let found = "ARRAY[*] for a variable that is no parameter";
            let one = Diagnostic::new(Code::InvalidDeclaration, variables.spec.span, found);
            self.tell(one.allowed("bounds, or ARRAY[*] for a parameter"));
        } else if open && !self.in_function() && section.kind != SectionKind::InOut {
            // A field keeps its value from call to call, and what has no bounds has no room for one.
            let what = match section.kind {
                SectionKind::Input => "VAR_INPUT",
                _ => "VAR_OUTPUT",
            };
            let found = format!("ARRAY[*] in {what} of a function block, program or test");
            let one = Diagnostic::new(Code::InvalidDeclaration, variables.spec.span, found);
            self.tell(one.allowed("bounds, or ARRAY[*] in VAR_IN_OUT of a FUNCTION_BLOCK"));
        }
        let lives = section.kind != SectionKind::Temporary
            && !(self.in_function() && section.kind != SectionKind::InOut);
        if !lives && self.checker.program.types.has_instance(ty) {
            self.short_lived_instance(variables.spec.span);
        }
        if let Some((_, span)) = variables.edge {
            let fits = self.scalar(ty) == Some(Elementary::Bool)
                && section.kind == SectionKind::Input
                && !self.in_function();
            if !fits {
                self.tell(
                    Diagnostic::new(Code::InvalidDeclaration, span, "the detection of an edge")
                        .allowed("BOOL in VAR_INPUT of a function block or program"),
                );
            }
        }
        if section.kind == SectionKind::InOut
            && let Some(initial) = &variables.initial
        {
            let found = "an initial value of a VAR_IN_OUT, which stands for another variable";
            self.error(Code::InvalidDeclaration, initial.span(), found);
        }
    }

    pub(super) fn short_lived_instance(&mut self, span: Span) {
        let found = "an instance of a function block that does not outlive a call";
        self.tell(
            Diagnostic::new(Code::InvalidDeclaration, span, found)
                .allowed("instances in VAR of programs and function blocks, or VAR_IN_OUT")
                .hint("a function block keeps its state from call to call"),
        );
    }

    fn one_variable(
        &mut self,
        section: &'a ast::Section,
        variables: &'a ast::Variables,
        name: &'a Name,
        resolved: Option<Resolved>,
        structure: Option<TypeId>,
    ) {
        let mut variable = Variable {
            name,
            ty: resolved.as_ref().map(|resolved| resolved.ty),
            kind: section.kind,
            storage: Storage::Nowhere,
            constant: section.constant.is_some(),
            initialised: variables.initial.is_some(),
            initial: Constant::Default,
            edge: variables.edge.map(|(edge, _)| edge),
            address: variables.address.as_ref(),
            read: false,
            written: false,
        };
        if let Some(resolved) = resolved {
            variable.initial = resolved.initial.clone();
            // Told here, and not once more for each instance.
            if let Some(address) = &variables.address
                && self.is_placed_by_instance(section, address)
                && !self.fits_place(variables, address, name, resolved.ty)
            {
                variable.address = None;
            }
            variable.storage = self.storage(section, variables, name, resolved, structure);
        }
        self.declare(variable);
    }

    fn storage(
        &mut self,
        section: &ast::Section,
        variables: &ast::Variables,
        name: &Name,
        resolved: Resolved,
        structure: Option<TypeId>,
    ) -> Storage {
        let Resolved { ty, initial } = resolved;
        if section.constant.is_some() {
            if variables.initial.is_none() {
                self.no_value(name);
            }
            let types = &self.checker.program.types;
            if types.scalar(ty).is_some() || types.is_string(ty) {
                let value = self.checker.constant_value(ty, initial);
                return Storage::Constant(ty, value);
            }
        }
        if let Some(address) = &variables.address
            && !self.is_placed_by_instance(section, address)
        {
            return self.located(section, address, name, Resolved { ty, initial });
        }
        // An array of any size is not copied, whatever it is for.
        let open = matches!(self.checker.program.types.get(ty), Type::OpenArray { .. });
        let kind = match section.kind {
            SectionKind::Input | SectionKind::Output if open => LocalKind::InOut,
            SectionKind::Input => LocalKind::Input,
            SectionKind::InOut => LocalKind::InOut,
            SectionKind::Output => LocalKind::Output,
            _ => LocalKind::Variable,
        };
        let of_the_call =
            section.kind == SectionKind::Temporary || kind == LocalKind::InOut && open;
        let Some(structure) = structure.filter(|_| !of_the_call) else {
            self.locals.push(Local { name: name.text.to_string(), ty, kind, initial });
            return Storage::Local(LocalId(self.locals.len() as u32 - 1));
        };
        let retention = match section.retention {
            Some((ast::Retention::NonRetain, _)) => Retention::Never,
            other => retention(other.map(|(retention, _)| retention)),
        };
        let part = match section.kind {
            SectionKind::Input => Section::Input,
            SectionKind::Output => Section::Output,
            SectionKind::InOut => Section::InOut,
            _ => Section::Variable,
        };
        if section.kind == SectionKind::InOut {
            let reference = self.checker.program.types.reference(ty);
            let field = self.checker.field(structure, name, reference.into(), part, retention);
            return field.map_or(Storage::Nowhere, |field| Storage::Reference(field, reference));
        }
        let field = self.checker.field(structure, name, Resolved { ty, initial }, part, retention);
        if variables.edge.is_some() && field.is_some() {
            // A name of images that no source can write: an older version has this variable by the same name.
            let last = Name::new(&format!("{}-last", name.text), name.span);
            // As R_TRIG and F_TRIG have it: the first call sees an edge if the input is as behind one.
            let falling = matches!(variables.edge, Some((ast::Edge::Falling, _)));
            let initial = Constant::Integer(falling.into());
            let last_type = Resolved { ty: self.elementary(Elementary::Bool), initial };
            self.checker.field(structure, &last, last_type, Section::Variable, retention);
        }
        field.map_or(Storage::Nowhere, Storage::Field)
    }

    fn no_value(&mut self, name: &Name) {
        let found = format!("the constant `{}` without a value", name.text);
        let one = Diagnostic::new(Code::InvalidDeclaration, name.span, found);
        self.tell(one.allowed("`name : TYPE := value;`"));
    }

    /// Whether each instance has a place of its own for the variable: at `%I*` and `%Q*` of a function block.
    fn is_placed_by_instance(&self, section: &ast::Section, address: &ast::Address) -> bool {
        let unit = self.unit.map(|unit| self.checker.units[unit].ast.kind);
        unit == Some(UnitKind::FunctionBlock)
            && section.kind == SectionKind::Local
            && address.place.is_none()
            && address.area != ast::Area::Marker
    }

    fn fits_place(
        &mut self,
        variables: &ast::Variables,
        address: &ast::Address,
        name: &Name,
        ty: TypeId,
    ) -> bool {
        if address.area == ast::Area::Input && variables.initial.is_some() {
            let found = "an initial value of an input, which comes from outside";
            self.error(Code::InvalidDeclaration, name.span, found);
            return false;
        }
        self.checker.check_width(address, ty).is_some()
    }

    /// A variable at an address: one for all instances, as the address is one.
    fn located(
        &mut self,
        section: &ast::Section,
        address: &ast::Address,
        name: &Name,
        resolved: Resolved,
    ) -> Storage {
        let unit = self.unit.map(|unit| self.checker.units[unit].ast);
        let program = unit.filter(|unit| unit.kind == UnitKind::Program);
        let (Some(program), SectionKind::Local) = (program, section.kind) else {
            self.tell(
                Diagnostic::new(Code::InvalidDeclaration, address.span, "an address here")
                    .allowed("AT in VAR of a PROGRAM, and in VAR_GLOBAL; `%I*` and `%Q*` in a FUNCTION_BLOCK")
                    .hint("give it to a function block as an input or output"),
            );
            return Storage::Nowhere;
        };
        let path = format!("{}.{}", program.name.text, name.text);
        let retention = retention(section.retention.map(|(retention, _)| retention));
        let global = self.checker.located(address, &path, name.span, resolved, retention);
        global.map_or(Storage::Nowhere, Storage::Global)
    }

    fn external(
        &mut self,
        section: &'a ast::Section,
        variables: &'a ast::Variables,
        name: &'a Name,
    ) {
        if let Some(initial) = &variables.initial {
            let found = "an initial value of a VAR_EXTERNAL";
            let one = Diagnostic::new(Code::InvalidDeclaration, initial.span(), found);
            self.tell(one.hint("the VAR_GLOBAL gives it"));
        }
        let ty = self.type_spec(&variables.spec, None).map(|resolved| resolved.ty);
        let mut storage = Storage::Nowhere;
        match self.checker.names.get(&name.key) {
            Some(Entry::Global(global)) => storage = Storage::External(*global),
            _ => {
                let found = format!("there is no global variable `{}`", name.text);
                let one = Diagnostic::new(Code::UnknownName, name.span, found);
                self.tell(one.allowed("the name of a variable in a VAR_GLOBAL section"));
            }
        }
        let index = self.variables.len();
        self.declare(Variable {
            name,
            ty,
            kind: SectionKind::External,
            storage: storage.clone(),
            constant: section.constant.is_some(),
            initialised: true,
            initial: Constant::Default,
            edge: None,
            address: None,
            read: false,
            written: false,
        });
        // Constants are needed by the declarations that follow.
        if let Storage::External(global) = storage
            && section.constant.is_some()
            && self.variables.len() > index
        {
            self.resolve_external(index, global);
        }
    }

    pub(super) fn resolve_external(&mut self, index: usize, global: usize) {
        let name = self.variables[index].name;
        self.checker.resolve_global(global, name.span);
        let entry = &self.checker.globals[global];
        let (span, found) = (entry.name.span, entry.ty);
        let constant = entry.section.constant.is_some();
        self.variables[index].storage = match (&entry.constant, entry.id) {
            _ if entry.progress != Progress::Done => Storage::Nowhere,
            (Some(value), _) => Storage::Constant(value.0, value.1.clone()),
            (None, Some(id)) => Storage::Global(id),
            (None, None) => Storage::Nowhere,
        };
        if let (Some(declared), Some(found)) = (self.variables[index].ty, found)
            && declared != found
        {
            let text = format!(
                "`{}` is declared as {} and is {}",
                name.text,
                self.type_name(declared),
                self.type_name(found)
            );
            self.tell(
                Diagnostic::new(Code::TypeMismatch, name.span, text)
                    .related(span, "the global variable is declared here"),
            );
            self.variables[index].storage = Storage::Nowhere;
        }
        self.variables[index].constant |= constant;
    }
}

pub(super) fn retention(written: Option<ast::Retention>) -> Retention {
    match written {
        Some(ast::Retention::Retain) => Retention::Retain,
        Some(ast::Retention::Persistent) => Retention::Persistent,
        Some(ast::Retention::NonRetain) | None => Retention::None,
    }
}

/// The area of an address.
pub(super) fn area(area: ast::Area) -> Area {
    match area {
        ast::Area::Input => Area::Input,
        ast::Area::Output => Area::Output,
        ast::Area::Marker => Area::Marker,
    }
}
