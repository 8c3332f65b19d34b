//! Program organisation units, variables and configurations.

use super::{Expression, Initial, Name, Statement, TypeDeclaration, TypeSpec};
use crate::source::Span;

/// What a file declares at its top.
#[derive(Clone, Debug)]
pub enum Declaration {
    /// A program, function or function block.
    Unit(Unit),
    /// One type of a TYPE block.
    Type(TypeDeclaration),
    /// VAR_GLOBAL outside of a configuration.
    Globals(Section),
    /// A configuration.
    Configuration(Configuration),
}

/// Which unit it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum UnitKind {
    /// PROGRAM
    Program,
    /// FUNCTION
    Function,
    /// FUNCTION_BLOCK
    FunctionBlock,
    /// TEST, whose name is a string.
    Test,
}

/// A program, function or function block.
#[derive(Clone, Debug)]
pub struct Unit {
    /// Which of them.
    pub kind: UnitKind,
    /// Its name.
    pub name: Name,
    /// The type of a function's result.
    pub result: Option<TypeSpec>,
    /// Its sections of variables, in order.
    pub sections: Vec<Section>,
    /// Its body.
    pub body: Vec<Statement>,
    /// All of it.
    pub span: Span,
    /// The closing keyword.
    pub end: Span,
}

/// The keyword of a section of variables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SectionKind {
    /// VAR
    Local,
    /// VAR_INPUT
    Input,
    /// VAR_OUTPUT
    Output,
    /// VAR_IN_OUT
    InOut,
    /// VAR_TEMP
    Temporary,
    /// VAR_EXTERNAL
    External,
    /// VAR_GLOBAL
    Global,
}

/// What happens to a variable's value over a warm start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Retention {
    /// RETAIN
    Retain,
    /// NON_RETAIN
    NonRetain,
    /// PERSISTENT, alone or with RETAIN.
    Persistent,
}

/// `VAR ... END_VAR`.
#[derive(Clone, Debug)]
pub struct Section {
    /// Its keyword.
    pub kind: SectionKind,
    /// CONSTANT, with its place.
    pub constant: Option<Span>,
    /// RETAIN, NON_RETAIN or PERSISTENT, with its place.
    pub retention: Option<(Retention, Span)>,
    /// Its variables.
    pub variables: Vec<Variables>,
    /// The keyword.
    pub span: Span,
}

/// `a, b AT %IX0.0 : INT := 5;`, and the same for the fields of a structure.
#[derive(Clone, Debug)]
pub struct Variables {
    /// The names. One that has only an address (`AT %IX0.0 : BOOL;`) is left out.
    pub names: Vec<Name>,
    /// Where they lie.
    pub address: Option<Address>,
    /// Their type.
    pub spec: TypeSpec,
    /// R_EDGE or F_EDGE.
    pub edge: Option<(Edge, Span)>,
    /// Their initial value.
    pub initial: Option<Initial>,
    /// All of it.
    pub span: Span,
}

/// Which edge of an input is detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Edge {
    /// R_EDGE
    Rising,
    /// F_EDGE
    Falling,
}

/// Which image an address is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Area {
    /// `%I`
    Input,
    /// `%Q`
    Output,
    /// `%M`
    Marker,
}

/// How much an address names. Its number counts units of that size (`%IW2` is bytes 4 and 5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Width {
    /// `X` or nothing
    Bit,
    /// `B`
    Byte,
    /// `W`
    Word,
    /// `D`
    Double,
    /// `L`
    Long,
}

/// A direct address.
#[derive(Clone, Debug)]
pub struct Address {
    /// The image.
    pub area: Area,
    /// The place in it; none for `%I*`, which the partition file or the compiler chooses.
    pub place: Option<Place>,
    /// Where it is written.
    pub span: Span,
}

/// The place of an address in its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Place {
    /// How much it names.
    pub width: Width,
    /// The first byte.
    pub byte: u32,
    /// The bit in it (0 for a width of more than a bit).
    pub bit: u8,
}

/// `CONFIGURATION ... END_CONFIGURATION`.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// Its name.
    pub name: Name,
    /// VAR_GLOBAL.
    pub globals: Vec<Section>,
    /// VAR_CONFIG.
    pub placements: Vec<Placement>,
    /// Its resources. Tasks and programs outside of any are in one without a name.
    pub resources: Vec<Resource>,
    /// All of it.
    pub span: Span,
}

/// `instance.block.variable AT %QX0.0 : BOOL;` of VAR_CONFIG.
#[derive(Clone, Debug)]
pub struct Placement {
    /// The instance and its variable.
    pub path: super::Expression,
    /// Where it lies.
    pub address: Option<Address>,
    /// The type that it is declared with.
    pub spec: TypeSpec,
    /// Its initial value.
    pub initial: Option<Initial>,
    /// All of it.
    pub span: Span,
}

/// `RESOURCE ... END_RESOURCE`.
#[derive(Clone, Debug)]
pub struct Resource {
    /// Its name and the type of processor, if written.
    pub name: Option<(Name, Name)>,
    /// VAR_GLOBAL.
    pub globals: Vec<Section>,
    /// TASK.
    pub tasks: Vec<Task>,
    /// PROGRAM.
    pub programs: Vec<ProgramInstance>,
    /// All of it.
    pub span: Span,
}

/// `TASK fast (INTERVAL := T#1ms, PRIORITY := 1);`
#[derive(Clone, Debug)]
pub struct Task {
    /// Its name.
    pub name: Name,
    /// Its properties.
    pub properties: Vec<(Name, Expression)>,
    /// All of it.
    pub span: Span,
}

/// `PROGRAM p1 WITH fast : Main (x := %IX0.0, y => g);`
#[derive(Clone, Debug)]
pub struct ProgramInstance {
    /// The instance's name.
    pub name: Name,
    /// RETAIN or NON_RETAIN.
    pub retention: Option<(Retention, Span)>,
    /// Its task; without one it runs freely.
    pub task: Option<Name>,
    /// The program.
    pub program: Name,
    /// What its inputs and outputs are connected with.
    pub arguments: Vec<super::Argument>,
    /// All of it.
    pub span: Span,
}
