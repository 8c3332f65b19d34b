//! Takes note of uses: what each name in an expression, a statement or an initial value means.

use super::declare::bounds;
use super::{Index, Shape, SymbolId, SymbolKind, Use};
use crate::check::known;
use crate::source::Span;
use crate::syntax::ast::{
    Argument, ArrayElement, BinaryOperator, Configuration, Declaration, Expression, ExpressionKind,
    File, ForLoop, Initial, Label, Name, Resource, SectionKind, Statement, StatementKind, TypeKind,
    TypeSpec, Variables,
};

/// The uses in one file. All declarations are known.
pub(super) fn uses(index: &mut Index, tree: &File, library: bool) {
    for declaration in &tree.declarations {
        let mut resolve = Resolve { index, library, unit: None };
        match declaration {
            Declaration::Type(one) => {
                resolve.spec(&one.spec);
                let shape = resolve.declared(one.name.span);
                resolve.initial(one.initial.as_ref(), &shape);
            }
            Declaration::Unit(unit) => {
                resolve.unit = resolve.index.declared.get(&unit.name.span).copied();
                if let Some(result) = &unit.result {
                    resolve.spec(result);
                }
                for variables in unit.sections.iter().flat_map(|section| &section.variables) {
                    resolve.variables(variables);
                }
                resolve.block(&unit.body);
            }
            Declaration::Globals(section) => {
                section.variables.iter().for_each(|variables| resolve.variables(variables));
            }
            Declaration::Configuration(configuration) => {
                let globals = configuration.globals.iter();
                let globals =
                    globals.chain(configuration.resources.iter().flat_map(|r| &r.globals));
                for variables in globals.flat_map(|section| &section.variables) {
                    resolve.variables(variables);
                }
                for one in &configuration.placements {
                    resolve.placed(&one.path, configuration);
                    resolve.spec(&one.spec);
                }
                configuration.resources.iter().for_each(|resource| resolve.resource(resource));
            }
        }
    }
}

struct Resolve<'i> {
    index: &'i mut Index,
    library: bool,
    unit: Option<SymbolId>,
}

