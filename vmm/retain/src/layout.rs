//! Which values of a program are kept, and where they are in a block.

use sha2::{Digest, Sha256};
use takt_program::{Elementary, Image, Type, TypeKind};

use crate::generation;

/// One variable of the state, whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Kept {
    pub offset: u32,
    pub bytes: u32,
    pub persistent: bool,
}

/// A value of its own, or an array of such values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its path in small letters; of an array with `[]` at its end.
    pub name: String,
    /// What has to be the same for the bytes to mean the same.
    pub ty: String,
    /// Lowest index; 0 if it is no array.
    pub lower: i64,
    /// Elements; 1 if it is no array.
    pub count: u32,
    /// Bytes of an element.
    pub bytes: u32,
    /// Its place in the block.
    pub at: usize,
    /// It is kept over cold starts and downloads too.
    pub persistent: bool,
}

impl Part {
    /// Where its values are in the block.
    pub(crate) fn range(&self) -> std::ops::Range<usize> {
        self.at..self.at + self.count as usize * self.bytes as usize
    }
}

/// What is kept of a program.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    image: [u8; 32],
    kept: Vec<Kept>,
    parts: Vec<Part>,
    initial: Vec<u8>,
}

impl Layout {
    /// That of an image. References are not in its parts: what they refer to is not known to be there.
    #[must_use]
    pub fn of(image: &Image<'_>) -> Self {
        let mut layout =
            Self { image: image.hash(), kept: Vec::new(), parts: Vec::new(), initial: Vec::new() };
        for variable in image.retained() {
            let persistent = variable.is_persistent();
            let at = layout.initial.len();
            let Some(ty) = image.type_of(variable.ty) else { continue };
            layout.open(image, variable.name.to_ascii_lowercase(), &ty, at, persistent);
            let (start, bytes) = (variable.offset as usize, variable.bytes as usize);
            // What the image does not have of the state is zero.
            let there = image.state().get(start..).unwrap_or_default();
            layout.initial.extend_from_slice(&there[..bytes.min(there.len())]);
            layout.initial.resize(at + bytes, 0);
            layout.kept.push(Kept { offset: variable.offset, bytes: variable.bytes, persistent });
        }
        layout
    }

    /// Bytes of the block that [`of`](Self::of) would make. An image may have any number, and each element of an array gets a
    /// name there: this is to be looked at first.
    #[must_use]
    pub fn block_bytes(image: &Image<'_>) -> u64 {
        image.retained().map(|variable| u64::from(variable.bytes)).sum()
    }

    fn open(
        &mut self,
        image: &Image<'_>,
        name: String,
        ty: &Type<'_>,
        at: usize,
        persistent: bool,
    ) {
        match ty.kind {
            TypeKind::Reference { .. } => {}
            TypeKind::Structure | TypeKind::FunctionBlock => {
                for field in image.fields(ty) {
                    if let Some(ty) = image.type_of(field.ty) {
                        let name = format!("{name}.{}", field.name.to_ascii_lowercase());
                        self.open(image, name, &ty, at + field.offset as usize, persistent);
                    }
                }
            }
            TypeKind::Array { element, lower, upper } => {
                let Some(element) = image.type_of(element) else { return };
                if let Some(ty) = leaf(image, &element) {
                    let count = (upper - lower + 1) as u32;
                    let (name, bytes) = (format!("{name}[]"), element.bytes);
                    self.parts.push(Part { name, ty, lower, count, bytes, at, persistent });
                    return;
                }
                for (place, index) in (lower..=upper).enumerate() {
                    let at = at + place * element.bytes as usize;
                    self.open(image, format!("{name}[{index}]"), &element, at, persistent);
                }
            }
            _ => {
                let Some(own) = leaf(image, ty) else { return };
                let bytes = ty.bytes;
                self.parts.push(Part { name, ty: own, lower: 0, count: 1, bytes, at, persistent });
            }
        }
    }

    /// True if nothing is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The SHA-256 of the image.
    #[must_use]
    pub fn image(&self) -> [u8; 32] {
        self.image
    }

    /// Offset and bytes of each variable in the state, in the order of the block.
    pub fn variables(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.kept.iter().map(|kept| (kept.offset, kept.bytes))
    }

    /// Separate pieces of the state that the variables are.
    #[must_use]
    pub fn pieces(&self) -> usize {
        let mut all: Vec<_> = self.variables().collect();
        all.sort_unstable();
        let mut end = None;
        let mut begins = |(offset, bytes): &(u32, u32)| {
            let begins = end.is_none_or(|end| *offset > end);
            end = end.max(Some(offset + bytes));
            begins
        };
        all.iter().filter(|piece| begins(piece)).count()
    }

    /// Values that have names, in the order of the block.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The block with initial values.
    #[must_use]
    pub fn initial(&self) -> &[u8] {
        &self.initial
    }

    /// A block as it is after a cold start: what is not PERSISTENT has its initial values. `None` if it is none of
    /// this layout.
    #[must_use]
    pub fn cold(&self, block: &[u8]) -> Option<Vec<u8>> {
        if block.len() != self.initial.len() {
            return None;
        }
        let mut cold = self.initial.clone();
        let mut at = 0;
        for kept in &self.kept {
            let place = at..at + kept.bytes as usize;
            at = place.end;
            if kept.persistent {
                cold[place.clone()].copy_from_slice(&block[place]);
            }
        }
        Some(cold)
    }

    /// True if something is kept over a cold start.
    #[must_use]
    pub fn has_persistent(&self) -> bool {
        self.kept.iter().any(|kept| kept.persistent)
    }

    /// Bytes of its generations.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        generation::bytes(&self.parts)
    }
}

/// What has to be the same of a type without parts; `None` if it has parts, or is a reference.
fn leaf(image: &Image<'_>, ty: &Type<'_>) -> Option<String> {
    Some(match ty.kind {
        TypeKind::Elementary(elementary) => elementary.keyword().to_owned(),
        TypeKind::String { length } => format!("STRING[{length}]"),
        TypeKind::WString { length } => format!("WSTRING[{length}]"),
        TypeKind::Subrange { base, low, high } => format!("{}({low}..{high})", base.keyword()),
        TypeKind::Enumeration { base } => enumeration(image, ty, base),
        _ => return None,
    })
}

/// With a hash of its names and numbers: a number must mean the same name.
fn enumeration(image: &Image<'_>, ty: &Type<'_>, base: Elementary) -> String {
    let mut hash = Sha256::new();
    for value in image.values(ty) {
        hash.update(value.name.to_ascii_lowercase().as_bytes());
        hash.update([0]);
        hash.update(value.value.to_le_bytes());
    }
    let hash: String = hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    format!("{}:{}:{hash}", ty.name.to_ascii_lowercase(), base.keyword())
}
