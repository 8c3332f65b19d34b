//! What stands where: declarations and their uses, for editors.
//!
//! The checker knows what every name means, but it stops at the first mistake of an expression, and it
//! works on whole programs. Somebody who types has neither most of the time. So names are resolved here once
//! more, by the syntax tree alone: scopes and the parts of types need no constants, no conversions and no
//! overloads. A test holds the two together: in each program that the checker accepts, each name is found
//! here.
//!
//! `declare` takes note of declarations, `resolve` of uses; [`complete`], [`comment`], [`describe`] and
//! [`rename`] answer what an editor asks.

pub mod comment;
pub mod complete;
mod declare;
pub mod describe;
pub mod rename;
mod resolve;
mod symbol;

use std::collections::HashMap;

use crate::diagnostic::Diagnostics;
use crate::library;
use crate::source::{FileId, Sources, Span};
use crate::stack;
use crate::syntax::ast::{File, UnitKind};
use crate::syntax::parser;

pub use symbol::{Shape, Symbol, SymbolId, SymbolKind};

/// A place where a name stands for a declaration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Use {
    /// Where.
    pub span: Span,
    /// For what.
    pub symbol: SymbolId,
    /// Whether nothing else can be meant. A value that several enumerations have may be the value of another.
    pub certain: bool,
}

/// All declarations and uses of a project and of the library.
#[derive(Debug, Default)]
pub struct Index {
    symbols: Vec<Symbol>,
    /// By file and place.
    uses: Vec<Use>,
    /// Names that are not known, by file and place. Functions that the compiler makes itself are known.
    unknown: Vec<Span>,
    /// The names at the top of the project's files, by key; the first declaration first.
    own: HashMap<String, Vec<SymbolId>>,
    /// Those of the library.
    library: HashMap<String, Vec<SymbolId>>,
    /// The values of enumerations by key.
    enumerators: HashMap<String, Vec<SymbolId>>,
    /// What the names within a unit mean, by key.
    scopes: HashMap<SymbolId, HashMap<String, SymbolId>>,
    /// The declaration at each declared name's place.
    declared: HashMap<Span, SymbolId>,
}

impl Index {
    /// Reads all files, of which those from number `own` on are the library's.
    ///
    /// # Errors
    ///
    /// If the system has no room for a thread (see [`stack`]).
    pub fn new(sources: &Sources, own: usize) -> std::io::Result<Self> {
        stack::with_room(|| {
            // What is wrong was already told when the project was checked.
            let mut unseen = Diagnostics::new();
            let files = sources.iter().take(own);
            let trees: Vec<File> =
                files.map(|(file, _)| parser::parse(file, sources, &mut unseen)).collect();
            let library = library::trees(sources, own);
            let trees = || {
                trees
                    .iter()
                    .map(|tree| (tree, false))
                    .chain(library.iter().map(|tree| (tree, true)))
            };
            let mut index = Self::default();
            for (tree, library) in trees() {
                declare::names(&mut index, tree, library);
            }
            for (tree, library) in trees() {
                declare::parts(&mut index, tree, library);
            }
            for (tree, library) in trees() {
                resolve::uses(&mut index, tree, library);
            }
            index.uses.sort_by_key(|one| one.span);
            index.unknown.sort();
            index
        })
    }

    /// A declaration.
    #[must_use]
    pub fn symbol(&self, id: SymbolId) -> &Symbol {
        &self.symbols[id.0 as usize]
    }

    /// All declarations, in the order of files and places, parts behind what they are parts of.
    pub fn symbols(&self) -> impl Iterator<Item = (SymbolId, &Symbol)> {
        self.symbols.iter().enumerate().map(|(at, symbol)| (SymbolId(at as u32), symbol))
    }

    /// All uses, by file and place. A declaration's own name is one.
    #[must_use]
    pub fn uses(&self) -> &[Use] {
        &self.uses
    }

    /// The uses of one declaration.
    pub fn uses_of(&self, id: SymbolId) -> impl Iterator<Item = &Use> {
        self.uses.iter().filter(move |one| one.symbol == id)
    }

