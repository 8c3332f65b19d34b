//! The kinds of messages. Their names are what documentation, tests and `--message-format json` use.

use std::fmt;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Nothing is built.
    Error,
    /// The program is built, but probably does not do what was meant.
    Warning,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Error => "error",
            Self::Warning => "warning",
        })
    }
}

macro_rules! codes {
    ($($variant:ident $severity:ident $name:literal $meaning:literal;)*) => {
        /// The kind of a message.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $(#[doc = $meaning] $variant,)*
        }

        impl Code {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Its name in messages.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Whether it is an error or a warning.
            #[must_use]
            pub fn severity(self) -> Severity {
                match self { $(Self::$variant => Severity::$severity,)* }
            }

            /// What it means, in one sentence.
            #[must_use]
            pub fn meaning(self) -> &'static str {
                match self { $(Self::$variant => $meaning,)* }
            }
        }
    };
}

codes! {
    // Files.
    CannotRead Error "cannot-read" "A file or folder that cannot be read.";
    NotText Error "not-text" "A file that is no text in UTF-8.";
    TooLarge Error "too-large" "A file, a project or a program that is larger than it may be.";
    NoSource Error "no-source" "Something that has no Structured Text in it.";
    FolderLoop Warning "folder-loop" "A link to a folder around it, which is not followed.";
    // The text.
    InvalidCharacter Error "invalid-character" "A character that no Structured Text has outside of comments and strings, or a carriage return that hides a line.";
    Unterminated Error "unterminated" "A comment, a string or a pragma that does not end.";
    InvalidLiteral Error "invalid-literal" "A number, string, duration or date of wrong form, or out of its type's range.";
    InvalidAddress Error "invalid-address" "A direct address of wrong form or outside of its area.";
    PragmaIgnored Warning "pragma-ignored" "A pragma: Takt knows none.";
    // The grammar.
    Syntax Error "syntax" "Something that cannot stand there.";
    TooDeep Error "too-deep" "Expressions, statements or types too deep within each other.";
    NotSupported Error "not-supported" "A part of the standard that this compiler does not have.";
    // Names.
    UnknownName Error "unknown-name" "A name that is not declared here.";
    DuplicateName Error "duplicate-name" "A name that is declared twice.";
    ReservedName Error "reserved-name" "A keyword or a standard type declared as something else.";
    WrongKind Error "wrong-kind" "A name that means something else than what is needed there.";
    Recursion Error "recursion" "A type, function or function block that contains or calls itself.";
    // Declarations.
    InvalidDeclaration Error "invalid-declaration" "A declaration that cannot be as it is written.";
    InvalidConstant Error "invalid-constant" "A value that must be known when the program is built and is not.";
    InvalidRange Error "invalid-range" "Bounds of an array, subrange or string that cannot be.";
    InvalidTask Error "invalid-task" "A task or program instance that cannot run as configured.";
    AddressConflict Error "address-conflict" "Two variables or tasks at one output address.";
    NoTask Error "no-task" "A program without a task, so that nothing of it would run.";
    Internal Error "internal" "The compiler could not compile what it accepts: a mistake of its own, or no room on this machine.";
    StackTooLarge Error "stack-too-large" "A task or a function that needs more stack than a task can have.";
    ProjectFile Error "project-file" "A mistake in the project file.";
    SharedOutput Warning "shared-output" "Instances of a program that write one output.";
    // Expressions and statements.
    TypeMismatch Error "type-mismatch" "A value of another type than what is needed there.";
    LosesValue Error "loses-value" "An implicit conversion that can lose a part of the value.";
    OutOfRange Error "out-of-range" "A constant that its type, or an index that its array, does not have.";
    DivisionByZero Error "division-by-zero" "A division by a constant zero.";
    NotAssignable Error "not-assignable" "A value given to something that cannot take one.";
    WrongArguments Error "wrong-arguments" "A call whose arguments do not fit the declaration.";
    MissingResult Warning "missing-result" "A function that never assigns its result.";
    MisplacedStatement Error "misplaced-statement" "EXIT or CONTINUE outside of a loop.";
    InvalidCase Error "invalid-case" "A label of CASE that is doubled, empty or of a wrong type.";
    // Warnings.
    Unused Warning "unused" "A variable that is never read or written.";
    NeverAssigned Warning "never-assigned" "A variable that is read and never assigned.";
    RealEquality Warning "real-equality" "Floating-point numbers compared for equality.";
    UnboundedLoop Warning "unbounded-loop" "A WHILE or REPEAT loop without a visible bound.";
    NoEffect Warning "no-effect" "A statement or condition that cannot change anything, or a test without an assertion.";
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
