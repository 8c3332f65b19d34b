//! Which types a value may change to, and how it does.
//!
//! Only conversions that lose nothing are made: those that IEC 61131-3 (edition 3, table 11) makes without being asked,
//! each value of the old type being one of the new type. A value that might not fit is not converted: its variable
//! begins with its initial value, and the engineer is told before.

use takt_program::Elementary;

/// A conversion that loses nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conversion {
    from: Elementary,
    to: Elementary,
}

/// How a type is kept in memory.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    /// One bit in a byte.
    Bool,
    Signed,
    Unsigned,
    /// A bit string.
    Bits,
    Float,
    /// A time, a date, a character: only the same one is alike.
    Other(u8),
}

fn form(elementary: Elementary) -> Form {
    use Elementary as E;
    match elementary {
        E::Bool => Form::Bool,
        E::Sint | E::Int | E::Dint | E::Lint => Form::Signed,
        E::Usint | E::Uint | E::Udint | E::Ulint => Form::Unsigned,
        E::Byte | E::Word | E::Dword | E::Lword => Form::Bits,
        E::Real | E::Lreal => Form::Float,
        E::Time | E::Ltime => Form::Other(0),
        E::Date | E::Ldate => Form::Other(1),
        E::Tod | E::Ltod => Form::Other(2),
        E::Dt | E::Ldt => Form::Other(3),
        E::Char => Form::Other(4),
        E::Wchar => Form::Other(5),
    }
}

/// Whether values of both types are the same bytes with the same meaning: `TIME` and `LTIME`, say.
#[must_use]
pub fn alike(from: Elementary, to: Elementary) -> bool {
    form(from) == form(to) && from.bytes() == to.bytes()
}

impl Conversion {
    /// The conversion between two types, if it loses nothing and changes the bytes.
    #[must_use]
    pub fn between(from: Elementary, to: Elementary) -> Option<Self> {
        let wider = from.bytes() < to.bytes();
        // The bits of a mantissa, with the leading one.
        let exact = if to == Elementary::Real { 24 } else { 53 };
        let legal = match (form(from), form(to)) {
            (Form::Signed, Form::Signed)
            | (Form::Unsigned, Form::Unsigned | Form::Signed)
            | (Form::Bits, Form::Bits)
            | (Form::Float, Form::Float) => wider,
            (Form::Signed | Form::Unsigned, Form::Float) => 8 * from.bytes() <= exact,
            // A BOOL is a byte that is 0 or 1.
            (Form::Bool, Form::Bits) => wider,
            _ => false,
        };
        legal.then_some(Self { from, to })
    }

    /// The type of the value that is read.
    #[must_use]
    pub const fn from(self) -> Elementary {
        self.from
    }

    /// The type of the value that is written.
    #[must_use]
    pub const fn to(self) -> Elementary {
        self.to
    }

    /// The bytes of the new value, as a number whose lowest [`Elementary::bytes`] bytes count; those of the old value
    /// are given likewise.
    #[must_use]
    pub fn value(self, old: u64) -> u64 {
        let bits = 8 * self.from.bytes();
        let old = if bits < 64 { old & ((1 << bits) - 1) } else { old };
        let signed = ((old << (64 - bits)) as i64) >> (64 - bits);
        match (form(self.from), form(self.to), self.to) {
            (Form::Float, _, _) => f64::from(f32::from_bits(old as u32)).to_bits(),
            (Form::Signed, Form::Float, Elementary::Real) => u64::from((signed as f32).to_bits()),
            (Form::Signed, Form::Float, _) => (signed as f64).to_bits(),
            (_, Form::Float, Elementary::Real) => u64::from((old as f32).to_bits()),
            (_, Form::Float, _) => (old as f64).to_bits(),
            (Form::Signed, _, _) => signed as u64,
            _ => old,
        }
    }
}
