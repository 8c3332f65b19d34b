//! The elementary types of IEC 61131-3.

use crate::code::codes;

codes! {
    /// An elementary type of IEC 61131-3 (edition 3, table 10).
    pub enum Elementary: u8 {
        /// One byte that is 0 or 1, or one bit of the process image.
        Bool = 1,
        /// Signed, 8 bits.
        Sint = 2,
        /// Signed, 16 bits.
        Int = 3,
        /// Signed, 32 bits.
        Dint = 4,
        /// Signed, 64 bits.
        Lint = 5,
        /// Unsigned, 8 bits.
        Usint = 6,
        /// Unsigned, 16 bits.
        Uint = 7,
        /// Unsigned, 32 bits.
        Udint = 8,
        /// Unsigned, 64 bits.
        Ulint = 9,
        /// Bit string, 8 bits.
        Byte = 10,
        /// Bit string, 16 bits.
        Word = 11,
        /// Bit string, 32 bits.
        Dword = 12,
        /// Bit string, 64 bits.
        Lword = 13,
        /// IEEE 754 binary32.
        Real = 14,
        /// IEEE 754 binary64.
        Lreal = 15,
        /// Signed nanoseconds, 64 bits.
        Time = 16,
        /// Signed nanoseconds, 64 bits.
        Ltime = 17,
        /// Nanoseconds since 1970-01-01, signed, 64 bits; a whole day.
        Date = 18,
        /// As `DATE`.
        Ldate = 19,
        /// Nanoseconds since midnight, 64 bits.
        Tod = 20,
        /// As `TOD`.
        Ltod = 21,
        /// Nanoseconds since 1970-01-01, signed, 64 bits.
        Dt = 22,
        /// As `DT`.
        Ldt = 23,
        /// A character, 8 bits.
        Char = 24,
        /// A character, 16 bits (UTF-16).
        Wchar = 25,
    }
}

impl Elementary {
    /// Size in bytes.
    #[must_use]
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Bool | Self::Sint | Self::Usint | Self::Byte | Self::Char => 1,
            Self::Int | Self::Uint | Self::Word | Self::Wchar => 2,
            Self::Dint | Self::Udint | Self::Dword | Self::Real => 4,
            Self::Lint | Self::Ulint | Self::Lword | Self::Lreal | Self::Time | Self::Ltime => 8,
            Self::Date | Self::Ldate | Self::Tod | Self::Ltod | Self::Dt | Self::Ldt => 8,
        }
    }

    /// The type's keyword in IEC 61131-3.
    #[must_use]
    pub const fn keyword(self) -> &'static str {
        const KEYWORDS: [&str; 25] = [
            "BOOL", "SINT", "INT", "DINT", "LINT", "USINT", "UINT", "UDINT", "ULINT", "BYTE",
            "WORD", "DWORD", "LWORD", "REAL", "LREAL", "TIME", "LTIME", "DATE", "LDATE", "TOD",
            "LTOD", "DT", "LDT", "CHAR", "WCHAR",
        ];
        KEYWORDS[self as usize - 1]
    }

    /// Whether it is one of the integer types or bit strings, which an enumeration or a subrange can have as base.
    #[must_use]
    pub const fn is_integer(self) -> bool {
        (self as u8) >= Self::Sint as u8 && (self as u8) <= Self::Lword as u8
    }
}
