//! The elementary types: how wide they are and what values they have.

/// The elementary types of IEC 61131-3:2013, table 10, without the strings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)] // The names are the standard's.
pub enum Elementary {
    Bool,
    Sint,
    Int,
    Dint,
    Lint,
    Usint,
    Uint,
    Udint,
    Ulint,
    Byte,
    Word,
    Dword,
    Lword,
    Real,
    Lreal,
    Time,
    Ltime,
    Date,
    Ldate,
    Tod,
    Ltod,
    Dt,
    Ldt,
    Char,
    Wchar,
}

/// How the values of an elementary type are represented and computed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// One byte, 0 or 1.
    Bool,
    /// Two's complement. Times and dates are of this class: 64 bits, in nanoseconds, dates since 1970-01-01.
    Signed,
    /// Unsigned. Bit strings and characters are of this class.
    Unsigned,
    /// IEEE 754 binary32 or binary64.
    Float,
}

impl Elementary {
    /// All elementary types, in the order of their declaration.
    pub const ALL: [Elementary; 25] = {
        use Elementary::*;
        [
            Bool, Sint, Int, Dint, Lint, Usint, Uint, Udint, Ulint, Byte, Word, Dword, Lword, Real,
            Lreal, Time, Ltime, Date, Ldate, Tod, Ltod, Dt, Ldt, Char, Wchar,
        ]
    };

    /// The size of a value in bytes, which is its alignment too.
    pub fn size(self) -> u32 {
        use Elementary::*;
        match self {
            Bool | Sint | Usint | Byte | Char => 1,
            Int | Uint | Word | Wchar => 2,
            Dint | Udint | Dword | Real => 4,
            Lint | Ulint | Lword | Lreal | Time | Ltime | Date | Ldate | Tod | Ltod | Dt | Ldt => 8,
        }
    }

    /// How values are represented.
    pub fn class(self) -> Class {
        use Elementary::*;
        match self {
            Bool => Class::Bool,
            Sint | Int | Dint | Lint | Time | Ltime | Date | Ldate | Tod | Ltod | Dt | Ldt => {
                Class::Signed
            }
            Usint | Uint | Udint | Ulint | Byte | Word | Dword | Lword | Char | Wchar => {
                Class::Unsigned
            }
            Real | Lreal => Class::Float,
        }
    }

    /// The type's name in the standard.
    pub fn name(self) -> &'static str {
        use Elementary::*;
        match self {
            Bool => "BOOL",
            Sint => "SINT",
            Int => "INT",
            Dint => "DINT",
            Lint => "LINT",
            Usint => "USINT",
            Uint => "UINT",
            Udint => "UDINT",
            Ulint => "ULINT",
            Byte => "BYTE",
            Word => "WORD",
            Dword => "DWORD",
            Lword => "LWORD",
            Real => "REAL",
            Lreal => "LREAL",
            Time => "TIME",
            Ltime => "LTIME",
            Date => "DATE",
            Ldate => "LDATE",
            Tod => "TOD",
            Ltod => "LTOD",
            Dt => "DT",
            Ldt => "LDT",
            Char => "CHAR",
            Wchar => "WCHAR",
        }
    }

    /// The least and the greatest value of an integer class or of BOOL; `None` for REAL and LREAL.
    pub fn range(self) -> Option<(i128, i128)> {
        let bits = self.size() * 8;
        match self.class() {
            Class::Bool => Some((0, 1)),
            Class::Signed => Some((-(1 << (bits - 1)), (1 << (bits - 1)) - 1)),
            Class::Unsigned => Some((0, (1 << bits) - 1)),
            Class::Float => None,
        }
    }

    /// `value` modulo the type's width: what an integer operation that overflows leaves. Unchanged for REAL and LREAL.
    pub fn wrap(self, value: i128) -> i128 {
        let bits = self.size() * 8;
        match self.class() {
            Class::Bool => i128::from(value != 0),
            Class::Signed => (value << (128 - bits)) >> (128 - bits),
            Class::Unsigned => value & ((1 << bits) - 1),
            Class::Float => value,
        }
    }
}
