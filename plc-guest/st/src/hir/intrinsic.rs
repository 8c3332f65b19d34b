//! Functions that the compiler knows, because ST cannot express them or because they are one machine instruction.

use takt_program::call::Call;

/// A function of the compiler. "Same type" means the type of the expression.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Intrinsic {
    /// Absolute value of a signed integer, which wraps, or a real. Same type.
    Abs,
    /// Square root of a real. Same type.
    Sqrt,
    /// Natural logarithm of a real. Same type.
    Ln,
    /// Logarithm to base 10 of a real. Same type.
    Log,
    /// e to the power of a real. Same type.
    Exp,
    /// Sine of a real in radians. Same type.
    Sin,
    /// Cosine of a real in radians. Same type.
    Cos,
    /// Tangent of a real in radians. Same type.
    Tan,
    /// Principal arc sine of a real. Same type.
    Asin,
    /// Principal arc cosine of a real. Same type.
    Acos,
    /// Principal arc tangent of a real. Same type.
    Atan,
    /// Angle of the point (x, y): `ATAN2(y, x)`. Same type.
    Atan2,
    /// `EXPT(base, exponent)`, both LREAL or both REAL. Same type.
    Power,
    /// The lesser of two scalars or strings of the same type. If one real is NaN, the second operand.
    Min,
    /// The greater of two scalars or strings of the same type. If one real is NaN, the second operand.
    Max,
    /// `LIMIT(mn, in, mx)` of reals. NaN of `in` is handed on; a limit that is NaN is none. Same type.
    Limit,
    /// `SEL(g, in0, in1)`: in0 if the BOOL is FALSE, else in1. Both are evaluated. Same type.
    Select,
    /// `SHL(in, n)`: bits shifted left; n is LINT. All bits gone from the width of the type on; n below 0 shifts
    /// nothing.
    ShiftLeft,
    /// `SHR(in, n)`: like [`Intrinsic::ShiftLeft`] to the right, zeros from the left.
    ShiftRight,
    /// `ROL(in, n)`: n is LINT, taken modulo the width.
    RotateLeft,
    /// `ROR(in, n)`: n is LINT, taken modulo the width.
    RotateRight,
    /// Length of a string in units, up to the first that is zero. LINT.
    Length,
    /// `LEFT(string, n)`: the first n units; n is LINT, taken between 0 and the length.
    Left,
    /// `RIGHT(string, n)`: the last n units, likewise.
    Right,
    /// `MID(string, n, p)`: n units from position p, counted from 1. Both LINT. What lies outside of the string is left
    /// out.
    Mid,
    /// Two strings, one after the other. What exceeds the type's capacity is cut.
    Concat,
    /// `FIND(string, sought)`: the position, from 1, of the first occurrence; 0 if there is none or `sought` is empty.
    /// LINT.
    Find,
    /// `CHAR_AT(string, p)`: the unit at position p (LINT), from 1, as BYTE or WORD; 0 if there is none.
    UnitAt,
    /// A string of one unit, which is a BYTE or CHAR for STRING, a WORD or WCHAR for WSTRING.
    FromUnit,
    /// The scheduled time of this release since the start of the partition. TIME.
    Now,
    /// The time since the task's last release, 0 at the first. TIME.
    Elapsed,
    /// How often the task ran before. ULINT.
    Cycle,
    /// `LOG_LINE(string)`: a line for the log of the partition; what is longer than a line is cut. Its value, a LINT,
    /// is 0 or the kernel's error.
    LogLine,
    /// `CHANNEL_READ(port, message)`: reads a message into the variable of which the argument is a reference. LINT:
    /// the message's length, or the kernel's error. A BOOL in it is 0 or 1 behind it, whatever came.
    ChannelRead(Channel),
    /// `CHANNEL_WRITE(port, message, length)`: writes the first bytes of the variable of which the first argument is a
    /// reference. LINT: 0 or the kernel's error.
    ChannelWrite(Channel),
    /// A test asks its runner for something: which is a constant of [`Simulation`], and a LINT that goes with it. Its
    /// value means nothing. Whatever has an address may have changed behind it.
    Simulate(Simulation),
}

/// An end of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Channel {
    /// The index in [`super::Program::ports`].
    pub port: u32,
    /// The other end of it, which a test has: it reads what the program writes.
    pub peer: bool,
}

impl Channel {
    /// The number of the call that reads here.
    pub fn read(self) -> u32 {
        if self.peer { Simulation::Take as u32 } else { Call::ChannelRead.code() }
    }

    /// The number of the call that writes here.
    pub fn write(self) -> u32 {
        if self.peer { Simulation::Give as u32 } else { Call::ChannelWrite.code() }
    }
}

/// What a test asks its runner for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Simulation {
    /// An assertion does not hold: its index in [`super::Tests::assertions`]. The test ends.
    Fail = 0x7400_0000,
    /// The cycle is over, and the next one begins so many nanoseconds later.
    Advance = 0x7400_0001,
    /// The tasks of the project run for so many nanoseconds.
    Run = 0x7400_0002,
    /// A message that the program wrote: as the kernel's call to read one, from the other end.
    Take = 0x7400_0003,
    /// A message for the program: as the kernel's call to write one, at the other end.
    Give = 0x7400_0004,
}

impl Simulation {
    /// The request of this number, which is that of a call no kernel has.
    pub fn of(number: u64) -> Option<Simulation> {
        use Simulation::*;
        [Fail, Advance, Run, Take, Give].into_iter().find(|request| *request as u64 == number)
    }
}
