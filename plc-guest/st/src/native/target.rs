//! The machine that is compiled for: x86-64 without an operating system, at ring 3 of a PLC partition.

use std::sync::Arc;

use cranelift_codegen::ir::{self, MemFlagsData, types};
use cranelift_codegen::isa::{self, OwnedTargetIsa};
use cranelift_codegen::settings::{self, Configurable};

use crate::hir::{Class, Elementary};

/// Where the areas of every program lie; the same numbers as in the crate of the program image.
pub mod address {
    pub use takt_program::address::{
        CODE, INPUT, MARKER, OUTPUT, STACK_SLOT, STACKS, STATE, TASK_INFORMATION,
    };
}

/// The settings of the code generator.
///
/// - Not position independent, no stack probes, no unwind tables: the addresses are fixed, the stack has a guard page
///   and a bound that is known, and nothing unwinds.
/// - SSE4.1 because without it rounding is a call. Every processor with the virtualisation that Takt needs has it.
pub fn machine() -> OwnedTargetIsa {
    let mut flags = settings::builder();
    for (name, value) in [
        ("opt_level", "speed"),
        ("is_pic", "false"),
        ("enable_probestack", "false"),
        ("unwind_info", "false"),
        ("machine_code_cfg_info", "true"),
        ("enable_verifier", if cfg!(debug_assertions) { "true" } else { "false" }),
    ] {
        if let Err(error) = flags.set(name, value) {
            unreachable!("{name} is a setting of this version of Cranelift: {error}");
        }
    }
    let triple = target_lexicon();
    let mut builder = match isa::lookup(triple) {
        Ok(builder) => builder,
        Err(error) => unreachable!("Cranelift is built with x86-64: {error}"),
    };
    for feature in ["has_sse3", "has_ssse3", "has_sse41"] {
        if let Err(error) = builder.enable(feature) {
            unreachable!("{feature} is a setting of this version of Cranelift: {error}");
        }
    }
    let result: Result<Arc<dyn isa::TargetIsa>, _> = builder.finish(settings::Flags::new(flags));
    match result {
        Ok(machine) => machine,
        Err(error) => unreachable!("the settings agree with each other: {error}"),
    }
}

fn target_lexicon() -> target_lexicon::Triple {
    match "x86_64-unknown-none-elf".parse() {
        Ok(triple) => triple,
        Err(error) => unreachable!("a known triple: {error}"),
    }
}

/// Memory of a program: always mapped. Alignment is not promised, because %I, %Q and %M have none.
pub const MEMORY: MemFlagsData = MemFlagsData::new().with_notrap();

/// The register type of an elementary type.
pub fn register(ty: Elementary) -> ir::Type {
    match (ty.class(), ty.size()) {
        (Class::Float, 4) => types::F32,
        (Class::Float, _) => types::F64,
        (_, 1) => types::I8,
        (_, 2) => types::I16,
        (_, 4) => types::I32,
        _ => types::I64,
    }
}
