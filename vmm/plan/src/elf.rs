//! What an ELF image claims, checked before it is loaded.
//!
//! linux-loader copies segments to wherever the file says and checks neither class nor machine
//! nor type. The image is a user's file and may be anything, so its headers are read here first
//! (by the `elf` crate) and compared with the memory that the guest has.

use std::ops::Range;

use elf::ElfBytes;
use elf::abi::{ELFMAGIC, EM_X86_64, ET_EXEC, PF_X, PT_LOAD};
use elf::endian::LittleEndian;
use elf::file::Class;
use takt_abi::start::RETAINED_SEGMENT;
use thiserror::Error;

/// An image that is no program for this guest.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ElfError {
    /// The `elf` crate could not parse it.
    #[error("it is not a well-formed ELF file: {0}")]
    Malformed(String),
    /// A shared object, an object file, or a program for another processor.
    #[error("it is not a static 64-bit x86 executable (ELF type EXEC, machine x86-64)")]
    Kind,
    /// No segment has to be loaded.
    #[error("it has nothing to load")]
    Empty,
    /// A segment's sizes or addresses make no sense.
    #[error("its segment at {start:#x} is longer in the file than in memory, or wraps around")]
    Segment {
        /// Where the segment would lie.
        start: u64,
    },
    /// A segment that a warm start has to leave alone has content in the file.
    #[error("its segment at {start:#x} is to be retained, but has content in the file")]
    Retained {
        /// Where the segment would lie.
        start: u64,
    },
    /// The entry point is not inside an executable segment.
    #[error("its entry point {entry:#x} does not lie in its code")]
    Entry {
        /// The address.
        entry: u64,
    },
    /// It does not fit where it must lie.
    #[error(
        "it needs {start:#x} to {end:#x}, but {low:#x} to {high:#x} is what there is: raise `memory`, or link it elsewhere"
    )]
    DoesNotFit {
        /// Lowest address needed.
        start: u64,
        /// End of the highest segment.
        end: u64,
        /// Start of the memory it may use.
        low: u64,
        /// End of that memory.
        high: u64,
    },
}

/// Whether a file that starts with these bytes says that it is an ELF file.
#[must_use]
pub fn is_elf(start: &[u8]) -> bool {
    start.starts_with(&ELFMAGIC)
}

/// What an image needs of memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extent {
    /// End of its highest segment.
    pub end: u64,
    /// Segments that a warm start leaves as they are.
    pub retained: Vec<Range<u64>>,
}

