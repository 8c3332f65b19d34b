//! Takes note of declarations: first of the names at the top, so that their order does not count, then of
//! their parts.

use super::{Index, Shape, Symbol, SymbolId, SymbolKind, Use};
use crate::check::known;
use crate::source::Span;
use crate::syntax::ast::{
    ArrayRange, Configuration, Declaration, EnumerationValue, Expression, File, Name, Section,
    SectionKind, TypeDeclaration, TypeKind, TypeSpec, Unit, UnitKind, Variables,
};

/// The names at the top of a file.
pub(super) fn names(index: &mut Index, tree: &File, library: bool) {
    let mut declare = Declare { index, library };
    for declaration in &tree.declarations {
        match declaration {
            Declaration::Type(one) => {
                let kind = match one.spec.kind {
                    TypeKind::Enumeration { .. } => SymbolKind::Enumeration,
                    TypeKind::Structure { .. } => SymbolKind::Structure,
                    _ => SymbolKind::Type,
                };
                declare.top(&one.name, kind, one.span);
            }
            Declaration::Unit(unit) => {
                declare.unit(unit);
            }
            Declaration::Globals(section) => declare.globals(section, None),
            Declaration::Configuration(configuration) => declare.configuration(configuration),
        }
    }
}

/// What the declarations of a file consist of.
pub(super) fn parts(index: &mut Index, tree: &File, library: bool) {
    let mut declare = Declare { index, library };
    for declaration in &tree.declarations {
        match declaration {
            Declaration::Type(one) => declare.type_parts(one),
            Declaration::Unit(unit) => declare.unit_parts(unit),
            Declaration::Globals(section) => declare.global_types(section),
            Declaration::Configuration(configuration) => {
                for section in &configuration.globals {
                    declare.global_types(section);
                }
                for section in configuration.resources.iter().flat_map(|one| &one.globals) {
                    declare.global_types(section);
                }
            }
        }
    }
}

struct Declare<'i> {
    index: &'i mut Index,
    library: bool,
}

