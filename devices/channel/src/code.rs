//! What a port service returns, as a number that other languages know.

/// The return codes of ARINC 653 part 1, with its values.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ReturnCode {
    /// The request was carried out.
    NoError = 0,
    /// The system is already so, or there is nothing to give.
    NoAction = 1,
    /// It cannot be done now.
    NotAvailable = 2,
    /// A parameter is outside what any configuration allows.
    InvalidParam = 3,
    /// A parameter disagrees with the configuration; or messages were lost before this one.
    InvalidConfig = 4,
    /// Not in this mode, or not in this direction.
    InvalidMode = 5,
    /// The time-out passed.
    TimedOut = 6,
}
