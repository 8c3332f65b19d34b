//! The hash of an image, and of the layout of its variables.

use sha2::{Digest, Sha256};

use crate::Image;
use crate::error::{ImageError, Where};
use crate::layout::{header, variable};
use crate::section::SectionKind;
use crate::variable::Flags;

/// SHA-256 of a file with hash, key and signature counted as zero. Signing does not change it.
pub(crate) fn of_file(file: &[u8]) -> [u8; 32] {
    const SKIPPED: core::ops::Range<usize> = header::HASH.start..header::SIGNATURE.end;
    let before = file.get(..SKIPPED.start).unwrap_or_default();
    let after = file.get(SKIPPED.end..).unwrap_or_default();
    let zeros = [0; SKIPPED.end - SKIPPED.start];
    Sha256::new().chain_update(before).chain_update(zeros).chain_update(after).finalize().into()
}

/// SHA-256 of everything that says where a value lies and what it means.
///
/// These are, in this order: size of the state (4 bytes); each type record without its reference to a name, followed by
/// the name and a zero; each field and enumerator likewise; each variable's record up to its size, with only the
/// flags RETAIN and PERSISTENT, likewise. Not in it: writers, lines, and what operators may do.
pub(crate) fn of_layout(image: &Image<'_>) -> [u8; 32] {
    let mut hash = Sha256::new().chain_update(image.state_bytes().to_le_bytes());
    let mut add = |record: &[u8], name_at: usize, name: &str| {
        let (before, rest) = record.split_at(name_at.min(record.len()));
        hash.update(before);
        hash.update(rest.get(8..).unwrap_or_default());
        hash.update(name.as_bytes());
        hash.update([0]);
    };
    for kind in [SectionKind::Types, SectionKind::Fields, SectionKind::Enumerators] {
        for index in image.indices(kind) {
            let name_at = if kind == SectionKind::Types { crate::layout::ty::NAME } else { 0 };
            let record = image.record(kind, index);
            add(record.bytes(), name_at, image.strings().get(record.text(name_at)));
        }
    }
    let kept = Flags::RETAIN.with(Flags::PERSISTENT).bits();
    for index in image.indices(SectionKind::Variables) {
        let record = image.record(SectionKind::Variables, index);
        let mut bytes = [0; variable::WRITER];
        bytes.copy_from_slice(
            record.bytes().get(..variable::WRITER).unwrap_or(&[0; variable::WRITER]),
        );
        let flags = (record.u16(variable::FLAGS) & kept).to_le_bytes();
        bytes[variable::FLAGS..variable::FLAGS + 2].copy_from_slice(&flags);
        add(&bytes, variable::NAME, image.strings().get(record.text(variable::NAME)));
    }
    hash.finalize().into()
}

impl<'a> Image<'a> {
    /// As [`Image::parse`], and also compares the hashes and, with the feature `signature`, the signature if
    /// there is one. Whether the key of the signature is one to trust is the caller's to say:
    /// see [`Image::key`].
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn verify(file: &'a [u8]) -> Result<Self, ImageError> {
        let image = Self::parse(file)?;
        let whence = Where::new(0, "header", 0);
        let same = of_file(file) == image.hash();
        whence.rule(same, "hash", "the content has changed since the image was made")?;
        let same = of_layout(&image) == image.layout_hash();
        whence.rule(same, "layout hash", "it is not that of the variables")?;
        #[cfg(feature = "signature")]
        whence.rule(
            crate::signature::is_good(&image),
            "signature",
            "it is not that of the key for this image",
        )?;
        Ok(image)
    }
}
