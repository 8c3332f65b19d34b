//! Functions that a routine calls: their signatures and references.

use cranelift_codegen::ir::{
    self, AbiParam, ExtFuncData, ExternalName, FuncRef, InstBuilder, Signature, UserExternalName,
    Value, types,
};
use cranelift_codegen::isa::CallConv;

use super::lower::{Lower, RUNTIME};
use super::runtime;
use super::target::register;
use crate::hir::{LocalKind, Program, Routine, Type};

impl Lower<'_> {
    pub(super) fn function(
        &mut self,
        namespace: u32,
        index: u32,
        signature: impl FnOnce() -> Signature,
    ) -> FuncRef {
        if let Some(function) = self.functions.get(&(namespace, index)) {
            return *function;
        }
        let name =
            self.builder.func.declare_imported_user_function(UserExternalName { namespace, index });
        let signature = self.builder.import_signature(signature());
        let data = ExtFuncData {
            name: ExternalName::user(name),
            signature,
            colocated: true,
            patchable: false,
        };
        let function = self.builder.import_function(data);
        self.functions.insert((namespace, index), function);
        function
    }

    /// Calls the kernel.
    pub(super) fn system(&mut self, number: u32, arguments: &[Value]) -> Value {
        let mut values = vec![self.builder.ins().iconst(types::I64, i64::from(number))];
        values.extend_from_slice(arguments);
        while values.len() < 4 {
            values.push(self.builder.ins().iconst(types::I64, 0));
        }
        match self.runtime(runtime::Function::System, &values, Some(types::I64)) {
            Some(result) => result,
            None => unreachable!("a call of the kernel has a result"),
        }
    }

    /// Calls a function of the runtime.
    pub(super) fn runtime(
        &mut self,
        function: runtime::Function,
        arguments: &[Value],
        result: Option<ir::Type>,
    ) -> Option<Value> {
        let parameters: Vec<ir::Type> =
            arguments.iter().map(|value| self.builder.func.dfg.value_type(*value)).collect();
        let callee = self.function(RUNTIME, function as u32, || {
            let mut signature = Signature::new(CallConv::SystemV);
            signature.params.extend(parameters.into_iter().map(AbiParam::new));
            signature.returns.extend(result.map(AbiParam::new));
            signature
        });
        let call = self.builder.ins().call(callee, arguments);
        self.builder.inst_results(call).first().copied()
    }
}

/// The signature of a routine: instance, address of a result that is not a scalar, parameters.
pub fn signature(program: &Program, routine: &Routine) -> Signature {
    let mut signature = Signature::new(CallConv::SystemV);
    let mut push = |ty| signature.params.push(AbiParam::new(ty));
    if routine.instance.is_some() {
        push(types::I64);
    }
    let result = routine.result.map(|id| program.types.scalar(routine.local(id).ty));
    if result == Some(None) {
        push(types::I64);
    }
    for (_, local) in routine.parameters() {
        match (local.kind, program.types.scalar(local.ty), program.types.get(local.ty)) {
            (LocalKind::Input, Some(scalar), _) => push(register(scalar)),
            (_, _, Type::OpenArray { dimensions, .. }) => {
                for _ in 0..1 + 2 * dimensions {
                    push(types::I64);
                }
            }
            _ => push(types::I64),
        }
    }
    if let Some(Some(scalar)) = result {
        signature.returns.push(AbiParam::new(register(scalar)));
    }
    signature
}
