//! Where lines begin, and how far each is indented.
//!
//! Statements, declarations and the keywords of blocks begin lines, whatever the source has. A line that
//! the source breaks elsewhere stays broken, one level deeper than its statement or than the line that
//! opened the bracket around it. Each decision rests on the words and on the breaks that the result keeps,
//! so the same rules find nothing to change in a result.

use super::block::{self, Block};
use super::spacing::{self, Before, Context};
use super::words::Word;
use crate::syntax::token::{Keyword, Sign, TokenKind};

/// One line of the result.
#[derive(Debug)]
pub(super) struct Line<'a> {
    /// Whether a blank line stands before it.
    pub blank_before: bool,
    /// In levels.
    pub indent: usize,
    /// Whether it is one of declarations.
    pub declares: bool,
    /// Its words, at least one.
    pub pieces: Vec<Piece<'a>>,
}

/// A word of a line.
#[derive(Debug)]
pub(super) struct Piece<'a> {
    pub word: Word<'a>,
    /// Whether a blank stands before it.
    pub blank_before: bool,
}

/// The lines of a file.
pub(super) fn lines<'a>(words: &[Word<'a>]) -> Vec<Line<'a>> {
    let mut layout = Layout::new(words);
    for (at, word) in words.iter().enumerate() {
        if word.is_remark() {
            layout.remark(at, *word);
        } else {
            layout.word(at, *word);
        }
    }
    layout.lines
}

/// A block that is open.
#[derive(Clone, Copy, Debug)]
struct Open {
    block: Block,
    /// Of its first line.
    indent: usize,
    /// Whether a label of CASE was read.
    labelled: bool,
}

/// The head of a block, which ends without a keyword.
#[derive(Clone, Copy, Debug)]
struct Head {
    block: Block,
    /// The names in it so far.
    names: usize,
}

struct Layout<'w, 'a> {
    words: &'w [Word<'a>],
    /// For each word the next one, itself included, that is no comment.
    significant: Vec<usize>,
    lines: Vec<Line<'a>>,
    open: Vec<Open>,
    head: Option<Head>,
    /// For each open bracket the indentation of the line that it stands in.
    brackets: Vec<usize>,
    /// Whether the next word begins a statement, a declaration or a label.
    fresh: bool,
    /// The indentation of the line in which the statement began.
    statement: usize,
    /// Whether `:=` was read in this statement.
    assigned: bool,
    /// Whether a label of CASE is being read, or its ELSE.
    label: bool,
    /// Whether the statement behind a label may begin in its line.
    behind_label: bool,
    /// The closing keyword that was the last word.
    closed: Option<Keyword>,
    /// The last word that is no comment.
    before: Option<Before>,
    /// Where comments that stand alone before the word of this number are indented to.
    remarks: Option<(usize, usize)>,
}