impl Resolve<'_> {
    fn note(&mut self, span: Span, symbol: SymbolId) {
        self.index.uses.push(Use { span, symbol, certain: true });
    }

    fn unknown(&mut self, name: &Name) {
        self.index.unknown.push(name.span);
    }

    /// What the variables of a declaration at this name are.
    fn declared(&self, name: Span) -> Shape {
        self.index.declared.get(&name).map_or(Shape::Plain, |id| Shape::Declared(*id))
    }

    fn variables(&mut self, variables: &Variables) {
        self.spec(&variables.spec);
        let id = variables.names.first().and_then(|name| self.index.declared.get(&name.span));
        let shape = id.map_or(Shape::Plain, |id| self.index.symbol(*id).shape.clone());
        self.initial(variables.initial.as_ref(), &shape);
    }

    /// The constants of a type as it is written.
    fn spec(&mut self, spec: &TypeSpec) {
        match &spec.kind {
            TypeKind::Text { length: Some(length), .. } => {
                self.value(length);
            }
            TypeKind::Array { ranges, element } => {
                for bound in bounds(ranges) {
                    self.value(bound);
                }
                self.spec(element);
            }
            TypeKind::Reference(target) => self.spec(target),
            TypeKind::Subrange { low, high, .. } => {
                self.value(low);
                self.value(high);
            }
            TypeKind::Enumeration { values, .. } => {
                for number in values.iter().filter_map(|value| value.value.as_ref()) {
                    self.value(number);
                }
            }
            TypeKind::Structure { fields } => {
                for field in fields {
                    self.variables(field);
                }
            }
            TypeKind::Named(_) | TypeKind::Text { length: None, .. } | TypeKind::Error => {}
        }
    }

    fn initial(&mut self, initial: Option<&Initial>, shape: &Shape) {
        match initial {
            None => {}
            Some(Initial::Value(value)) => {
                let shape = self.innermost(shape);
                self.expression(value, Some(&shape));
            }
            Some(Initial::Array(elements, _)) => {
                let shape = self.innermost(shape);
                for element in elements {
                    match element {
                        ArrayElement::One(one) => self.initial(Some(one), &shape),
                        ArrayElement::Repeated(count, all) => {
                            self.value(count);
                            all.iter().for_each(|one| self.initial(Some(one), &shape));
                        }
                    }
                }
            }
            Some(Initial::Structure(parts, _)) => {
                let shape = self.innermost(shape);
                for (name, part) in parts {
                    let shape = self.part(&shape, name);
                    self.initial(Some(part), &shape);
                }
            }
        }
    }

    /// What the elements of an array are, however many dimensions and arrays there are.
    fn innermost(&self, shape: &Shape) -> Shape {
        let mut shape = self.index.without_names(shape);
        while let Shape::Array(_, element) = &shape {
            shape = self.index.without_names(element);
        }
        shape
    }

    /// A part by its name.
    fn part(&mut self, of: &Shape, name: &Name) -> Shape {
        let Some(id) = self.index.member(of, &name.key) else {
            self.unknown(name);
            return Shape::Plain;
        };
        self.note(name.span, id);
        self.index.symbol(id).shape.clone()
    }

    fn resource(&mut self, resource: &Resource) {
        for task in &resource.tasks {
            for (_, value) in &task.properties {
                self.value(value);
            }
        }
        for instance in &resource.programs {
            if let Some(task) = &instance.task {
                let known = resource.tasks.iter().find(|known| known.name.key == task.key);
                match known.and_then(|known| self.index.declared.get(&known.name.span)) {
                    Some(id) => self.note(task.span, *id),
                    None => self.unknown(task),
                }
            }
            let program = self.index.top(&instance.program.key, self.library);
            match program.and_then(<[_]>::first).copied() {
                Some(id) => {
                    self.note(instance.program.span, id);
                    self.arguments(&[id], &instance.arguments, None);
                }
                None => {
                    self.unknown(&instance.program);
                    self.arguments(&[], &instance.arguments, None);
                }
            }
        }
    }

    /// A path of VAR_CONFIG, which begins with an instance or its resource.
    fn placed(&mut self, path: &Expression, configuration: &Configuration) -> Shape {
        let resource = |key: &str| {
            let mut named = configuration.resources.iter().filter_map(|one| one.name.as_ref());
            named.find(|(name, _)| &*name.key == key).map(|(name, _)| name.span)
        };
        match &path.kind {
            ExpressionKind::Name(name) => {
                let mut programs = configuration.resources.iter().flat_map(|one| &one.programs);
                let Some(instance) = programs.find(|one| one.name.key == name.key) else {
                    let id = resource(&name.key)
                        .and_then(|span| self.index.declared.get(&span).copied());
                    match id {
                        Some(id) => self.note(name.span, id),
                        None => self.unknown(name),
                    }
                    return Shape::Plain;
                };
                if let Some(id) = self.index.declared.get(&instance.name.span).copied() {
                    self.note(name.span, id);
                }
                let program = self.index.top(&instance.program.key, self.library);
                let program = program.and_then(<[_]>::first).copied();
                program.map_or(Shape::Plain, Shape::Declared)
            }
            ExpressionKind::Field(base, name) => {
                let of_resource = matches!(&base.kind, ExpressionKind::Name(first)
                    if resource(&first.key).is_some());
                let shape = self.placed(base, configuration);
                if of_resource {
                    let instance = Expression::new(ExpressionKind::Name(name.clone()), name.span);
                    return self.placed(&instance, configuration);
                }
                self.part(&shape, name)
            }
            ExpressionKind::Index(base, indices) => {
                let shape = self.placed(base, configuration);
                indices.iter().for_each(|index| drop(self.value(index)));
                self.index.element(&shape, indices.len())
            }
            _ => Shape::Plain,
        }
    }

    fn block(&mut self, block: &[Statement]) {
        block.iter().for_each(|statement| self.statement(statement));
    }

    fn statement(&mut self, statement: &Statement) {
        match &statement.kind {
            StatementKind::Assign { target, value, .. } => {
                let shape = self.value(target);
                self.expression(value, Some(&shape));
            }
            StatementKind::Call(call) => {
                self.value(call);
            }
            StatementKind::If { branches, otherwise } => {
                for (condition, block) in branches {
                    self.value(condition);
                    self.block(block);
                }
                self.block(otherwise.as_deref().unwrap_or_default());
            }
            StatementKind::Case { selector, branches, otherwise } => {
                let shape = self.value(selector);
                for (labels, block) in branches {
                    for label in labels {
                        match label {
                            Label::One(one) => {
                                self.expression(one, Some(&shape));
                            }
                            Label::Range(low, high) => {
                                self.expression(low, Some(&shape));
                                self.expression(high, Some(&shape));
                            }
                        }
                    }
                    self.block(block);
                }
                self.block(otherwise.as_deref().unwrap_or_default());
            }
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                self.name(variable, None);
                self.value(from);
                self.value(to);
                by.iter().for_each(|by| drop(self.value(by)));
                self.block(body);
            }
            StatementKind::While(condition, body) => {
                self.value(condition);
                self.block(body);
            }
            StatementKind::Repeat(body, condition) => {
                self.block(body);
                self.value(condition);
            }
            StatementKind::Exit
            | StatementKind::Continue
            | StatementKind::Return
            | StatementKind::Error => {}
        }
    }

    fn value(&mut self, expression: &Expression) -> Shape {
        self.expression(expression, None)
    }

    /// An expression where a value of the type `needed` stands. What it is itself.
    fn expression(&mut self, expression: &Expression, needed: Option<&Shape>) -> Shape {
        match &expression.kind {
            ExpressionKind::Name(name) => self.name(name, needed),
            ExpressionKind::EnumerationValue(names) => {
                let (ty, value) = &**names;
                let Some(id) =
                    self.index.top(&ty.key, self.library).and_then(<[_]>::first).copied()
                else {
                    self.unknown(ty);
                    return Shape::Plain;
                };
                self.note(ty.span, id);
                self.part(&Shape::Declared(id), value)
            }
            ExpressionKind::Field(base, name) => {
                let shape = self.value(base);
                self.part(&shape, name)
            }
            ExpressionKind::Index(base, indices) => {
                let shape = self.value(base);
                indices.iter().for_each(|index| drop(self.value(index)));
                self.index.element(&shape, indices.len())
            }
            ExpressionKind::Dereference(base) => {
                let shape = self.value(base);
                self.index.target(&shape)
            }
            ExpressionKind::Part(base, ..) => {
                self.value(base);
                Shape::Plain
            }
            ExpressionKind::Unary(_, inner) | ExpressionKind::Parenthesised(inner) => {
                self.expression(inner, needed)
            }
            ExpressionKind::Binary(operator, _, left, right) => {
                self.binary(*operator, left, right, needed);
                Shape::Plain
            }
            ExpressionKind::Call(callee, arguments) => self.call(callee, arguments, needed),
            ExpressionKind::Literal(_) | ExpressionKind::Address(_) | ExpressionKind::Error => {
                Shape::Plain
            }
        }
    }

    /// Of a comparison one side may tell which enumeration the other is of.
    fn binary(
        &mut self,
        operator: BinaryOperator,
        left: &Expression,
        right: &Expression,
        needed: Option<&Shape>,
    ) {
        let needed = match operator {
            BinaryOperator::Equal | BinaryOperator::NotEqual => None,
            _ => needed,
        };
        if self.is_enumerator(left) {
            let shape = self.expression(right, needed);
            self.expression(left, Some(&shape));
        } else {
            let shape = self.expression(left, needed);
            self.expression(right, if needed.is_some() { needed } else { Some(&shape) });
        }
    }

    fn is_enumerator(&self, expression: &Expression) -> bool {
        match &expression.kind {
            ExpressionKind::Name(name) => {
                self.index.lookup(&name.key, self.unit, self.library).is_none()
            }
            ExpressionKind::Parenthesised(inner) => self.is_enumerator(inner),
            _ => false,
        }
    }

    fn name(&mut self, name: &Name, needed: Option<&Shape>) -> Shape {
        if let Some(id) = self.index.lookup(&name.key, self.unit, self.library) {
            self.note(name.span, id);
            return self.index.symbol(id).shape.clone();
        }
        let all = self.index.enumerators.get(&*name.key).map_or(&[][..], Vec::as_slice);
        let fits = |id: &&SymbolId| {
            needed.is_some_and(|needed| self.index.member(needed, &name.key) == Some(**id))
        };
        let fitting = all.iter().find(fits);
        let Some(symbol) = fitting.or(all.first()).copied() else {
            self.unknown(name);
            return Shape::Plain;
        };
        let certain = fitting.is_some() || all.len() == 1;
        self.index.uses.push(Use { span: name.span, symbol, certain });
        self.index.symbol(symbol).shape.clone()
    }

    fn call(
        &mut self,
        callee: &Expression,
        arguments: &[Argument],
        needed: Option<&Shape>,
    ) -> Shape {
        let ExpressionKind::Name(name) = &callee.kind else {
            let shape = self.value(callee);
            self.instance(&shape, arguments);
            return Shape::Plain;
        };
        let found = self.index.lookup(&name.key, self.unit, self.library);
        match found.map(|id| (id, self.index.symbol(id).kind)) {
            Some((id, SymbolKind::Variable(_))) => {
                self.note(name.span, id);
                let shape = self.index.symbol(id).shape.clone();
                self.instance(&shape, arguments);
                Shape::Plain
            }
            Some((first, _)) => {
                let forms = self.index.forms(first).to_vec();
                let fits = |id: &&SymbolId| self.fits(**id, arguments);
                let id = forms.iter().find(fits).copied().unwrap_or(first);
                self.note(name.span, id);
                let forms = if forms.is_empty() { vec![id] } else { forms };
                self.arguments(&forms, arguments, None);
                self.index.symbol(id).shape.clone()
            }
            None => {
                if known::function(&name.key).is_none() {
                    self.unknown(name);
                }
                self.arguments(&[], arguments, needed);
                needed.cloned().unwrap_or(Shape::Plain)
            }
        }
    }

    /// Whether a form of a function has as many parameters, and those that are named.
    fn fits(&self, id: SymbolId, arguments: &[Argument]) -> bool {
        let shape = Shape::Declared(id);
        let inputs = self.parameters(id, true).len();
        arguments.len() == inputs
            && arguments.iter().all(|argument| match &argument.name {
                Some((name, _)) => self.index.member(&shape, &name.key).is_some(),
                None => true,
            })
    }

    fn instance(&mut self, shape: &Shape, arguments: &[Argument]) {
        match self.index.without_names(shape) {
            Shape::Declared(id) => self.arguments(&[id], arguments, None),
            _ => self.arguments(&[], arguments, None),
        }
    }

    /// The parameters of a unit: all, or those that a call without names must give.
    fn parameters(&self, id: SymbolId, given: bool) -> Vec<SymbolId> {
        let output = SymbolKind::Variable(SectionKind::Output);
        let members = self.index.symbol(id).members.iter().copied();
        let parameters = members.filter(|id| self.index.symbol(*id).is_parameter());
        parameters.filter(|id| !given || self.index.symbol(*id).kind != output).collect()
    }

    /// The arguments of a call of one of these forms, or of what the compiler makes itself.
    fn arguments(&mut self, forms: &[SymbolId], arguments: &[Argument], needed: Option<&Shape>) {
        let inputs = forms.first().map_or(0, |id| self.parameters(*id, true).len());
        let order = match forms.first() {
            Some(id) => self.parameters(*id, arguments.len() <= inputs),
            None => Vec::new(),
        };
        for (at, argument) in arguments.iter().enumerate() {
            let parameter = match &argument.name {
                Some((name, _)) => {
                    let known = forms
                        .iter()
                        .find_map(|id| self.index.member(&Shape::Declared(*id), &name.key));
                    match known {
                        Some(id) => self.note(name.span, id),
                        None if forms.is_empty() || matches!(&*name.key, "EN" | "ENO") => {}
                        None => self.unknown(name),
                    }
                    known
                }
                None => order.get(at).copied(),
            };
            let shape = parameter.map(|id| self.index.symbol(id).shape.clone());
            if let Some(value) = &argument.value {
                self.expression(value, shape.as_ref().or(needed));
            }
        }
    }
}