/// Checks that `image` is a static executable that lies within `low..high`.
///
/// # Errors
/// See [`ElfError`].
pub fn check(image: &[u8], low: u64, high: u64) -> Result<Extent, ElfError> {
    let malformed = |e: elf::ParseError| ElfError::Malformed(e.to_string());
    let file = ElfBytes::<LittleEndian>::minimal_parse(image).map_err(malformed)?;
    let header = &file.ehdr;
    if header.class != Class::ELF64 || header.e_type != ET_EXEC || header.e_machine != EM_X86_64 {
        return Err(ElfError::Kind);
    }
    let (mut start, mut end, mut entry_ok) = (u64::MAX, 0, false);
    let mut retained = Vec::new();
    let segments = file.segments().ok_or(ElfError::Empty)?;
    for s in segments.iter().filter(|s| s.p_type == PT_LOAD && s.p_memsz > 0) {
        let bad = ElfError::Segment { start: s.p_paddr };
        let segment_end = s.p_paddr.checked_add(s.p_memsz).ok_or(bad.clone())?;
        if s.p_filesz > s.p_memsz || file.segment_data(&s).is_err() {
            return Err(bad);
        }
        if s.p_flags & RETAINED_SEGMENT != 0 {
            if s.p_filesz > 0 {
                return Err(ElfError::Retained { start: s.p_paddr });
            }
            retained.push(s.p_paddr..segment_end);
        }
        start = start.min(s.p_paddr);
        end = end.max(segment_end);
        entry_ok |= s.p_flags & PF_X != 0 && (s.p_paddr..segment_end).contains(&header.e_entry);
    }
    if end == 0 {
        return Err(ElfError::Empty);
    }
    if start < low || end > high {
        return Err(ElfError::DoesNotFit { start, end, low, high });
    }
    if !entry_ok {
        return Err(ElfError::Entry { entry: header.e_entry });
    }
    Ok(Extent { end, retained })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A minimal executable: one segment of 16 bytes at `address`, entry at its start.
    pub fn minimal(address: u64, file_bytes: u64, memory_bytes: u64) -> Vec<u8> {
        let mut image = vec![0u8; 64 + 56 + 16];
        let mut put = |at: usize, bytes: &[u8]| image[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"\x7fELF\x02\x01\x01");
        put(16, &2u16.to_le_bytes());
        put(18, &62u16.to_le_bytes());
        put(20, &1u32.to_le_bytes());
        put(24, &address.to_le_bytes());
        put(32, &64u64.to_le_bytes());
        put(52, &64u16.to_le_bytes());
        put(54, &56u16.to_le_bytes());
        put(56, &1u16.to_le_bytes());
        let program = 64;
        put(program, &1u32.to_le_bytes());
        put(program + 4, &5u32.to_le_bytes());
        put(program + 8, &120u64.to_le_bytes());
        put(program + 16, &address.to_le_bytes());
        put(program + 24, &address.to_le_bytes());
        put(program + 32, &file_bytes.to_le_bytes());
        put(program + 40, &memory_bytes.to_le_bytes());
        image
    }

    const LOW: u64 = 1 << 20;
    const HIGH: u64 = 2 << 20;

    #[test]
    fn a_minimal_image_is_accepted() {
        let extent = Extent { end: LOW + 32, retained: vec![] };
        assert_eq!(check(&minimal(LOW, 16, 32), LOW, HIGH), Ok(extent));
    }

    #[test]
    fn what_is_retained_has_no_content() {
        let mut image = minimal(LOW, 16, 32);
        image[64 + 4 + 2] = (RETAINED_SEGMENT >> 16) as u8;
        assert_eq!(check(&image, LOW, HIGH), Err(ElfError::Retained { start: LOW }));
        image[64 + 32] = 0;
        let extent = check(&image, LOW, HIGH).unwrap();
        assert_eq!((extent.end, extent.retained.len()), (LOW + 32, 1));
        assert_eq!(extent.retained[0], LOW..LOW + 32);
    }

    #[test]
    fn an_image_outside_the_memory_is_refused() {
        for (address, bytes) in [(LOW - 1, 16), (HIGH - 15, 16), (HIGH, 16), (LOW, 2 << 20)] {
            let result = check(&minimal(address, 16, bytes), LOW, HIGH);
            assert!(matches!(result, Err(ElfError::DoesNotFit { .. })), "{address:#x} {bytes}");
        }
    }

    #[test]
    fn a_segment_that_wraps_or_lies_about_its_size_is_refused() {
        for (address, file, memory) in
            [(u64::MAX - 7, 16, 16), (LOW, 16, 8), (LOW, 1 << 40, 1 << 41), (LOW, 17, 32)]
        {
            let result = check(&minimal(address, file, memory), LOW, HIGH);
            assert!(matches!(result, Err(ElfError::Segment { .. })), "{address:#x} {file}");
        }
    }

    #[test]
    fn another_machine_class_or_type_is_refused() {
        for (at, value) in [(18, 3), (16, 3), (16, 1)] {
            let mut image = minimal(LOW, 16, 16);
            image[at] = value;
            assert_eq!(check(&image, LOW, HIGH), Err(ElfError::Kind));
        }
    }

    #[test]
    fn an_entry_outside_the_code_is_refused() {
        let mut image = minimal(LOW, 16, 16);
        image[24] = 16;
        assert_eq!(check(&image, LOW, HIGH), Err(ElfError::Entry { entry: LOW + 16 }));
        let mut image = minimal(LOW, 16, 16);
        image[64 + 4] = 4;
        assert_eq!(check(&image, LOW, HIGH), Err(ElfError::Entry { entry: LOW }));
    }

    #[test]
    fn truncation_at_any_byte_is_refused() {
        let image = minimal(LOW, 16, 16);
        for length in 0..image.len() {
            assert!(check(&image[..length], LOW, HIGH).is_err(), "{length}");
        }
    }

    #[test]
    fn no_byte_can_make_the_check_panic() {
        let image = minimal(LOW, 16, 16);
        for at in 0..image.len() {
            for value in 0..=255 {
                let mut image = image.clone();
                image[at] = value;
                let _ = check(&image, LOW, HIGH);
            }
        }
    }
}
