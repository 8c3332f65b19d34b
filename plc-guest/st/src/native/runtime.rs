//! The block of functions at the start of a program's code; see the crate in `runtime`.

#[path = "../../runtime/src/functions.rs"]
mod functions;

pub use functions::Function;

use super::target::address::CODE;

/// The block, linked for the address where code begins.
pub const IMAGE: &[u8] = include_bytes!(env!("TAKT_ST_RUNTIME"));

/// A function's offset in the block.
pub fn offset(function: u32) -> u32 {
    let at = function as usize * 8;
    let mut bytes = [0; 8];
    bytes.copy_from_slice(&IMAGE[at..at + 8]);
    (u64::from_le_bytes(bytes) - CODE) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_function_is_in_the_block() {
        let functions = Function::PowerReal as u32 + 1;
        for function in 0..functions {
            let offset = offset(function);
            assert!(
                offset >= functions * 8 && (offset as usize) < IMAGE.len(),
                "function {function} at {offset:#x}"
            );
        }
    }
}
