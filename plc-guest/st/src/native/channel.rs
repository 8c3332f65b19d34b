//! Messages of channels.

use cranelift_codegen::ir::{InstBuilder, Value, types};

use super::lower::Lower;
use super::runtime::Function;
use super::text::View;
use crate::hir::{Area, Channel, Elementary, Expr, ExprKind, Place, Root, Type, TypeId, Types};

impl Lower<'_> {
    /// Reads a message into a variable. Its result is the kernel's.
    pub(super) fn channel_read(&mut self, channel: Channel, message: &Expr) -> Value {
        let place = variable(message);
        let at = self.address(place);
        let port = self.builder.ins().iconst(types::I64, i64::from(channel.port));
        let bytes = self.program.types.size(place.ty);
        let bytes = self.builder.ins().iconst(types::I64, i64::from(bytes));
        let result = self.system(channel.read(), &[port, at, bytes]);
        // Code relies on it that a BOOL is 0 or 1, and a stranger has written these.
        let mut found = Vec::new();
        booleans(&self.program.types, place.ty, 0, &mut found);
        for (offset, count) in found {
            let first = self.builder.ins().iadd_imm_s(at, i64::from(offset));
            let count = self.builder.ins().iconst(types::I64, i64::from(count));
            self.runtime(Function::Booleans, &[first, count], None);
        }
        result
    }

    /// Writes the first bytes of a variable. Its result is the kernel's.
    pub(super) fn channel_write(
        &mut self,
        channel: Channel,
        message: &Expr,
        length: &Expr,
    ) -> Value {
        let bytes = self.expr(length);
        let place = variable(message);
        let at = self.address(place);
        // Behind the text of a string lies what was in its memory before, which is none of the other side's business. An
        // input is not the program's: it came from outside.
        let input = matches!(place.root, Root::Global(id) if self.program.global(id).storage.area == Area::Input);
        if !input {
            self.clear_tails(at, place.ty);
        }
        let port = self.builder.ins().iconst(types::I64, i64::from(channel.port));
        self.system(channel.write(), &[port, at, bytes])
    }
}

impl Lower<'_> {
    /// Zeros behind the texts of all strings of a variable.
    fn clear_tails(&mut self, at: Value, ty: TypeId) {
        let mut found = Vec::new();
        strings(&self.program.types, ty, 0, &mut found);
        for (offset, ty) in found {
            let View { start, units } = self.view_at(at, offset as i32, ty);
            let used = self.bytes(units, self.wide(ty));
            let from = self.builder.ins().iadd(start, used);
            let size =
                self.builder.ins().iconst(types::I64, i64::from(self.program.types.size(ty)));
            let rest = self.builder.ins().isub(size, used);
            self.runtime(Function::Zero, &[from, rest], None);
        }
    }
}

fn variable(message: &Expr) -> &Place {
    match &message.kind {
        ExprKind::Reference(place) => place,
        other => unreachable!("{other:?} is no reference to a variable"),
    }
}

/// Where the strings of a type lie.
fn strings(types: &Types, ty: TypeId, at: u32, found: &mut Vec<(u32, TypeId)>) {
    for_each_part(types, ty, at, &mut |at, ty| {
        if matches!(types.get(ty), Type::String { .. } | Type::WString { .. }) {
            found.push((at, ty));
        }
    });
}

/// Where the BOOLs of a type lie, in stretches of offset and number.
fn booleans(types: &Types, ty: TypeId, at: u32, found: &mut Vec<(u32, u32)>) {
    for_each_part(types, ty, at, &mut |at, ty| {
        if !matches!(types.get(ty), Type::Elementary(Elementary::Bool)) {
            return;
        }
        match found.last_mut() {
            Some((first, count)) if *first + *count == at => *count += 1,
            _ => found.push((at, 1)),
        }
    });
}

/// Shows each part of a type that has no parts itself, in the order of their places. There is at most one for each byte of
/// a message.
fn for_each_part(types: &Types, ty: TypeId, at: u32, show: &mut dyn FnMut(u32, TypeId)) {
    match types.get(ty) {
        Type::Array { element, lower, upper } => {
            let size = types.size(*element);
            for index in 0..=(upper - lower) as u32 {
                for_each_part(types, *element, at + index * size, show);
            }
        }
        Type::Structure(structure) => {
            for field in &structure.fields {
                for_each_part(types, field.ty, at + field.offset, show);
            }
        }
        _ => show(at, ty),
    }
}
