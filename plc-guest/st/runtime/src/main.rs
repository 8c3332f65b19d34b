//! What compiled Structured Text calls instead of having it inline: mathematical functions, searches in strings,
//! copies.
//!
//! It is a block of bytes that the compiler puts at the start of a program's code, unchanged, so it is linked for that
//! address. A table of addresses at its start is how the compiler finds the functions. The mathematical functions are
//! those of the crate `libm`: one implementation in Rust with the same result to the last bit on every machine, which a
//! C library of the host would not give.

#![no_std]
#![no_main]

mod functions;
mod memory;
mod system;
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

/// The table of all functions. Those of reals have a form for LREAL and one for REAL, which differ by the type alone.
macro_rules! table {
    (
        functions { $($place:ident = $function:path,)* }
        of_reals { $($long:ident, $short:ident($($argument:ident),*) = $of_long:path, $of_short:path;)* }
    ) => {{
        let mut table = [const { Address(core::ptr::null()) }; FUNCTIONS];
        $(table[Function::$place as usize] = Address($function as *const ());)*
        $({
            extern "C" fn long($($argument: f64),*) -> f64 {
                $of_long($($argument),*)
            }
            extern "C" fn short($($argument: f32),*) -> f32 {
                $of_short($($argument),*)
            }
            table[Function::$long as usize] = Address(long as *const ());
            table[Function::$short as usize] = Address(short as *const ());
        })*
        table
    }};
}

/// What the compiler reads.
#[used]
#[unsafe(link_section = ".table")]
static TABLE: [Address; FUNCTIONS] = table! {
    functions {
        Copy = memory::copy,
        Zero = memory::zero,
        LengthBytes = text::length_bytes,
        LengthUnits = text::length_units,
        CompareBytes = text::compare_bytes,
        CompareUnits = text::compare_units,
        FindBytes = text::find_bytes,
        FindUnits = text::find_units,
        System = system::call,
        Booleans = memory::booleans,
    }
    of_reals {
        Ln, LnReal(x) = libm::log, libm::logf;
        Log, LogReal(x) = libm::log10, libm::log10f;
        Exp, ExpReal(x) = libm::exp, libm::expf;
        Sin, SinReal(x) = libm::sin, libm::sinf;
        Cos, CosReal(x) = libm::cos, libm::cosf;
        Tan, TanReal(x) = libm::tan, libm::tanf;
        Asin, AsinReal(x) = libm::asin, libm::asinf;
        Acos, AcosReal(x) = libm::acos, libm::acosf;
        Atan, AtanReal(x) = libm::atan, libm::atanf;
        Atan2, Atan2Real(y, x) = libm::atan2, libm::atan2f;
        Power, PowerReal(base, exponent) = libm::pow, libm::powf;
    }
};

/// Nothing here panics on any input; if it did, the program would stop as it does at a trap.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: an illegal instruction ends the program; that is what is wanted.
    unsafe { core::arch::asm!("ud2", options(noreturn, nomem, nostack)) }
}
