//! Variables whose places are chosen outside of their unit: `AT %I*` and the like, and VAR_CONFIG, which gives them
//! an address (IEC 61131-3:2013, section 6.8.2).
//!
//! One of a program or of VAR_GLOBAL is one variable in the image, whichever instance uses it. One of a function block
//! is a variable of each instance: its field has the input's value when the program of the instance begins, and what it
//! has at the program's end is the output. Without VAR_CONFIG the compiler chooses a place.

use std::collections::{HashMap, HashSet};

use super::Checker;
use super::body::Body;
use super::names::similar;
use super::types::Resolved;
use super::unit::Storage;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Constant, Expr, ExprKind, GlobalId, Location, Place, Retention, Statement, StatementKind, Type,
    TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{self, Expression, ExpressionKind};

/// More than the images have bytes.
const MOST: usize = 64 << 10;

/// VAR_CONFIG by the paths of its variables, in capitals.
pub(super) type Placements<'a> = HashMap<String, Placement<'a>>;

/// One line of VAR_CONFIG.
pub(super) struct Placement<'a> {
    ast: &'a ast::Placement,
    address: &'a ast::Address,
    used: bool,
}

/// A variable of an instance of a function block.
struct Leaf<'a> {
    /// Its path from the program's instance.
    path: String,
    place: Place,
    address: &'a ast::Address,
    initial: Constant,
    span: Span,
}

