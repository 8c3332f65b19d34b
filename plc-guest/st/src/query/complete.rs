//! Which names can go on where somebody types.
//!
//! Text that is being typed does not parse, so the words before the place decide: a dot asks for members,
//! `Colour#` for values, a colon in a declaration for types, and everything else for what is visible.

use super::{Index, Shape, SymbolId, SymbolKind};
use crate::check::known;
use crate::diagnostic::Diagnostics;
use crate::source::{FileId, Sources};
use crate::syntax::ast::{SectionKind, UnitKind};
use crate::syntax::lexer::Lexer;
use crate::syntax::token::{Keyword, Sign, Token, TokenKind};

/// The most that is offered at once.
pub const CANDIDATES: usize = 1000;

/// Where a candidate comes from. What is nearer comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// What only this place can name: a member, a parameter, a value of the enumeration.
    Place,
    /// The unit.
    Unit,
    /// The project.
    Project,
    /// The library, and what the compiler has itself.
    Library,
    /// The words of the language.
    Language,
}

/// One word that can stand there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// What is shown.
    pub label: String,
    /// What is written, if it is not the label.
    pub insert: Option<String>,
    /// Where it comes from.
    pub origin: Origin,
    /// Its declaration, if it has one.
    pub symbol: Option<SymbolId>,
    /// How a function of the compiler's own is called.
    pub form: Option<String>,
}

/// All that can stand at a byte, nearest first; whether there was more.
#[must_use]
pub fn at(sources: &Sources, index: &Index, file: FileId, offset: u32) -> (Vec<Candidate>, bool) {
    let Some(typed) = Typed::read(sources, file, offset) else { return (Vec::new(), false) };
    let unit = index.unit_at(file, offset);
    let mut offer = Offer { sources, index, unit, prefix: &typed.prefix, list: Vec::new() };
    offer.fill(&typed.words);
    let mut list = offer.list;
    list.sort_by(|one, other| (one.origin, &one.label).cmp(&(other.origin, &other.label)));
    list.dedup_by(|one, other| one.label == other.label);
    let more = list.len() > CANDIDATES;
    list.truncate(CANDIDATES);
    (list, more)
}

/// The words before a place, and the beginning of the one that is typed there.
struct Typed {
    words: Vec<Token>,
    prefix: String,
}

impl Typed {
    /// None within a comment, a string, a number or an address.
    fn read(sources: &Sources, file: FileId, offset: u32) -> Option<Self> {
        let source = sources.get(file);
        let mut unseen = Diagnostics::new();
        let mut lexer = Lexer::new(file, source);
        let mut words = Vec::new();
        loop {
            let token = lexer.next_token(&mut unseen);
            let span = token.span;
            if token.kind == TokenKind::End || span.start >= offset {
                return Some(Self { words, prefix: String::new() });
            }
            let touched = offset <= span.end;
            let inside = offset < span.end;
            match token.kind {
                TokenKind::Identifier | TokenKind::Keyword(_) if touched => {
                    let text = source.text().get(span.start as usize..offset as usize)?;
                    return Some(Self { words, prefix: text.to_ascii_uppercase() });
                }
                TokenKind::Comment if inside || touched && sources.text(span).starts_with("//") => {
                    return None;
                }
                TokenKind::Comment | TokenKind::Pragma if !inside => {}
                TokenKind::Sign(_) | TokenKind::TypePrefix if !inside => words.push(token),
                _ if touched => return None,
                _ => words.push(token),
            }
        }
    }
}

/// What words the place is between.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Region {
    Variables,
    Types,
    Configuration,
    Body,
}

