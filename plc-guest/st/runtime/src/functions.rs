//! The functions of the runtime and their places in its table. The compiler includes this file.

/// A function that compiled code calls, by the System V calling convention. The number is its place in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum Function {
    /// `(to, from, bytes)`: the two may overlap.
    Copy,
    /// `(to, bytes)`.
    Zero,
    /// `(text, most) -> bytes before the first that is zero, at most so many`.
    LengthBytes,
    /// The same of UTF-16 units.
    LengthUnits,
    /// `(a, length of a, b, length of b) -> -1, 0 or 1`, of bytes.
    CompareBytes,
    /// The same of UTF-16 units.
    CompareUnits,
    /// `(text, length, sought, length) -> position from 1, or 0`, of bytes.
    FindBytes,
    /// The same of UTF-16 units.
    FindUnits,
    /// `(number, three arguments) -> result`: a call of the kernel.
    System,
    /// `(at, count)`: makes each byte that is not 0 a 1.
    Booleans,
    /// `(f64) -> f64`, and so on to [`Function::Power`].
    Ln,
    /// Base 10.
    Log,
    /// e to the power.
    Exp,
    /// Radians.
    Sin,
    /// Radians.
    Cos,
    /// Radians.
    Tan,
    /// Arc sine.
    Asin,
    /// Arc cosine.
    Acos,
    /// Arc tangent.
    Atan,
    /// `(y, x)`.
    Atan2,
    /// `(base, exponent)`.
    Power,
    /// `(f32) -> f32`, and so on.
    LnReal,
    /// Base 10.
    LogReal,
    /// e to the power.
    ExpReal,
    /// Radians.
    SinReal,
    /// Radians.
    CosReal,
    /// Radians.
    TanReal,
    /// Arc sine.
    AsinReal,
    /// Arc cosine.
    AcosReal,
    /// Arc tangent.
    AtanReal,
    /// `(y, x)`.
    Atan2Real,
    /// `(base, exponent)`.
    PowerReal,
}
