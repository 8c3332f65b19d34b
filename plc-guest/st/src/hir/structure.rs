//! What has fields: structures, and instances of function blocks and programs.

use super::Constant;
use super::types::TypeId;

/// Fields at fixed offsets.
#[derive(Clone, Debug, PartialEq)]
pub struct Structure {
    /// The type's name.
    pub name: String,
    /// What declared it.
    pub kind: StructureKind,
    /// The fields in the order of their declaration.
    pub fields: Vec<Field>,
    /// The size in bytes, a multiple of the alignment.
    pub size: u32,
    /// The alignment in bytes.
    pub align: u32,
    /// Whether bytes behind the last field are left for the fields of later versions.
    pub room: bool,
}

/// What declared a structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StructureKind {
    /// `STRUCT`.
    Struct,
    /// `FUNCTION_BLOCK`: the fields are its variables.
    FunctionBlock,
    /// `PROGRAM`: the fields are its variables.
    Program,
}

/// A field of a structure.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// The name as declared.
    pub name: String,
    /// The type.
    pub ty: TypeId,
    /// The offset in bytes from the structure's start.
    pub offset: u32,
    /// The initial value.
    pub initial: Constant,
    /// In which section of a function block or program it was declared.
    pub section: Section,
    /// RETAIN or PERSISTENT.
    pub retention: super::Retention,
}

/// The section of a declaration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// `VAR`, or a field of a structure.
    Variable,
    /// `VAR_INPUT`.
    Input,
    /// `VAR_OUTPUT`.
    Output,
    /// `VAR_IN_OUT`; the field is a reference.
    InOut,
}