fn region(words: &[Token]) -> Region {
    for word in words.iter().rev() {
        let TokenKind::Keyword(keyword) = word.kind else { continue };
        match keyword {
            Keyword::Var
            | Keyword::VarConfig
            | Keyword::VarExternal
            | Keyword::VarGlobal
            | Keyword::VarInOut
            | Keyword::VarInput
            | Keyword::VarOutput
            | Keyword::VarTemp => return Region::Variables,
            Keyword::Type | Keyword::Struct | Keyword::EndStruct => return Region::Types,
            Keyword::Configuration | Keyword::Resource | Keyword::Task => {
                return Region::Configuration;
            }
            Keyword::EndVar | Keyword::EndType | Keyword::EndConfiguration => return Region::Body,
            Keyword::EndResource => return Region::Configuration,
            Keyword::Then | Keyword::Do | Keyword::Else | Keyword::Repeat => return Region::Body,
            _ => {}
        }
    }
    Region::Body
}

/// One step from a variable to a part of it.
enum Step {
    Field(String),
    Index(usize),
    Dereference,
}

struct Offer<'a> {
    sources: &'a Sources,
    index: &'a Index,
    unit: Option<SymbolId>,
    prefix: &'a str,
    list: Vec<Candidate>,
}

impl Offer<'_> {
    fn fill(&mut self, words: &[Token]) {
        let last = words.last().map(|word| word.kind);
        match last {
            Some(TokenKind::Sign(Sign::Dot)) => {
                let shape = self.chain(&words[..words.len() - 1]);
                self.members(&shape);
            }
            Some(TokenKind::TypePrefix) => {
                let text = self.text(words.last());
                self.values(text.trim_end_matches('#'));
            }
            Some(TokenKind::Sign(Sign::Hash)) => {
                let text = self.text(words.len().checked_sub(2).and_then(|at| words.get(at)));
                self.values(&text);
            }
            _ => self.anywhere(words, last),
        }
    }

    fn anywhere(&mut self, words: &[Token], last: Option<TokenKind>) {
        let region = region(words);
        let names_type = matches!(
            last,
            Some(TokenKind::Sign(Sign::Colon) | TokenKind::Keyword(Keyword::Of | Keyword::RefTo))
        );
        let result = matches!(words, [.., function, _, _]
            if function.kind == TokenKind::Keyword(Keyword::Function));
        match region {
            _ if names_type && result => self.types(),
            Region::Variables | Region::Types if names_type => self.types(),
            Region::Configuration if last == Some(TokenKind::Keyword(Keyword::With)) => {
                self.of_kind(|kind| kind == SymbolKind::Task);
            }
            Region::Configuration if names_type => {
                self.of_kind(|kind| kind == SymbolKind::Unit(UnitKind::Program));
            }
            Region::Variables | Region::Types if !matches!(last, Some(TokenKind::Sign(sign)) if sign != Sign::Semicolon) =>
            {
                // A name that is declared here is new.
                self.keywords();
            }
            _ => {
                self.parameters(words);
                self.visible();
                self.keywords();
            }
        }
    }

    fn text(&self, word: Option<&Token>) -> String {
        word.map(|word| self.sources.text(word.span).to_ascii_uppercase()).unwrap_or_default()
    }

    /// What the words at the end of `words` name: a variable, or a part of one.
    fn chain(&self, words: &[Token]) -> Shape {
        let mut steps = Vec::new();
        let mut left = words;
        let root = loop {
            let Some((last, before)) = left.split_last() else { return Shape::Plain };
            left = before;
            match last.kind {
                TokenKind::Sign(Sign::Caret) => steps.push(Step::Dereference),
                TokenKind::Sign(Sign::CloseBracket) => {
                    let Some((open, indices)) = opening(before) else { return Shape::Plain };
                    steps.push(Step::Index(indices));
                    left = &before[..open];
                }
                TokenKind::Identifier => match before.split_last() {
                    Some((dot, before)) if dot.kind == TokenKind::Sign(Sign::Dot) => {
                        steps.push(Step::Field(self.text(Some(last))));
                        left = before;
                    }
                    _ => break self.text(Some(last)),
                },
                _ => return Shape::Plain,
            }
        };
        let Some(root) = self.index.lookup(&root, self.unit, false) else { return Shape::Plain };
        let symbol = self.index.symbol(root);
        let mut shape = match symbol.kind {
            SymbolKind::Variable(_) | SymbolKind::Unit(UnitKind::Function) => symbol.shape.clone(),
            _ => return Shape::Plain,
        };
        for step in steps.into_iter().rev() {
            shape = match step {
                Step::Dereference => self.index.target(&shape),
                Step::Index(count) => self.index.element(&shape, count),
                Step::Field(key) => match self.index.member(&shape, &key) {
                    Some(id) => self.index.symbol(id).shape.clone(),
                    None => return Shape::Plain,
                },
            };
        }
        shape
    }

    fn add(&mut self, label: &str, origin: Origin, symbol: Option<SymbolId>) {
        if label.to_ascii_uppercase().contains(self.prefix) {
            let label = label.to_owned();
            self.list.push(Candidate { label, insert: None, origin, symbol, form: None });
        }
    }

    fn symbol(&mut self, id: SymbolId, origin: Origin) {
        let index = self.index;
        self.add(&index.symbol(id).name, origin, Some(id));
    }

    fn members(&mut self, shape: &Shape) {
        let index = self.index;
        for id in index.members(shape) {
            let symbol = index.symbol(*id);
            // A test looks into instances.
            let own = symbol.kind == SymbolKind::Variable(SectionKind::Local);
            if symbol.is_accessible() || own && self.in_test() {
                self.symbol(*id, Origin::Place);
            }
        }
    }

    fn in_test(&self) -> bool {
        let test = SymbolKind::Unit(UnitKind::Test);
        self.unit.is_some_and(|unit| self.index.symbol(unit).kind == test)
    }

    fn values(&mut self, ty: &str) {
        let index = self.index;
        let Some(id) = index.lookup(ty, None, false) else { return };
        for id in index.members(&Shape::Declared(id)) {
            if index.symbol(*id).kind == SymbolKind::Enumerator {
                self.symbol(*id, Origin::Place);
            }
        }
    }

    fn of_kind(&mut self, wanted: impl Fn(SymbolKind) -> bool) {
        let index = self.index;
        for (id, symbol) in index.symbols() {
            if wanted(symbol.kind) && !symbol.name.is_empty() {
                let origin = if symbol.library { Origin::Library } else { Origin::Project };
                self.symbol(id, origin);
            }
        }
    }

    fn types(&mut self) {
        self.of_kind(|kind| {
            matches!(
                kind,
                SymbolKind::Enumeration
                    | SymbolKind::Structure
                    | SymbolKind::Type
                    | SymbolKind::Unit(UnitKind::FunctionBlock)
            )
        });
        for name in known::types() {
            self.add(name, Origin::Library, None);
        }
        for keyword in [Keyword::Array, Keyword::RefTo, Keyword::Struct] {
            self.add(keyword.text(), Origin::Language, None);
        }
    }

    /// The parameters of the call that the place is in.
    fn parameters(&mut self, words: &[Token]) {
        let last = words.last().map(|word| word.kind);
        if !matches!(last, Some(TokenKind::Sign(Sign::OpenParenthesis | Sign::Comma))) {
            return;
        }
        let mut depth = 0_usize;
        let mut open = None;
        for (at, word) in words.iter().enumerate().rev() {
            match word.kind {
                TokenKind::Sign(Sign::CloseParenthesis | Sign::CloseBracket) => depth += 1,
                TokenKind::Sign(Sign::OpenParenthesis) if depth == 0 => {
                    open = Some(at);
                    break;
                }
                TokenKind::Sign(Sign::OpenParenthesis | Sign::OpenBracket) => {
                    depth = depth.saturating_sub(1);
                }
                TokenKind::Sign(Sign::Semicolon) => break,
                _ => {}
            }
        }
        let Some(callee) = open.map(|open| &words[..open]) else { return };
        let index = self.index;
        let function = match callee {
            [.., dot, _] if dot.kind == TokenKind::Sign(Sign::Dot) => None,
            [.., name] if name.kind == TokenKind::Identifier => {
                index.lookup(&self.text(Some(name)), self.unit, false)
            }
            _ => None,
        };
        let is_unit = |id: &SymbolId| matches!(index.symbol(*id).kind, SymbolKind::Unit(_));
        let shape = match function.filter(is_unit) {
            Some(id) => Shape::Declared(id),
            None => self.chain(callee),
        };
        for id in index.members(&shape) {
            let symbol = index.symbol(*id);
            if symbol.is_parameter() && symbol.name.to_ascii_uppercase().contains(self.prefix) {
                let output = symbol.kind == SymbolKind::Variable(SectionKind::Output);
                let sign = if output { "=>" } else { ":=" };
                self.list.push(Candidate {
                    label: format!("{} {sign}", symbol.name),
                    insert: Some(format!("{} {sign} ", symbol.name)),
                    origin: Origin::Place,
                    symbol: Some(*id),
                    form: None,
                });
            }
        }
    }

    /// Variables, functions and values of enumerations.
    fn visible(&mut self) {
        let index = self.index;
        if let Some(unit) = self.unit {
            for id in index.scopes.get(&unit).into_iter().flat_map(|scope| scope.values()) {
                self.symbol(*id, Origin::Unit);
            }
        }
        self.of_kind(|kind| {
            matches!(
                kind,
                SymbolKind::Enumeration
                    | SymbolKind::Enumerator
                    | SymbolKind::Variable(SectionKind::Global)
                    | SymbolKind::Unit(UnitKind::Function)
            )
        });
        let of_tests = known::test_functions().filter(|_| self.in_test());
        let of_tests: Vec<(&str, String)> =
            of_tests.map(|name| (name, known::function(name).unwrap_or_default())).collect();
        for (name, form) in known::functions().chain(of_tests) {
            if name.contains(self.prefix) {
                self.list.push(Candidate {
                    label: name.to_owned(),
                    insert: None,
                    origin: Origin::Library,
                    symbol: None,
                    form: Some(form),
                });
            }
        }
    }

    fn keywords(&mut self) {
        for keyword in Keyword::ALL {
            if !is_refused(*keyword) {
                self.add(keyword.text(), Origin::Language, None);
            }
        }
    }
}

