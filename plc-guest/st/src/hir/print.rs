//! The typed tree as text, for `--emit types` and for reports of the differential test.
//!
//! The text looks like ST with every conversion and storage written out. It is for eyes, not for reading back.

use std::fmt::Write;

use super::{
    Argument, Arithmetic, Block, Comparison, Constant, Conversion, Expr, ExprKind, ForLoop,
    LocalKind, Place, Program, Root, Routine, Statement, StatementKind, Step, Type, UnaryOperator,
};

/// The whole program.
pub fn print(program: &Program) -> String {
    let mut printer = Printer { program, routine: None, text: String::new(), depth: 0 };
    printer.program();
    printer.text
}

struct Printer<'p> {
    program: &'p Program,
    routine: Option<&'p Routine>,
    text: String,
    depth: usize,
}

impl<'p> Printer<'p> {
    fn line(&mut self, line: &str) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.text, "{:indent$}{line}", "", indent = self.depth * 2);
    }

    fn inside(&mut self, print: impl FnOnce(&mut Self)) {
        self.depth += 1;
        print(self);
        self.depth -= 1;
    }

    fn program(&mut self) {
        let program = self.program;
        self.line(&format!("program image {}", program.name));
        for (id, ty) in program.types.iter() {
            if let Type::Structure(structure) = ty {
                let (name, kind) = (&structure.name, structure.kind);
                self.line(&format!("{kind:?} {name}: {} bytes", program.types.size(id)));
                self.inside(|printer| {
                    for field in &structure.fields {
                        let ty = program.types.name(field.ty);
                        let initial = constant(&field.initial);
                        printer.line(&format!(
                            "+{} {:?} {}: {ty}{initial}",
                            field.offset, field.section, field.name
                        ));
                    }
                });
            }
        }
        for global in &program.globals {
            let ty = program.types.name(global.ty);
            let bit = global.storage.bit.map(|bit| format!(".{bit}")).unwrap_or_default();
            let initial = constant(&global.initial);
            let (area, offset) = (global.storage.area, global.storage.offset);
            self.line(&format!("{area:?}+{offset}{bit} {}: {ty}{initial}", global.name));
        }
        for routine in &program.routines {
            self.routine = Some(routine);
            self.routine(routine);
        }
        for task in &program.tasks {
            let entry = &program.routine(task.entry).name;
            self.line(&format!(
                "task {}: {:?}, priority {}, runs {entry}",
                task.name, task.kind, task.priority
            ));
        }
    }

    fn routine(&mut self, routine: &'p Routine) {
        let types = &self.program.types;
        let of = routine.instance.map(|ty| format!(" of {}", types.name(ty))).unwrap_or_default();
        let result =
            routine.result.map(|id| format!(" -> {}", routine.local(id).name)).unwrap_or_default();
        self.line(&format!("routine {}{of}{result}", routine.name));
        self.inside(|printer| {
            for local in &routine.locals {
                let kind = match local.kind {
                    LocalKind::Input => "in ",
                    LocalKind::InOut => "inout ",
                    LocalKind::Output => "out ",
                    LocalKind::Variable => "",
                };
                let (ty, initial) = (types.name(local.ty), constant(&local.initial));
                printer.line(&format!("{kind}{}: {ty}{initial}", local.name));
            }
            printer.block(&routine.body);
        });
    }

    fn block(&mut self, block: &Block) {
        self.inside(|printer| block.iter().for_each(|statement| printer.statement(statement)));
    }

    fn statement(&mut self, statement: &Statement) {
        match &statement.kind {
            StatementKind::Assign(place, value) => {
                let line = format!("{} := {}", self.place(place), self.expr(value));
                self.line(&line);
            }
            StatementKind::Call(routine, arguments) => {
                let line = self.call(&self.program.routine(*routine).name, arguments);
                self.line(&line);
            }
            StatementKind::Invoke(place, _, arguments) => {
                let line = self.call(&self.place(place), arguments);
                self.line(&line);
            }
            StatementKind::If(arms, otherwise) => {
                for (index, (condition, block)) in arms.iter().enumerate() {
                    let word = if index == 0 { "if" } else { "elsif" };
                    let line = format!("{word} {}", self.expr(condition));
                    self.line(&line);
                    self.block(block);
                }
                self.otherwise(otherwise);
            }
            StatementKind::Case(selector, arms, otherwise) => {
                let line = format!("case {}", self.expr(selector));
                self.line(&line);
                for arm in arms {
                    let ranges: Vec<String> =
                        arm.ranges.iter().map(|(low, high)| format!("{low}..{high}")).collect();
                    self.line(&format!("{}:", ranges.join(", ")));
                    self.block(&arm.body);
                }
                self.otherwise(otherwise);
            }
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                let (variable, from) = (self.place(variable), self.expr(from));
                let line =
                    format!("for {variable} := {from} to {} by {}", self.expr(to), self.expr(by));
                self.line(&line);
                self.block(body);
            }
            StatementKind::While(condition, body) => {
                let line = format!("while {}", self.expr(condition));
                self.line(&line);
                self.block(body);
            }
            StatementKind::Repeat(body, until) => {
                self.line("repeat");
                self.block(body);
                let line = format!("until {}", self.expr(until));
                self.line(&line);
            }
            StatementKind::Exit => self.line("exit"),
            StatementKind::Continue => self.line("continue"),
            StatementKind::Return => self.line("return"),
        }
    }

    fn otherwise(&mut self, block: &Block) {
        if !block.is_empty() {
            self.line("else");
            self.block(block);
        }
    }

    fn place(&self, place: &Place) -> String {
        let (mut text, mut ty) = match &place.root {
            Root::Global(id) => {
                let global = self.program.global(*id);
                (global.name.clone(), Some(global.ty))
            }
            Root::Local(id) => match self.routine.map(|routine| routine.local(*id)) {
                Some(local) => (local.name.clone(), Some(local.ty)),
                None => (format!("local {}", id.0), None),
            },
            Root::Instance => {
                ("this".to_owned(), self.routine.and_then(|routine| routine.instance))
            }
            Root::Deref(reference) => {
                let target = match self.program.types.get(reference.ty) {
                    Type::Reference { target } => Some(*target),
                    _ => None,
                };
                (format!("{}^", self.expr(reference)), target)
            }
        };
        for step in &place.path {
            let now = ty.map(|ty| self.program.types.get(ty));
            ty = None;
            match step {
                Step::Field(index) => match now {
                    Some(Type::Structure(structure)) => {
                        let field = &structure.fields[*index as usize];
                        text = format!("{text}.{}", field.name);
                        ty = Some(field.ty);
                    }
                    _ => text = format!("{text}.field {index}"),
                },
                Step::Index(index) => {
                    text = format!("{text}[{}]", self.expr(index));
                    if let Some(Type::Array { element, .. }) = now {
                        ty = Some(*element);
                    }
                }
                Step::OpenIndex(indices) => {
                    text = format!("{text}[{}]", self.list(indices));
                    if let Some(Type::OpenArray { element, .. }) = now {
                        ty = Some(*element);
                    }
                }
                Step::Unit(position) => text = format!("{text}[{}]", self.expr(position)),
                Step::Bit(bit) => text = format!("{text}.%X{bit}"),
                Step::Part { offset, ty } => {
                    text = format!("{text}.{} at byte {offset}", self.program.types.name(*ty));
                }
            }
        }
        text
    }

    fn list(&self, expressions: &[Expr]) -> String {
        let texts: Vec<String> = expressions.iter().map(|expr| self.expr(expr)).collect();
        texts.join(", ")
    }

    fn call(&self, name: &str, arguments: &[Argument]) -> String {
        let arguments = arguments.iter().map(|argument| match argument {
            Argument::Value(value) => self.expr(value),
            Argument::Reference(place) => format!("ref {}", self.place(place)),
            Argument::Output(Some(place)) => format!("=> {}", self.place(place)),
            Argument::Output(None) => "=> nothing".to_owned(),
        });
        format!("{name}({})", arguments.collect::<Vec<_>>().join(", "))
    }

    fn expr(&self, expr: &Expr) -> String {
        let ty = self.program.types.name(expr.ty);
        match &expr.kind {
            ExprKind::Constant(value) => format!("{ty}#{}", value_text(value)),
            ExprKind::Load(place) => self.place(place),
            ExprKind::Unary(UnaryOperator::Negate, operand) => format!("-({})", self.expr(operand)),
            ExprKind::Unary(UnaryOperator::Not, operand) => format!("not({})", self.expr(operand)),
            ExprKind::Arithmetic(operator, left, right) => {
                self.binary(arithmetic(*operator), left, right)
            }
            ExprKind::Compare(operator, left, right) => {
                self.binary(comparison(*operator), left, right)
            }
            ExprKind::AndThen(left, right) => self.binary("and_then", left, right),
            ExprKind::OrElse(left, right) => self.binary("or_else", left, right),
            ExprKind::Convert(conversion, operand) => {
                let how = match conversion {
                    Conversion::Value => "",
                    Conversion::Truncate => "trunc ",
                    Conversion::Bits => "bits ",
                    Conversion::Check => "check ",
                };
                format!("{how}{ty}({})", self.expr(operand))
            }
            ExprKind::Call(routine, arguments) => {
                self.call(&self.program.routine(*routine).name, arguments)
            }
            ExprKind::Intrinsic(intrinsic, arguments) => {
                format!("{intrinsic:?}({})", self.list(arguments))
            }
            ExprKind::Reference(place) => format!("ref({})", self.place(place)),
            ExprKind::Bound { place, dimension, upper } => {
                let which = if *upper { "upper" } else { "lower" };
                format!("{which} bound {dimension} of {}", self.place(place))
            }
        }
    }

    fn binary(&self, operator: &str, left: &Expr, right: &Expr) -> String {
        format!("({} {operator} {})", self.expr(left), self.expr(right))
    }
}