impl<'a> Checker<'a> {
    /// Reads VAR_CONFIG.
    pub(super) fn placements(&mut self, configuration: &'a ast::Configuration) -> Placements<'a> {
        let mut known: Placements<'a> = HashMap::new();
        for one in &configuration.placements {
            if let Some(initial) = &one.initial {
                let found = "an initial value in VAR_CONFIG, which this compiler does not have";
                let diagnostic = Diagnostic::new(Code::NotSupported, initial.span(), found);
                self.tell(diagnostic.allowed("`instance.variable AT %QX0.0 : BOOL;`"));
            }
            let Some(path) = self.path(&one.path) else { continue };
            // The path may begin with the resource.
            let of_resource = configuration.resources.iter().find_map(|resource| {
                let (name, _) = resource.name.as_ref()?;
                path.strip_prefix(&*name.key)?.strip_prefix('.')
            });
            let path = of_resource.unwrap_or(&path).to_owned();
            let Some(address) = one.address.as_ref().filter(|address| address.place.is_some())
            else {
                let found = "a variable of VAR_CONFIG without an address";
                let diagnostic = Diagnostic::new(Code::InvalidAddress, one.span, found);
                self.tell(diagnostic.allowed("`instance.variable AT %QX0.0 : BOOL;`"));
                continue;
            };
            if let Some(first) = known.get(&path) {
                let first = first.ast.path.span;
                let found = "a second address of this variable";
                let diagnostic = Diagnostic::new(Code::DuplicateName, one.path.span, found);
                self.tell(diagnostic.related(first, "the first is here"));
                continue;
            }
            known.insert(path, Placement { ast: one, address, used: false });
        }
        known
    }

    /// A path of names and constant indices, in capitals.
    fn path(&mut self, path: &'a Expression) -> Option<String> {
        match &path.kind {
            ExpressionKind::Name(name) => Some(name.key.to_string()),
            ExpressionKind::Field(base, name) => Some(format!("{}.{}", self.path(base)?, name.key)),
            ExpressionKind::Index(base, indices) => {
                let mut text = self.path(base)?;
                for index in indices {
                    let number = Body::of_constants(self).constant_integer(index)?;
                    text.push_str(&format!("[{number}]"));
                }
                Some(text)
            }
            ExpressionKind::Error => None,
            _ => {
                let one = Diagnostic::new(Code::Syntax, path.span, "a path of another form");
                self.tell(one.allowed("`instance.variable`, `instance.block.variable`"));
                None
            }
        }
    }

    /// Gives the variables of an instance of a program their places. Returns what its task does before its body and
    /// behind it.
    pub(super) fn place_instance(
        &mut self,
        name: &ast::Name,
        unit: usize,
        global: GlobalId,
        ty: TypeId,
        placements: &mut Placements<'a>,
    ) -> (Vec<Statement>, Vec<Statement>) {
        self.place_own(name, unit, placements);
        let mut leaves = Vec::new();
        let root = Place::global(global, ty);
        self.leaves(ty, root, String::new(), &mut leaves);
        let (mut before, mut behind) = (Vec::new(), Vec::new());
        if leaves.len() > MOST {
            let found = format!("more than {MOST} variables with addresses in an instance");
            self.error(Code::InvalidAddress, name.span, found);
            return (before, behind);
        }
        for leaf in leaves {
            let path = format!("{}.{}", name.key, leaf.path.to_ascii_uppercase());
            let written = self.written(&path, leaf.place.ty, leaf.address, placements);
            let shown = format!("{}.{}", name.text, leaf.path);
            let span = written.map_or(leaf.span, |address| address.span);
            let resolved = Resolved { ty: leaf.place.ty, initial: leaf.initial };
            let address = written.unwrap_or(leaf.address);
            let Some(id) = self.located(address, &shown, span, resolved, Retention::None) else {
                continue;
            };
            let location = self.location(leaf.span);
            let outside = Place::global(id, leaf.place.ty);
            let copy = |to: &Place, from: &Place| {
                let value = Expr::new(from.ty, ExprKind::Load(from.clone()), location);
                Statement { kind: StatementKind::Assign(to.clone(), value), location }
            };
            match leaf.address.area {
                ast::Area::Input => before.push(copy(&leaf.place, &outside)),
                _ => behind.push(copy(&outside, &leaf.place)),
            }
        }
        (before, behind)
    }

    /// The variables of the program itself, which all of its instances share.
    fn place_own(&mut self, name: &ast::Name, unit: usize, placements: &mut Placements<'a>) {
        for index in 0..self.units[unit].variables.len() {
            let variable = &self.units[unit].variables[index];
            let (Storage::Global(id), Some(declared)) = (&variable.storage, variable.address)
            else {
                continue;
            };
            let (id, key) = (*id, variable.name.key.clone());
            if declared.place.is_some() {
                continue;
            }
            let path = format!("{}.{key}", name.key);
            let ty = self.program.global(id).ty;
            let Some(address) = self.written(&path, ty, declared, placements) else { continue };
            let Some(at) = self.floating.iter().position(|(floating, _)| *floating == id) else {
                let found =
                    "a second address of a variable that all instances of its program share";
                let one = Diagnostic::new(Code::AddressConflict, address.span, found);
                self.tell(
                    one.hint("make it a VAR_INPUT or VAR_OUTPUT, and connect it for each instance"),
                );
                continue;
            };
            let Some(storage) = self.storage_at(address, ty) else { continue };
            self.floating.remove(at);
            self.program.globals[id.0 as usize].storage = storage;
            if address.area == ast::Area::Output {
                self.outputs.push((id, address.span));
            }
        }
    }

    /// The address that VAR_CONFIG gives a variable of this type, if it does.
    fn written(
        &mut self,
        path: &str,
        ty: TypeId,
        declared: &ast::Address,
        placements: &mut Placements<'a>,
    ) -> Option<&'a ast::Address> {
        let placement = placements.get_mut(path)?;
        placement.used = true;
        let (one, address) = (placement.ast, placement.address);
        let written = Body::of_constants(self).type_spec(&one.spec, None)?;
        if written.ty != ty {
            let found =
                format!("{} in VAR_CONFIG for {}", self.type_name(written.ty), self.type_name(ty));
            let diagnostic = Diagnostic::new(Code::TypeMismatch, one.spec.span, found);
            self.tell(diagnostic.related(declared.span, "the variable is declared here"));
            return None;
        }
        if address.area != declared.area {
            let (here, there) = (self.sources.text(address.span), self.sources.text(declared.span));
            let found = format!("`{here}` for a variable at `{there}`");
            let diagnostic = Diagnostic::new(Code::InvalidAddress, address.span, found);
            self.tell(diagnostic.related(declared.span, "the variable is declared here"));
            return None;
        }
        Some(address)
    }

