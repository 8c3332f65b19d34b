//! Blocks of memory: copies, zeros and constants.

use cranelift_codegen::ir::{self, ExternalName, InstBuilder, UserExternalName, Value, types};

use super::lower::{CONSTANTS, Lower};
use super::runtime;
use super::target::MEMORY;

impl Lower<'_> {
    /// The address of bytes that lie in the constants.
    pub(super) fn constant_address(&mut self, bytes: Vec<u8>) -> Value {
        let index = self.constants.len() as u32;
        self.constants.push(bytes);
        let name = self
            .builder
            .func
            .declare_imported_user_function(UserExternalName { namespace: CONSTANTS, index });
        let global = self.builder.create_global_value(ir::GlobalValueData::Symbol {
            name: ExternalName::user(name),
            offset: 0.into(),
            colocated: true,
            tls: false,
        });
        self.builder.ins().symbol_value(types::I64, global)
    }

    /// Sets memory to zero.
    pub(super) fn zero(&mut self, to: Value, size: u32) {
        if size > 64 {
            let bytes = self.builder.ins().iconst(types::I64, i64::from(size));
            self.runtime(runtime::Function::Zero, &[to, bytes], None);
            return;
        }
        for (offset, ty) in words(size) {
            let zero = self.builder.ins().iconst(ty, 0);
            self.builder.ins().store(MEMORY, zero, to, offset);
        }
    }

    /// Copies memory; the two may be the same or overlap.
    pub(super) fn copy(&mut self, to: Value, from: Value, size: u32) {
        if size > 64 {
            let bytes = self.builder.ins().iconst(types::I64, i64::from(size));
            self.runtime(runtime::Function::Copy, &[to, from, bytes], None);
            return;
        }
        let loaded: Vec<(i32, Value)> = words(size)
            .map(|(offset, ty)| (offset, self.builder.ins().load(ty, MEMORY, from, offset)))
            .collect();
        for (offset, value) in loaded {
            self.builder.ins().store(MEMORY, value, to, offset);
        }
    }
}

/// The machine words that make up `size` bytes.
fn words(size: u32) -> impl Iterator<Item = (i32, ir::Type)> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let ty = match size - at {
            0 => return None,
            1 => types::I8,
            2..=3 => types::I16,
            4..=7 => types::I32,
            _ => types::I64,
        };
        let offset = at as i32;
        at += ty.bytes();
        Some((offset, ty))
    })
}