impl Declare<'_> {
    fn add(&mut self, mut symbol: Symbol, container: Option<SymbolId>) -> SymbolId {
        let id = SymbolId(self.index.symbols.len() as u32);
        symbol.library = self.library;
        symbol.container = container;
        if let Some(container) = container {
            self.index.symbols[container.0 as usize].members.push(id);
        }
        if !symbol.name.is_empty() {
            self.index.declared.insert(symbol.span, id);
            if symbol.kind != SymbolKind::Unit(UnitKind::Test) {
                self.index.uses.push(Use { span: symbol.span, symbol: id, certain: true });
            }
        }
        self.index.symbols.push(symbol);
        id
    }

    fn unit(&mut self, unit: &Unit) {
        let (name, kind) = (&unit.name, SymbolKind::Unit(unit.kind));
        if unit.kind == UnitKind::Test {
            // Its name is a text, which nothing can use.
            self.add(Symbol::new(&name.text, kind, name.span, unit.span), None);
        } else {
            self.top(name, kind, unit.span);
        }
    }

    fn top(&mut self, name: &Name, kind: SymbolKind, extent: Span) -> SymbolId {
        let id = self.add(Symbol::new(&name.text, kind, name.span, extent), None);
        self.visible(name, id);
        id
    }

    fn visible(&mut self, name: &Name, id: SymbolId) {
        let names = if self.library { &mut self.index.library } else { &mut self.index.own };
        names.entry(name.key.to_string()).or_default().push(id);
    }

    fn globals(&mut self, section: &Section, container: Option<SymbolId>) {
        for variables in &section.variables {
            for name in &variables.names {
                let symbol = variable(section, variables, name);
                let id = self.add(symbol, container);
                self.visible(name, id);
            }
        }
    }

    fn configuration(&mut self, configuration: &Configuration) {
        let name = &configuration.name;
        let kind = SymbolKind::Configuration;
        let id = self.add(Symbol::new(&name.text, kind, name.span, configuration.span), None);
        for section in &configuration.globals {
            self.globals(section, Some(id));
        }
        for resource in &configuration.resources {
            let within = match &resource.name {
                Some((name, _)) => {
                    let kind = SymbolKind::Resource;
                    self.add(Symbol::new(&name.text, kind, name.span, resource.span), Some(id))
                }
                None => id,
            };
            for section in &resource.globals {
                self.globals(section, Some(within));
            }
            for task in &resource.tasks {
                let symbol =
                    Symbol::new(&task.name.text, SymbolKind::Task, task.name.span, task.span);
                self.add(symbol, Some(within));
            }
            for one in &resource.programs {
                let symbol =
                    Symbol::new(&one.name.text, SymbolKind::Instance, one.name.span, one.span);
                self.add(symbol, Some(within));
            }
        }
    }

    fn type_parts(&mut self, one: &TypeDeclaration) {
        let Some(id) = self.index.declared.get(&one.name.span).copied() else { return };
        self.index.symbols[id.0 as usize].spec = Some(one.spec.span);
        match &one.spec.kind {
            TypeKind::Enumeration { base, values } => {
                self.base(base.as_ref());
                self.enumerators(values, id);
            }
            TypeKind::Structure { fields } => {
                for variables in fields {
                    let shape = self.shape(&variables.spec);
                    for name in &variables.names {
                        let mut symbol =
                            Symbol::new(&name.text, SymbolKind::Field, name.span, variables.span);
                        symbol.shape = shape.clone();
                        symbol.spec = Some(variables.spec.span);
                        symbol.initial = variables.initial.as_ref().map(|initial| initial.span());
                        self.add(symbol, Some(id));
                    }
                }
            }
            _ => {
                let shape = self.shape(&one.spec);
                self.index.symbols[id.0 as usize].shape = shape;
            }
        }
    }

    fn enumerators(&mut self, values: &[EnumerationValue], of: SymbolId) {
        for value in values {
            let name = &value.name;
            let number = value.value.as_ref().map(|number| number.span);
            let extent = number.map_or(name.span, |number| name.span.to(number));
            let mut symbol = Symbol::new(&name.text, SymbolKind::Enumerator, name.span, extent);
            symbol.shape = Shape::Declared(of);
            symbol.initial = number;
            let id = self.add(symbol, Some(of));
            self.index.enumerators.entry(name.key.to_string()).or_default().push(id);
        }
    }

    fn unit_parts(&mut self, unit: &Unit) {
        let Some(id) = self.index.declared.get(&unit.name.span).copied() else { return };
        if let Some(result) = &unit.result {
            let shape = self.shape(result);
            let symbol = &mut self.index.symbols[id.0 as usize];
            (symbol.shape, symbol.spec) = (shape, Some(result.span));
        }
        for section in &unit.sections {
            for variables in &section.variables {
                let shape = self.shape(&variables.spec);
                for name in &variables.names {
                    let part = match self.external(section, name) {
                        Some(global) => global,
                        None => {
                            let mut symbol = variable(section, variables, name);
                            symbol.shape = shape.clone();
                            self.add(symbol, Some(id))
                        }
                    };
                    let scope = self.index.scopes.entry(id).or_default();
                    scope.entry(name.key.to_string()).or_insert(part);
                }
            }
        }
    }

    /// VAR_EXTERNAL declares nothing new: its name is a use of the global variable.
    fn external(&mut self, section: &Section, name: &Name) -> Option<SymbolId> {
        if section.kind != SectionKind::External {
            return None;
        }
        let global = self.index.top(&name.key, self.library)?.first().copied()?;
        let kind = self.index.symbol(global).kind;
        if kind != SymbolKind::Variable(SectionKind::Global) {
            return None;
        }
        self.index.uses.push(Use { span: name.span, symbol: global, certain: true });
        Some(global)
    }

    fn global_types(&mut self, section: &Section) {
        for variables in &section.variables {
            let shape = self.shape(&variables.spec);
            for name in &variables.names {
                if let Some(id) = self.index.declared.get(&name.span) {
                    self.index.symbols[id.0 as usize].shape = shape.clone();
                }
            }
        }
    }

    fn base(&mut self, base: Option<&Name>) {
        if let Some(base) = base {
            self.named(base);
        }
    }

    fn named(&mut self, name: &Name) -> Shape {
        let Some(id) = self.index.top(&name.key, self.library).and_then(<[_]>::first).copied()
        else {
            if !known::is_type(&name.key) {
                self.index.unknown.push(name.span);
            }
            return Shape::Plain;
        };
        self.index.uses.push(Use { span: name.span, symbol: id, certain: true });
        match self.index.symbol(id).kind {
            SymbolKind::Variable(_) => Shape::Plain,
            _ => Shape::Declared(id),
        }
    }

    fn shape(&mut self, spec: &TypeSpec) -> Shape {
        match &spec.kind {
            TypeKind::Named(name) => self.named(name),
            TypeKind::Array { ranges, element } => {
                let element = self.shape(element);
                Shape::Array(ranges.len(), Box::new(element))
            }
            TypeKind::Reference(target) => Shape::Reference(Box::new(self.shape(target))),
            TypeKind::Subrange { base, .. } => {
                self.base(Some(base));
                Shape::Plain
            }
            TypeKind::Enumeration { base, values } => {
                self.base(base.as_ref());
                let symbol =
                    Symbol::new("", SymbolKind::Enumeration, spec.span.before(), spec.span);
                let id = self.add(symbol, None);
                self.enumerators(values, id);
                Shape::Declared(id)
            }
            // A structure without a name is refused.
            TypeKind::Text { .. } | TypeKind::Structure { .. } | TypeKind::Error => Shape::Plain,
        }
    }
}

fn variable(section: &Section, variables: &Variables, name: &Name) -> Symbol {
    let kind = SymbolKind::Variable(section.kind);
    let mut symbol = Symbol::new(&name.text, kind, name.span, variables.span);
    symbol.spec = Some(variables.spec.span);
    symbol.address = variables.address.as_ref().map(|address| address.span);
    symbol.initial = variables.initial.as_ref().map(|initial| initial.span());
    symbol.constant = section.constant.is_some();
    symbol
}

/// The expressions of the bounds of an array.
pub(super) fn bounds(ranges: &[ArrayRange]) -> impl Iterator<Item = &Expression> {
    ranges.iter().flat_map(|range| match range {
        ArrayRange::Fixed(bounds) => vec![&bounds.0, &bounds.1],
        ArrayRange::Open(_) => Vec::new(),
    })
}
