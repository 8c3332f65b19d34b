//! What compiled Structured Text calls instead of having it inline: mathematical functions, searches in strings, copies.
//!
//! It is a block of bytes that the compiler puts at the start of a program's code, unchanged, so it is linked for that
//! address. A table of addresses at its start is how the compiler finds the functions. The mathematical functions are
//! those of the crate `libm`: one implementation in Rust with the same result to the last bit on every machine, which a
//! C library of the host would not give.

#![no_std]
#![no_main]

mod functions;
mod memory;
mod text;

use core::panic::PanicInfo;

use functions::Function;

/// How many functions there are.
const FUNCTIONS: usize = Function::PowerReal as usize + 1;

/// The address of a function.
#[repr(transparent)]
struct Address(*const ());

// SAFETY: an address of code is the same for every thread.
unsafe impl Sync for Address {}

macro_rules! first {
    ($first:ty $(, $rest:ty)*) => {
        $first
    };
}

macro_rules! export {
    ($($name:ident($($argument:ident: $ty:ty),*) = $function:path;)*) => {
        $(extern "C" fn $name($($argument: $ty),*) -> first!($($ty),*) { $function($($argument),*) })*
    };
}

export! {
    ln(x: f64) = libm::log;
    log(x: f64) = libm::log10;
    exp(x: f64) = libm::exp;
    sin(x: f64) = libm::sin;
    cos(x: f64) = libm::cos;
    tan(x: f64) = libm::tan;
    asin(x: f64) = libm::asin;
    acos(x: f64) = libm::acos;
    atan(x: f64) = libm::atan;
    atan2(y: f64, x: f64) = libm::atan2;
    power(base: f64, exponent: f64) = libm::pow;
    ln_real(x: f32) = libm::logf;
    log_real(x: f32) = libm::log10f;
    exp_real(x: f32) = libm::expf;
    sin_real(x: f32) = libm::sinf;
    cos_real(x: f32) = libm::cosf;
    tan_real(x: f32) = libm::tanf;
    asin_real(x: f32) = libm::asinf;
    acos_real(x: f32) = libm::acosf;
    atan_real(x: f32) = libm::atanf;
    atan2_real(y: f32, x: f32) = libm::atan2f;
    power_real(base: f32, exponent: f32) = libm::powf;
}

macro_rules! table {
    ($($place:ident = $function:path,)*) => {{
        let mut table = [const { Address(core::ptr::null()) }; FUNCTIONS];
        $(table[Function::$place as usize] = Address($function as *const ());)*
        table
    }};
}

/// What the compiler reads.
#[used]
#[unsafe(link_section = ".table")]
static TABLE: [Address; FUNCTIONS] = table! {
    Copy = memory::copy,
    Zero = memory::zero,
    LengthBytes = text::length_bytes,
    LengthUnits = text::length_units,
    CompareBytes = text::compare_bytes,
    CompareUnits = text::compare_units,
    FindBytes = text::find_bytes,
    FindUnits = text::find_units,
    Ln = ln,
    Log = log,
    Exp = exp,
    Sin = sin,
    Cos = cos,
    Tan = tan,
    Asin = asin,
    Acos = acos,
    Atan = atan,
    Atan2 = atan2,
    Power = power,
    LnReal = ln_real,
    LogReal = log_real,
    ExpReal = exp_real,
    SinReal = sin_real,
    CosReal = cos_real,
    TanReal = tan_real,
    AsinReal = asin_real,
    AcosReal = acos_real,
    AtanReal = atan_real,
    Atan2Real = atan2_real,
    PowerReal = power_real,
};

/// Nothing here panics on any input; if it did, the program would stop as it does at a trap.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: an illegal instruction ends the program; that is what is wanted.
    unsafe { core::arch::asm!("ud2", options(noreturn, nomem, nostack)) }
}
