//! Code for registers that the PLC's kernel does not keep, as far as its assembler has noted it.
//!
//! The kernel keeps what FXSAVE keeps: general registers, x87, MMX and SSE. It leaves CR4.OSXSAVE off, so each
//! instruction for a larger register is invalid there, while the machine of the engineer carries it out: such a program passes its
//! tests and stops in the PLC. takt.h and the SDK for Rust refuse compilers that are told to use AVX. This is about what
//! they do not see: functions with an attribute, assembler, libraries. GNU's assembler notes which registers its
//! instructions are for if it is asked to, as takt.mk does; LLVM's does not, and its files pass.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use object::{File, Object, ObjectSection, ObjectSymbol};

use super::LinkError;

/// Type of the note, and of the property in it that has a bit for each kind of register.
const PROPERTIES: u32 = 5;
const REGISTERS_USED: u32 = 0xc001_0001;

/// Bits of the property, and what each stands for.
const REFUSED: [(u32, &str); 5] = [
    (1 << 4, "YMM registers (AVX)"),
    (1 << 5, "ZMM registers (AVX-512)"),
    (1 << 11, "mask registers (AVX-512)"),
    (1 << 10, "TMM registers (AMX)"),
    (1 << 7 | 1 << 8 | 1 << 9, "the extended state (XSAVE, XGETBV)"),
];

/// Members of libraries that use such registers. They may be linked or not.
#[derive(Default)]
pub struct Members(Vec<Member>);

struct Member {
    defines: Vec<String>,
    library: PathBuf,
    what: &'static str,
}

impl Members {
    /// Notes a member of a library.
    pub fn add(&mut self, library: &Path, file: &File<'_>) -> Result<(), LinkError> {
        let Some(what) = refused(file)? else { return Ok(()) };
        let symbols = file.symbols().filter(|symbol| symbol.is_definition() && symbol.is_global());
        let names = symbols.filter_map(|symbol| symbol.name().ok().map(str::to_owned));
        let (defines, library) = (names.collect(), library.to_owned());
        self.0.push(Member { defines, library, what });
        Ok(())
    }

    /// Refuses those that are in the linked file.
    pub fn check(&self, linked: &[u8]) -> Result<(), LinkError> {
        let linked = File::parse(linked)?;
        let symbols = linked.symbols().filter(|symbol| !symbol.is_undefined());
        let there: BTreeSet<&str> = symbols.filter_map(|symbol| symbol.name().ok()).collect();
        let is_there = |name: &String| there.contains(name.as_str());
        match self.0.iter().find(|member| member.defines.iter().any(is_there)) {
            None => Ok(()),
            Some(Member { library, what, .. }) => {
                Err(LinkError::Registers { path: library.clone(), what })
            }
        }
    }
}

/// Refuses an object file of which it is noted that it uses such registers.
pub fn check(input: &Path, file: &File<'_>) -> Result<(), LinkError> {
    match refused(file)? {
        None => Ok(()),
        Some(what) => Err(LinkError::Registers { path: input.to_owned(), what }),
    }
}

/// What of it the file uses first.
fn refused(file: &File<'_>) -> Result<Option<&'static str>, LinkError> {
    let Some(section) = file.section_by_name(".note.gnu.property") else { return Ok(None) };
    let used = used(section.data()?);
    Ok(REFUSED.iter().find(|(bits, _)| used & bits != 0).map(|(_, what)| *what))
}

/// The bits of all properties of this type. A section that is cut off, or of another form, has none from there on.
fn used(mut notes: &[u8]) -> u32 {
    let mut used = 0;
    while let Some((note, rest)) = note(notes) {
        let mut properties = note;
        while let Some((ty, value, rest)) = property(properties) {
            if let (REGISTERS_USED, Some(bits)) = (ty, value.first_chunk()) {
                used |= u32::from_le_bytes(*bits);
            }
            properties = rest;
        }
        notes = rest;
    }
    used
}

/// The properties in the first note, which are none if it is of another kind, and what follows it.
fn note(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (name_bytes, rest) = number(bytes)?;
    let (bytes, rest) = number(rest)?;
    let (ty, rest) = number(rest)?;
    let (name, rest) = split(rest, name_bytes, 4)?;
    let (content, rest) = split(rest, bytes, 8)?;
    let own = ty == PROPERTIES && name == b"GNU\0";
    Some((if own { content } else { &[] }, rest))
}

/// The type and the value of the first property, and what follows it.
fn property(bytes: &[u8]) -> Option<(u32, &[u8], &[u8])> {
    let (ty, rest) = number(bytes)?;
    let (bytes, rest) = number(rest)?;
    let (value, rest) = split(rest, bytes, 8)?;
    Some((ty, value, rest))
}

fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

/// So many bytes, and what follows them at the next multiple of `unit`.
fn split(bytes: &[u8], count: u32, unit: usize) -> Option<(&[u8], &[u8])> {
    let count = usize::try_from(count).ok()?;
    let (first, _) = bytes.split_at_checked(count)?;
    let next = count.checked_next_multiple_of(unit)?;
    Some((first, bytes.get(next..).unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A note with these properties, each of a number.
    fn notes(name: &[u8; 4], ty: u32, properties: &[(u32, u32)]) -> Vec<u8> {
        let words = |words: &[u32]| -> Vec<u8> {
            words.iter().flat_map(|word| word.to_le_bytes()).collect()
        };
        let all = properties.iter().flat_map(|(ty, value)| words(&[*ty, 4, *value, 0]));
        let all: Vec<u8> = all.collect();
        [words(&[4, all.len() as u32, ty]), name.to_vec(), all].concat()
    }

    #[test]
    fn the_bits_of_the_right_property_are_found() {
        let isa = (REGISTERS_USED + 1, 5);
        let right = notes(b"GNU\0", PROPERTIES, &[isa, (REGISTERS_USED, 0x19)]);
        assert_eq!(used(&right), 0x19);
        assert_eq!(used(&notes(b"GNU\0", PROPERTIES, &[isa])), 0);
        assert_eq!(used(&notes(b"GNU\0", 4, &[(REGISTERS_USED, 0x19)])), 0);
        assert_eq!(used(&notes(b"Xen\0", PROPERTIES, &[(REGISTERS_USED, 0x19)])), 0);
        let other = notes(b"GNU\0", 4, &[isa]);
        assert_eq!(used(&[other, right.clone()].concat()), 0x19);
        // Cut off anywhere, and with lengths of any size.
        for end in 0..right.len() {
            let found = used(&right[..end]);
            assert!(found == 0 || found == 0x19, "{end}");
        }
        for at in 0..right.len() - 3 {
            let mut broken = right.clone();
            broken[at..at + 4].fill(0xff);
            used(&broken);
        }
    }
}