    /// The variables with addresses in instances of function blocks below a place.
    fn leaves(&self, ty: TypeId, place: Place, path: String, into: &mut Vec<Leaf<'a>>) {
        if into.len() > MOST || !self.has_leaves(ty) {
            return;
        }
        let dot = if path.is_empty() { "" } else { "." };
        match self.program.types.get(ty) {
            Type::Array { element, lower, upper } => {
                for index in *lower..=*upper {
                    if into.len() > MOST {
                        return;
                    }
                    let number = ExprKind::Constant(Constant::Integer(index.into()));
                    let number = Expr::new(self.index_type, number, Location::default());
                    let place = place.clone().index(number, *element);
                    self.leaves(*element, place, format!("{path}[{index}]"), into);
                }
            }
            Type::Structure(structure) => {
                for (index, field) in structure.fields.iter().enumerate() {
                    let inner = place.clone().field(index as u32, field.ty);
                    let path = format!("{path}{dot}{}", field.name);
                    self.leaves(field.ty, inner, path, into);
                }
                let Some(unit) = self.blocks.get(&ty) else { return };
                for variable in &self.units[*unit].variables {
                    if let (Some(address), Storage::Field(field), Some(ty)) =
                        (variable.address, &variable.storage, variable.ty)
                    {
                        into.push(Leaf {
                            path: format!("{path}{dot}{}", variable.name.text),
                            place: place.clone().field(*field, ty),
                            address,
                            initial: variable.initial.clone(),
                            span: variable.name.span,
                        });
                    }
                }
            }
            _ => {}
        }
    }

    /// Whether a variable of this type contains an instance with an address.
    fn has_leaves(&self, ty: TypeId) -> bool {
        self.leads_to_leaves(ty, &mut HashSet::new())
    }

    /// The same, but for what was seen: a type that is in many others is looked at once.
    fn leads_to_leaves(&self, ty: TypeId, seen: &mut HashSet<TypeId>) -> bool {
        if !seen.insert(ty) {
            return false;
        }
        match self.program.types.get(ty) {
            Type::Array { element, .. } => self.leads_to_leaves(*element, seen),
            Type::Structure(structure) => {
                let own = self.blocks.get(&ty).is_some_and(|unit| {
                    let located = |variable: &super::unit::Variable<'_>| {
                        variable.address.is_some() && matches!(variable.storage, Storage::Field(_))
                    };
                    self.units[*unit].variables.iter().any(located)
                });
                own || structure.fields.iter().any(|field| self.leads_to_leaves(field.ty, seen))
            }
            _ => false,
        }
    }

    /// Refuses lines of VAR_CONFIG that name no variable, and instances that belong to no program.
    pub(super) fn refuse_unplaced(&mut self, placements: &Placements<'a>) {
        let mut unused: Vec<(&String, &Placement<'a>)> =
            placements.iter().filter(|(_, placement)| !placement.used).collect();
        unused.sort_by_key(|(_, placement)| placement.ast.span.start);
        for (path, placement) in unused {
            let text = self.sources.text(placement.ast.path.span);
            let found = format!("no instance has a variable `{text}` at `%I*`, `%Q*` or `%M*`");
            let mut one = Diagnostic::new(Code::UnknownName, placement.ast.path.span, found)
                .allowed("`instance.variable`, with the names of a PROGRAM of this CONFIGURATION");
            let placed = placements.iter().filter(|(_, other)| other.used).map(|(path, _)| &**path);
            if let Some(similar) = similar(path, placed) {
                one = one.hint(format!("`{similar}` is one"));
            }
            self.tell(one);
        }
    }

    /// Refuses instances in VAR_GLOBAL that have addresses: they belong to no program that could fetch their inputs.
    pub(super) fn refuse_global_leaves(&mut self) {
        for index in 0..self.globals.len() {
            let entry = &self.globals[index];
            if entry.ty.is_some_and(|ty| self.has_leaves(ty)) {
                let found = format!(
                    "`{}`, an instance with variables at addresses, in VAR_GLOBAL",
                    entry.name.text
                );
                let one = Diagnostic::new(Code::InvalidDeclaration, entry.name.span, found);
                self.tell(one.allowed("VAR of a PROGRAM, whose task fetches the inputs"));
            }
        }
    }
}