    /// The names that mean nothing, by file and place.
    #[must_use]
    pub fn unknown(&self) -> &[Span] {
        &self.unknown
    }

    /// The use at a byte, or the one that ends right before it.
    #[must_use]
    pub fn at(&self, file: FileId, offset: u32) -> Option<&Use> {
        let behind =
            self.uses.partition_point(|one| (one.span.file, one.span.start) <= (file, offset));
        let one = self.uses.get(behind.checked_sub(1)?)?;
        (one.span.file == file && offset <= one.span.end).then_some(one)
    }

    /// All declarations at the top with this name: one, or the forms of a function of the library.
    #[must_use]
    pub fn forms(&self, id: SymbolId) -> &[SymbolId] {
        let symbol = self.symbol(id);
        let names = if symbol.library { &self.library } else { &self.own };
        let forms = names.get(&symbol.key()).map_or(&[][..], Vec::as_slice);
        if forms.contains(&id) { forms } else { &[] }
    }

    /// The unit that the text at a byte belongs to, also if it is not complete.
    #[must_use]
    pub fn unit_at(&self, file: FileId, offset: u32) -> Option<SymbolId> {
        let before = self.symbols().filter(|(_, symbol)| {
            let top = symbol.container.is_none() && !symbol.name.is_empty();
            top && symbol.span.file == file && symbol.extent.start <= offset
        });
        let (id, symbol) = before.max_by_key(|(_, symbol)| symbol.extent.start)?;
        matches!(symbol.kind, SymbolKind::Unit(_)).then_some(id)
    }

    /// What a key means in a unit, or at the top.
    fn lookup(&self, key: &str, unit: Option<SymbolId>, library: bool) -> Option<SymbolId> {
        if let Some(unit) = unit {
            if let Some(id) = self.scopes.get(&unit).and_then(|scope| scope.get(key)) {
                return Some(*id);
            }
            let symbol = self.symbol(unit);
            if symbol.kind == SymbolKind::Unit(UnitKind::Function) && symbol.key() == key {
                return Some(unit);
            }
        }
        self.top(key, library)?.first().copied()
    }

    /// What a key means at the top.
    fn top(&self, key: &str, library: bool) -> Option<&[SymbolId]> {
        let own = if library { None } else { self.own.get(key) };
        own.or_else(|| self.library.get(key)).map(Vec::as_slice)
    }

    /// The type behind names for it.
    fn without_names(&self, shape: &Shape) -> Shape {
        let mut shape = shape;
        // A wrong project may have names that go round in a circle.
        for _ in 0..crate::limits::DEPTH {
            match shape {
                Shape::Declared(id) if self.symbol(*id).kind == SymbolKind::Type => {
                    shape = &self.symbol(*id).shape;
                }
                _ => return shape.clone(),
            }
        }
        Shape::Plain
    }

    /// The members of a structure, instance or enumeration.
    #[must_use]
    pub fn members(&self, shape: &Shape) -> &[SymbolId] {
        match self.without_names(shape) {
            Shape::Declared(id) => &self.symbol(id).members,
            _ => &[],
        }
    }

    fn member(&self, shape: &Shape, key: &str) -> Option<SymbolId> {
        let mut members = self.members(shape).iter();
        members.find(|id| self.symbol(**id).name.eq_ignore_ascii_case(key)).copied()
    }

    /// What an element of an array is.
    fn element(&self, shape: &Shape, indices: usize) -> Shape {
        let (mut shape, mut left) = (self.without_names(shape), indices);
        while left > 0 {
            let Shape::Array(dimensions, element) = shape else { return Shape::Plain };
            if dimensions > left {
                return Shape::Array(dimensions - left, element);
            }
            left -= dimensions;
            shape = self.without_names(&element);
        }
        shape
    }

    /// What a reference refers to.
    fn target(&self, shape: &Shape) -> Shape {
        match self.without_names(shape) {
            Shape::Reference(target) => *target,
            _ => Shape::Plain,
        }
    }
}
