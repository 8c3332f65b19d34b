//! What a project declares, as an editor asks for it.

use crate::source::Span;
use crate::syntax::ast::{SectionKind, UnitKind};

/// A declaration of an [`Index`](super::Index).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SymbolId(pub(super) u32);

/// What a declaration declares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SymbolKind {
    /// A program, function or function block. Its members are its variables.
    Unit(UnitKind),
    /// An enumeration. Its members are its values.
    Enumeration,
    /// A structure. Its members are its fields.
    Structure,
    /// Any other declared type.
    Type,
    /// A value of an enumeration.
    Enumerator,
    /// A field of a structure.
    Field,
    /// A variable, by its section.
    Variable(SectionKind),
    /// A CONFIGURATION. Its members are its resources, tasks and program instances.
    Configuration,
    /// A RESOURCE.
    Resource,
    /// A TASK.
    Task,
    /// A program instance.
    Instance,
}

/// What is known of a type without resolving its constants: what can stand behind a variable of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A type without parts, or one that is not understood.
    Plain,
    /// A declared type, or an instance of a function block or program.
    Declared(SymbolId),
    /// An array of so many dimensions.
    Array(usize, Box<Shape>),
    /// A reference.
    Reference(Box<Shape>),
}

/// One declaration.
#[derive(Clone, Debug)]
pub struct Symbol {
    /// Its name as declared. Empty for an enumeration that is written where a variable is declared.
    pub name: String,
    /// What it is.
    pub kind: SymbolKind,
    /// Its name's place.
    pub span: Span,
    /// All of the declaration.
    pub extent: Span,
    /// What it is declared in.
    pub container: Option<SymbolId>,
    /// What is declared in it, in order.
    pub members: Vec<SymbolId>,
    /// The type of a variable, field, or result of a function; what a declared type is made of.
    pub shape: Shape,
    /// Its type as it is written.
    pub spec: Option<Span>,
    /// Its direct address.
    pub address: Option<Span>,
    /// Its initial value, or the number of a value of an enumeration.
    pub initial: Option<Span>,
    /// Whether it is declared CONSTANT.
    pub constant: bool,
    /// Whether it is of the compiler's library.
    pub library: bool,
}

impl Symbol {
    pub(super) fn new(name: &str, kind: SymbolKind, span: Span, extent: Span) -> Self {
        Self {
            name: name.to_owned(),
            kind,
            span,
            extent,
            container: None,
            members: Vec::new(),
            shape: Shape::Plain,
            spec: None,
            address: None,
            initial: None,
            constant: false,
            library: false,
        }
    }

    /// Its name in upper case: two names are the same if their keys are.
    #[must_use]
    pub fn key(&self) -> String {
        self.name.to_ascii_uppercase()
    }

    /// Whether a call can name it.
    #[must_use]
    pub fn is_parameter(&self) -> bool {
        use SectionKind::{InOut, Input, Output};
        matches!(self.kind, SymbolKind::Variable(Input | Output | InOut))
    }

    /// Whether it can be used behind a dot from outside of what it is a member of.
    #[must_use]
    pub fn is_accessible(&self) -> bool {
        use SectionKind::{Input, Output};
        matches!(self.kind, SymbolKind::Field | SymbolKind::Variable(Input | Output))
    }
}
