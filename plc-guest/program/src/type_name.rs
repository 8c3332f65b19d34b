//! A type as IEC 61131-3 writes it.

use core::fmt;

use crate::{Image, TypeId, TypeKind};

/// Shows a type as IEC 61131-3 writes it: by its name, or by what it is.
#[derive(Clone, Copy, Debug)]
pub struct TypeName<'a> {
    image: Image<'a>,
    id: TypeId,
}

impl<'a> Image<'a> {
    /// A type, to be shown; nothing if there is none of this number.
    #[must_use]
    pub const fn type_name(&self, id: TypeId) -> TypeName<'a> {
        TypeName { image: *self, id }
    }
}

impl fmt::Display for TypeName<'_> {
    /// Types are nested to a limit, so this ends.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(ty) = self.image.type_of(self.id) else { return Ok(()) };
        if !ty.name.is_empty() {
            return f.pad(ty.name);
        }
        match ty.kind {
            TypeKind::Elementary(elementary) => f.pad(elementary.keyword()),
            TypeKind::String { length } => write!(f, "STRING[{length}]"),
            TypeKind::WString { length } => write!(f, "WSTRING[{length}]"),
            TypeKind::Array { element, lower, upper } => {
                write!(f, "ARRAY[{lower}..{upper}] OF {}", self.image.type_name(element))
            }
            TypeKind::Structure => f.pad("STRUCT"),
            TypeKind::FunctionBlock => f.pad("FUNCTION_BLOCK"),
            TypeKind::Enumeration { base } => f.pad(base.keyword()),
            TypeKind::Subrange { base, low, high } => {
                write!(f, "{}({low}..{high})", base.keyword())
            }
            // What it refers to may have it as a part, so only its name is shown.
            TypeKind::Reference { target } => match self.image.type_of(target) {
                Some(target) if !target.name.is_empty() => write!(f, "REF_TO {}", target.name),
                Some(target) => match target.kind {
                    TypeKind::Elementary(elementary) => {
                        write!(f, "REF_TO {}", elementary.keyword())
                    }
                    _ => f.write_str("REF_TO ?"),
                },
                None => f.write_str("REF_TO ?"),
            },
        }
    }
}
