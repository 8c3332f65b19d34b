//! What can be wrong with a project, and where.

use std::fmt;
use thiserror::Error;

/// A place in the project's file; both count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Position {
    /// The line.
    pub line: u32,
    /// The column, in characters.
    pub column: u32,
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.line, self.column)
    }
}

/// Why nothing was imported.
#[derive(Debug, Error)]
pub enum ImportError {
    /// More than [`crate::MAXIMUM_BYTES`].
    #[error("the project has {bytes} bytes; at most {maximum} are allowed")]
    TooLarge {
        /// The bytes that it has.
        bytes: usize,
        /// The bytes that are allowed.
        maximum: usize,
    },
    /// Not well-formed, a DTD, or too many nodes.
    #[error("the project is not well-formed XML: {0}")]
    Xml(#[from] roxmltree::Error),
    /// The other format with this purpose.
    #[error(
        "{at}: the document is a <Project>, as IEC 61131-10 has it; only a PLCopen <project> (TC6, version 2.01) is read"
    )]
    OtherFormat {
        /// Where.
        at: Position,
    },
    /// Another kind of document.
    #[error("{at}: the document is a <{found}>, not a PLCopen <project>")]
    NoProject {
        /// The element that was found.
        found: String,
        /// Where.
        at: Position,
    },
}

/// A part of a project that was refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{at}: {part}: {kind}")]
pub struct Defect {
    /// Where it is.
    pub at: Position,
    /// Which part, such as "function block Mixer".
    pub part: String,
    /// Why it was refused.
    pub kind: DefectKind,
}

/// Why a part was refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DefectKind {
    /// A body that is not Structured Text.
    #[error("its body is {language}; only Structured Text (ST) can be imported")]
    Language {
        /// The format's name of the language.
        language: String,
    },
    /// It has no body.
    #[error("it has no body")]
    MissingBody,
    /// It has more than one.
    #[error("it has a second body; only units with one can be imported")]
    SecondBody,
    /// A child that only some tools know, or that has no counterpart.
    #[error("<{element}> is not supported")]
    NotSupported {
        /// The element's name.
        element: String,
    },
    /// A child that has to be there.
    #[error("<{element}> lacks <{child}>")]
    MissingChild {
        /// The element's name.
        element: String,
        /// The name of what is missing.
        child: &'static str,
    },
    /// An attribute that has to be there.
    #[error("<{element}> lacks the attribute `{attribute}`")]
    MissingAttribute {
        /// The element's name.
        element: String,
        /// The name of what is missing.
        attribute: &'static str,
    },
    /// A name that is none in the language.
    #[error(
        "`{name}` is no name: a letter or underscore, then letters, digits and underscores, at most 128"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// A value that cannot stand where it is.
    #[error("`{}` is no {expected}", value.escape_debug())]
    Value {
        /// The value.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
    /// Types or values within each other without end.
    #[error("types or values deeper than {maximum} levels")]
    TooDeep {
        /// The levels that are allowed.
        maximum: u32,
    },
}