fn arithmetic(operator: Arithmetic) -> &'static str {
    match operator {
        Arithmetic::Add => "+",
        Arithmetic::Subtract => "-",
        Arithmetic::Multiply => "*",
        Arithmetic::Divide => "/",
        Arithmetic::Modulo => "mod",
        Arithmetic::And => "and",
        Arithmetic::Or => "or",
        Arithmetic::Xor => "xor",
    }
}

fn comparison(operator: Comparison) -> &'static str {
    match operator {
        Comparison::Equal => "=",
        Comparison::NotEqual => "<>",
        Comparison::Less => "<",
        Comparison::LessEqual => "<=",
        Comparison::Greater => ">",
        Comparison::GreaterEqual => ">=",
    }
}

fn constant(value: &Constant) -> String {
    match value {
        Constant::Default => String::new(),
        value => format!(" := {}", value_text(value)),
    }
}

fn value_text(value: &Constant) -> String {
    match value {
        Constant::Default => "default".to_owned(),
        Constant::Integer(value) => value.to_string(),
        Constant::Real(value) => format!("{value:?}"),
        Constant::String(bytes) => format!("'{}'", bytes.escape_ascii()),
        Constant::WString(units) => format!("{:?}", String::from_utf16_lossy(units)),
        Constant::Address(global, fields) => {
            format!("address of global {}, fields {fields:?}", global.0)
        }
        Constant::Aggregate(values) => {
            let values: Vec<String> = values.iter().map(value_text).collect();
            format!("({})", values.join(", "))
        }
        Constant::Fill(value) => format!("all {}", value_text(value)),
    }
}
