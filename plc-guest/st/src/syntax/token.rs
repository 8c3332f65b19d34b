//! The words of the language.
//!
//! A token is a kind and a place; its text stays in the source. Names of elementary types are
//! identifiers here: what they mean is decided where a type is expected.

use crate::source::Span;

/// One word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    /// What it is.
    pub kind: TokenKind,
    /// Where it is.
    pub span: Span,
}

/// What a word is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TokenKind {
    /// A name.
    Identifier,
    /// A word that the language keeps for itself.
    Keyword(Keyword),
    /// `NAME#` right before a literal or a value of an enumeration: `INT#`, `Colour#`.
    TypePrefix,
    /// Decimal digits, perhaps with underscores: `1_000`.
    Integer,
    /// A number with a base: `16#FF`.
    BasedInteger,
    /// A number with a point or an exponent: `1.5`, `2E3` is none, `2.0E3` is.
    Real,
    /// A duration: `T#1h2m`, `LTIME#5us`.
    Duration,
    /// A date: `D#2026-11-22`.
    Date,
    /// A time of day: `TOD#12:00:00`.
    TimeOfDay,
    /// A date and time: `DT#2026-11-22-12:00:00`.
    DateAndTime,
    /// A string of single-byte characters: `'...'`.
    String,
    /// A string of double-byte characters: `"..."`.
    WideString,
    /// An address: `%IX0.1`, `%Q*`.
    Address,
    /// A sign.
    Sign(Sign),
    /// A comment; the parser does not see it.
    Comment,
    /// `{...}`; the parser does not see it.
    Pragma,
    /// What could not be read and was already told; the parser does not see it.
    Invalid,
    /// The end of the file.
    End,
}

macro_rules! words {
    ($(#[$doc:meta])* $kind:ident { $($variant:ident $text:literal)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $kind {
            $(#[doc = concat!("`", $text, "`")] $variant,)*
        }

        impl $kind {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// As it is written, in upper case.
            #[must_use]
            pub fn text(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }
        }
    };
}

words! {
    /// A word that cannot be a name.
    Keyword {
        Abstract "ABSTRACT" Action "ACTION" And "AND" AndThen "AND_THEN" Array "ARRAY" At "AT"
        By "BY" Case "CASE" Class "CLASS" Configuration "CONFIGURATION" Constant "CONSTANT"
        Continue "CONTINUE" Do "DO" Else "ELSE" Elsif "ELSIF" EndAction "END_ACTION"
        EndCase "END_CASE" EndClass "END_CLASS" EndConfiguration "END_CONFIGURATION"
        EndFor "END_FOR" EndFunction "END_FUNCTION" EndFunctionBlock "END_FUNCTION_BLOCK"
        EndIf "END_IF" EndInterface "END_INTERFACE" EndMethod "END_METHOD"
        EndNamespace "END_NAMESPACE" EndProgram "END_PROGRAM" EndProperty "END_PROPERTY"
        EndRepeat "END_REPEAT" EndResource "END_RESOURCE" EndStep "END_STEP" EndStruct "END_STRUCT"
        EndTest "END_TEST"
        EndTransition "END_TRANSITION" EndType "END_TYPE" EndVar "END_VAR" EndWhile "END_WHILE"
        Exit "EXIT" Extends "EXTENDS" False "FALSE" FallingEdge "F_EDGE" Final "FINAL" For "FOR"
        Function "FUNCTION" FunctionBlock "FUNCTION_BLOCK" If "IF" Implements "IMPLEMENTS"
        InitialStep "INITIAL_STEP" Interface "INTERFACE" Internal "INTERNAL" Method "METHOD"
        Mod "MOD" Namespace "NAMESPACE" NonRetain "NON_RETAIN" Not "NOT" Null "NULL" Of "OF"
        Or "OR" OrElse "OR_ELSE" Overlap "OVERLAP" Override "OVERRIDE"
        Persistent "PERSISTENT" Private "PRIVATE" Program "PROGRAM" Property "PROPERTY"
        Protected "PROTECTED" Public "PUBLIC"
        RefTo "REF_TO" Repeat "REPEAT" Resource "RESOURCE" Retain "RETAIN" Return "RETURN"
        RisingEdge "R_EDGE" Step "STEP" Struct "STRUCT" Super "SUPER" Task "TASK" Test "TEST" Then "THEN"
        This "THIS" To "TO" Transition "TRANSITION" True "TRUE" Type "TYPE" Until "UNTIL"
        Using "USING" Var "VAR" VarAccess "VAR_ACCESS" VarConfig "VAR_CONFIG"
        VarExternal "VAR_EXTERNAL" VarGlobal "VAR_GLOBAL" VarInOut "VAR_IN_OUT"
        VarInput "VAR_INPUT" VarOutput "VAR_OUTPUT" VarTemp "VAR_TEMP" While "WHILE" With "WITH"
        Xor "XOR"
    }
}

words! {
    /// A sign or a group of signs.
    Sign {
        Assign ":=" OutputAssign "=>" AttemptAssign "?=" Equal "=" NotEqual "<>" LessEqual "<="
        GreaterEqual ">=" Less "<" Greater ">" Plus "+" Minus "-" Power "**" Times "*" Divide "/"
        Ampersand "&" OpenParenthesis "(" CloseParenthesis ")" OpenBracket "[" CloseBracket "]"
        Comma "," Semicolon ";" Colon ":" Range ".." Dot "." Caret "^" Hash "#"
    }
}
