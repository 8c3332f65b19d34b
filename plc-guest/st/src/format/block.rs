//! The blocks of the language, by the keywords that open and close them.

use crate::syntax::token::Keyword;

/// A kind of block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Block {
    /// PROGRAM, FUNCTION, FUNCTION_BLOCK, TEST.
    Unit,
    /// CONFIGURATION.
    Configuration,
    /// RESOURCE.
    Resource,
    /// A section of variables.
    Section,
    /// TYPE.
    Types,
    /// STRUCT.
    Structure,
    /// CASE up to its ELSE.
    Case,
    /// Any other: statements only.
    Statements,
}

impl Block {
    /// The block that a keyword opens where a statement or a declaration may begin. Within `outer`,
    /// the innermost that is open.
    pub fn opened_by(keyword: Keyword, outer: Option<Self>) -> Option<Self> {
        use Keyword::*;
        Some(match keyword {
            // An instance of a program is one declaration.
            Program if matches!(outer, Some(Self::Configuration | Self::Resource)) => return None,
            Program | Function | FunctionBlock | Test => Self::Unit,
            Configuration => Self::Configuration,
            Resource => Self::Resource,
            Var | VarInput | VarOutput | VarInOut | VarTemp | VarExternal | VarGlobal
            | VarConfig => Self::Section,
            Type => Self::Types,
            Case => Self::Case,
            If | For | While | Repeat => Self::Statements,
            _ => return None,
        })
    }

    /// Whether there are declarations in it and no statements.
    pub fn declares(self) -> bool {
        matches!(
            self,
            Self::Section | Self::Types | Self::Structure | Self::Configuration | Self::Resource
        )
    }
}

/// Whether a keyword closes the innermost block.
pub(super) fn closes(keyword: Keyword) -> bool {
    use Keyword::*;
    matches!(
        keyword,
        EndProgram
            | EndFunction
            | EndFunctionBlock
            | EndConfiguration
            | EndResource
            | EndVar
            | EndType
            | EndStruct
            | EndTest
            | EndCase
            | EndIf
            | EndFor
            | EndWhile
            | EndRepeat
    )
}

/// Whether a keyword separates two parts of one block.
pub(super) fn divides(keyword: Keyword) -> bool {
    matches!(keyword, Keyword::Else | Keyword::Elsif | Keyword::Until)
}

/// Whether a keyword ends the head of a block or branch, so that its statements begin behind it.
pub(super) fn ends_head(keyword: Keyword) -> bool {
    matches!(keyword, Keyword::Then | Keyword::Do | Keyword::Of)
}

/// Whether a keyword says what the variables of a section have in common.
pub(super) fn qualifies(keyword: Keyword) -> bool {
    use Keyword::*;
    matches!(keyword, Constant | Retain | NonRetain | Persistent)
}