impl<'w, 'a> Layout<'w, 'a> {
    fn new(words: &'w [Word<'a>]) -> Self {
        let mut significant: Vec<usize> = (0..words.len()).collect();
        let mut next = words.len();
        for (at, word) in words.iter().enumerate().rev() {
            if !word.is_remark() {
                next = at;
            }
            significant[at] = next;
        }
        Self {
            words,
            significant,
            lines: Vec::new(),
            open: Vec::new(),
            head: None,
            brackets: Vec::new(),
            fresh: true,
            statement: 0,
            assigned: false,
            label: false,
            behind_label: false,
            closed: None,
            before: None,
            remarks: None,
        }
    }

    /// A comment begins a line if it does in the source.
    fn remark(&mut self, at: usize, word: Word<'a>) {
        let alone = word.breaks > 0 || self.lines.is_empty() || self.line_has_ended();
        let indent = alone.then(|| {
            let between = self.fresh || self.head.is_some() || self.closed.is_some();
            if between { self.remark_indent(at) } else { self.continued(&word) }
        });
        self.put(word, indent, true);
    }

    /// The indentation of comments between statements: that of the next label, or of the block.
    fn remark_indent(&mut self, at: usize) -> usize {
        let next = self.significant[at];
        match self.remarks {
            Some((known, indent)) if known == next => indent,
            _ => {
                let indent = match self.label_here(next) {
                    Some(indent) => indent,
                    None => self.content(),
                };
                self.remarks = Some((next, indent));
                indent
            }
        }
    }

    fn word(&mut self, at: usize, word: Word<'a>) {
        self.end_head(&word);
        self.end_closing(&word);
        let indent = self.indent(at, &word).or_else(|| {
            // Else it would become a part of the comment.
            self.line_has_ended().then(|| self.continued(&word))
        });
        let next = self.words.get(at + 1);
        let prefix = spacing::is_prefix(self.before, &word, next);
        let blank = self.before.is_some_and(|before| {
            spacing::blank(before, &word, self.context())
                || self.last_word().is_some_and(|last| last.is_remark())
                    && !word.is_sign(Sign::Semicolon)
                    && !word.is_sign(Sign::Comma)
        });
        self.put(word, indent, blank || self.before.is_none());
        self.follow(&word);
        self.before = Some(Before { kind: word.kind, prefix });
    }

    /// The indentation if the word begins a line.
    fn indent(&mut self, at: usize, word: &Word<'a>) -> Option<usize> {
        let keyword = word.keyword();
        if let Some(keyword) = keyword
            && self.brackets.is_empty()
        {
            let indent = self.open.last().map_or(0, |open| open.indent);
            if block::closes(keyword) {
                self.open.pop();
                return Some(self.begun(indent));
            }
            if block::divides(keyword) {
                self.label = keyword == Keyword::Else && self.colon_behind(at);
                return Some(self.begun(indent));
            }
        }
        let behind_label = self.label && word.is_sign(Sign::Colon);
        if self.fresh && !behind_label {
            return self.first(at, word);
        }
        let glued = behind_label || word.is_sign(Sign::Semicolon) || self.head.is_some();
        let broken = word.breaks > 0 && !glued && self.closed.is_none();
        let behind_head = keyword.is_some_and(block::ends_head) && self.brackets.is_empty();
        broken.then(|| if behind_head { self.statement } else { self.continued(word) })
    }

    /// The indentation of the first word of a statement, declaration or label.
    fn first(&mut self, at: usize, word: &Word<'a>) -> Option<usize> {
        let behind_label = std::mem::take(&mut self.behind_label);
        let same_line = word.breaks == 0 && !self.line_has_ended();
        if let Some(indent) = self.label_here(at) {
            self.label = true;
            if let Some(open) = self.open.last_mut() {
                open.labelled = true;
            }
            self.begun(indent);
            // Comments may stand before it.
            return (!same_line || !self.line_is_remarks()).then_some(indent);
        }
        let second_semicolon = word.is_sign(Sign::Semicolon)
            && self.before.is_some_and(|before| before.kind == TokenKind::Sign(Sign::Semicolon));
        let stays = same_line
            && (self.line_is_remarks() || second_semicolon || behind_label && self.alone(at));
        match stays {
            true => {
                self.statement = self.line_indent();
                self.assigned = false;
                None
            }
            false => {
                let indent = self.content();
                Some(self.begun(indent))
            }
        }
    }

    /// Notes that a statement begins in a line with this indentation.
    fn begun(&mut self, indent: usize) -> usize {
        self.statement = indent;
        self.assigned = false;
        indent
    }

    /// What a word means for those that follow.
    fn follow(&mut self, word: &Word<'a>) {
        let fresh = std::mem::take(&mut self.fresh);
        match word.kind {
            TokenKind::Sign(Sign::OpenParenthesis | Sign::OpenBracket) => {
                self.brackets.push(self.line_indent());
            }
            TokenKind::Sign(Sign::CloseParenthesis | Sign::CloseBracket) => {
                self.brackets.pop();
            }
            _ if !self.brackets.is_empty() => {}
            TokenKind::Sign(Sign::Assign) => self.assigned = true,
            TokenKind::Sign(Sign::Semicolon) => {
                self.fresh = true;
                self.head = None;
            }
            TokenKind::Sign(Sign::Colon) if self.label => {
                self.label = false;
                self.fresh = true;
                let case = self.open.last().is_some_and(|open| open.block == Block::Case);
                self.behind_label = case;
            }
            TokenKind::Identifier => {
                if let Some(head) = &mut self.head {
                    head.names += 1;
                }
            }
            TokenKind::Keyword(keyword) => self.follow_keyword(keyword, fresh),
            _ => {}
        }
    }

    fn follow_keyword(&mut self, keyword: Keyword, fresh: bool) {
        let outer = self.open.last().map(|open| open.block);
        let opened = match keyword {
            Keyword::Struct => Some(Block::Structure),
            _ if fresh => Block::opened_by(keyword, outer),
            _ => None,
        };
        if let Some(block) = opened {
            let indent = self.line_indent();
            self.open.push(Open { block, indent, labelled: false });
            self.head = None;
            match block {
                Block::Types | Block::Structure => self.fresh = true,
                Block::Case => {}
                Block::Statements => self.fresh = keyword == Keyword::Repeat,
                _ => self.head = Some(Head { block, names: 0 }),
            }
        } else if block::closes(keyword) {
            self.closed = Some(keyword);
        } else if keyword == Keyword::Else {
            // What follows in CASE has no labels.
            if let Some(open) = self.open.last_mut() {
                open.block = Block::Statements;
            }
            self.fresh = true;
        } else if block::ends_head(keyword) {
            self.fresh = outer.is_some_and(|outer| !outer.declares() && outer != Block::Unit);
        }
    }

    /// Ends the head of a block before the first word behind it.
    fn end_head(&mut self, word: &Word<'a>) {
        let (Some(head), Some(before)) = (self.head, self.before) else { return };
        let complete = match head.block {
            Block::Section => !word.keyword().is_some_and(block::qualifies),
            // `RESOURCE name ON processor`.
            Block::Resource => head.names == 3,
            // A name, and for a function a type, which may end with a bracket.
            _ => {
                let goes_on = matches!(
                    word.kind,
                    TokenKind::Sign(
                        Sign::Colon | Sign::Semicolon | Sign::OpenBracket | Sign::OpenParenthesis
                    ) | TokenKind::Keyword(Keyword::Of)
                );
                let could_end = matches!(
                    before.kind,
                    TokenKind::Identifier
                        | TokenKind::String
                        | TokenKind::WideString
                        | TokenKind::Sign(Sign::CloseBracket | Sign::CloseParenthesis)
                );
                could_end && !goes_on && self.brackets.is_empty()
            }
        };
        if complete {
            self.head = None;
            self.fresh = true;
        }
    }

    /// Behind a closing keyword, a semicolon belongs to it, and behind END_STRUCT an initial value.
    fn end_closing(&mut self, word: &Word<'a>) {
        let Some(keyword) = self.closed.take() else { return };
        let belongs = word.is_sign(Sign::Semicolon)
            || keyword == Keyword::EndStruct && word.is_sign(Sign::Assign);
        self.fresh = !belongs;
    }

    /// The indentation if a label of CASE begins at a word.
    fn label_here(&self, at: usize) -> Option<usize> {
        let open = self.open.last()?;
        (self.fresh_for_label() && open.block == Block::Case && self.is_label(at))
            .then_some(open.indent + 1)
    }

    fn fresh_for_label(&self) -> bool {
        self.fresh || self.closed.is_some()
    }

    /// Whether a colon comes before anything that a label has not.
    fn is_label(&self, at: usize) -> bool {
        let mut depth = 0_usize;
        for word in self.words.get(at..).unwrap_or(&[]) {
            match word.kind {
                TokenKind::Sign(Sign::OpenParenthesis | Sign::OpenBracket) => depth += 1,
                TokenKind::Sign(Sign::CloseParenthesis | Sign::CloseBracket) => {
                    depth = depth.saturating_sub(1);
                }
                TokenKind::Sign(Sign::Colon) if depth == 0 => return true,
                TokenKind::Sign(Sign::Assign | Sign::AttemptAssign) if depth == 0 => return false,
                TokenKind::Sign(Sign::Semicolon) => return false,
                TokenKind::Keyword(keyword)
                    if block::closes(keyword)
                        || block::divides(keyword)
                        || Block::opened_by(keyword, Some(Block::Case)).is_some() =>
                {
                    return false;
                }
                _ => {}
            }
        }
        false
    }

    /// Whether the next word is a colon, which may stand behind ELSE of CASE.
    fn colon_behind(&self, at: usize) -> bool {
        let next = self.significant.get(at + 1).and_then(|next| self.words.get(*next));
        next.is_some_and(|next| next.is_sign(Sign::Colon))
    }

    /// Whether a simple statement begins at a word that is all of its branch.
    fn alone(&self, at: usize) -> bool {
        let rest = self.words.get(at..).unwrap_or(&[]);
        let opens = |keyword| Block::opened_by(keyword, Some(Block::Case)).is_some();
        if rest.first().and_then(Word::keyword).is_some_and(opens) {
            return false;
        }
        let Some(end) = rest.iter().position(|word| word.is_sign(Sign::Semicolon)) else {
            return false;
        };
        let behind = self.significant.get(at + end + 1).copied().unwrap_or(self.words.len());
        let divided = self
            .words
            .get(behind)
            .and_then(Word::keyword)
            .is_some_and(|keyword| block::closes(keyword) || block::divides(keyword));
        divided || self.is_label(behind)
    }

    /// The indentation of what stands in the innermost block.
    fn content(&self) -> usize {
        self.open.last().map_or(0, |open| {
            open.indent + if open.block == Block::Case && open.labelled { 2 } else { 1 }
        })
    }

    /// The indentation of a line that goes on with a statement.
    fn continued(&self, word: &Word<'a>) -> usize {
        let closes = word.is_sign(Sign::CloseParenthesis) || word.is_sign(Sign::CloseBracket);
        match self.brackets.last() {
            Some(indent) if closes => *indent,
            Some(indent) => indent + 1,
            None => self.statement + 1,
        }
    }

    fn context(&self) -> Context {
        let declares = self.open.last().is_some_and(|open| open.block.declares());
        Context {
            label: self.label && self.brackets.is_empty(),
            declaration: self.brackets.is_empty()
                && !self.assigned
                && (declares || self.head.is_some()),
        }
    }

    fn put(&mut self, word: Word<'a>, indent: Option<usize>, blank_before: bool) {
        let declares = self.open.last().is_some_and(|open| open.block.declares());
        let piece = Piece { word, blank_before };
        match (indent, self.lines.last_mut()) {
            (None, Some(line)) => line.pieces.push(piece),
            (indent, last) => {
                let blank_before = last.is_some() && word.breaks > 1;
                let indent = indent.unwrap_or(0);
                self.lines.push(Line { blank_before, indent, declares, pieces: vec![piece] });
            }
        }
    }

    fn last_word(&self) -> Option<&Word<'a>> {
        Some(&self.lines.last()?.pieces.last()?.word)
    }

    /// Whether the last line ends with a comment that nothing can follow.
    fn line_has_ended(&self) -> bool {
        self.last_word().is_some_and(Word::ends_line)
    }

    /// Whether the last line has only comments.
    fn line_is_remarks(&self) -> bool {
        self.lines.last().is_some_and(|line| line.pieces.iter().all(|piece| piece.word.is_remark()))
    }

    fn line_indent(&self) -> usize {
        self.lines.last().map_or(0, |line| line.indent)
    }
}
