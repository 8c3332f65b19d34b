//! The declarations of a program, out of the linked file.

use takt_sdk::declaration::{self, Declaration};

use super::elf::Program;
use super::{LinkError, places};

const RECORD: usize = size_of::<Declaration>();

/// One record, with its strings fetched.
pub struct Declared {
    pub kind: u32,
    pub name: String,
    pub text: String,
    pub address: u64,
    pub numbers: [u64; 8],
    /// File and line, if they are known.
    pub place: Option<String>,
}

impl Declared {
    /// An error about it.
    pub fn error(&self, what: &'static str, why: String) -> LinkError {
        LinkError::Declared { what, name: self.name.clone(), why }.at(self.place.as_ref())
    }

    /// One of its numbers as a narrower type.
    pub fn narrow<T: TryFrom<u64>>(
        &self,
        what: &'static str,
        number: &str,
        value: u64,
    ) -> Result<T, LinkError> {
        T::try_from(value)
            .map_err(|_| self.error(what, format!("{value} is too large for {number}")))
    }
}

/// All records.
pub fn read(program: &Program) -> Result<Vec<Declared>, LinkError> {
    let records = program.declarations.chunks(RECORD).enumerate();
    let mut declared = records
        .map(|(index, bytes)| one(program, index, bytes))
        .collect::<Result<Vec<_>, LinkError>>()?;
    let first = program.declared_at;
    let here = std::env::current_dir().unwrap_or_default();
    let places = places::of(program, first..first + program.declarations.len() as u64, &here);
    for (declared, at) in declared.iter_mut().zip((first..).step_by(RECORD)) {
        declared.place = places.get(&at).cloned();
    }
    Ok(declared)
}

fn one(program: &Program, index: usize, bytes: &[u8]) -> Result<Declared, LinkError> {
    let broken = |why: String| LinkError::Declaration { index, why };
    if bytes.len() < RECORD {
        return Err(broken(format!("it has {} bytes instead of {RECORD}", bytes.len())));
    }
    let word = |at: usize| {
        u64::from_le_bytes(std::array::from_fn(|byte| bytes.get(at + byte).copied().unwrap_or(0)))
    };
    let (version, kind) = (word(0) as u32, (word(0) >> 32) as u32);
    if version != declaration::VERSION {
        let why = format!("its version is {version}; this tool knows {}", declaration::VERSION);
        return Err(broken(why));
    }
    let string = |at: u64, length: u64, what: &str| {
        if length == 0 {
            return Ok(String::new());
        }
        let text = program.bytes(at, length).and_then(|bytes| std::str::from_utf8(bytes).ok());
        text.map(str::to_owned).ok_or_else(|| broken(format!("its {what} is not a constant text")))
    };
    Ok(Declared {
        kind,
        name: string(word(8), word(16), "name")?,
        address: word(24),
        text: string(word(32), word(40), "text")?,
        place: None,
        numbers: std::array::from_fn(|number| word(48 + 8 * number)),
    })
}