/// The bracket that the words before a closing one opened, and how many indices stand between.
fn opening(words: &[Token]) -> Option<(usize, usize)> {
    let (mut depth, mut indices) = (0_usize, 1);
    for (at, word) in words.iter().enumerate().rev() {
        match word.kind {
            TokenKind::Sign(Sign::CloseBracket | Sign::CloseParenthesis) => depth += 1,
            TokenKind::Sign(Sign::OpenBracket) if depth == 0 => return Some((at, indices)),
            TokenKind::Sign(Sign::OpenBracket | Sign::OpenParenthesis) => {
                depth = depth.checked_sub(1)?;
            }
            TokenKind::Sign(Sign::Comma) if depth == 0 => indices += 1,
            TokenKind::Sign(Sign::Semicolon) => return None,
            _ => {}
        }
    }
    None
}

/// The words of those parts of the language that the compiler refuses.
fn is_refused(keyword: Keyword) -> bool {
    use Keyword as K;
    matches!(
        keyword,
        K::Abstract
            | K::Action
            | K::Class
            | K::EndAction
            | K::EndClass
            | K::EndInterface
            | K::EndMethod
            | K::EndNamespace
            | K::EndProperty
            | K::EndStep
            | K::EndTransition
            | K::Extends
            | K::Final
            | K::Implements
            | K::InitialStep
            | K::Interface
            | K::Internal
            | K::Method
            | K::Namespace
            | K::Overlap
            | K::Override
            | K::Private
            | K::Property
            | K::Protected
            | K::Public
            | K::Step
            | K::Super
            | K::This
            | K::Transition
            | K::Using
            | K::VarAccess
            | K::VarConfig
    )
}
