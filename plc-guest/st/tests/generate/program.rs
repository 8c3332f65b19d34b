//! Random programs: types, variables, functions, function blocks, one task.

use takt_st::hir::{
    Area, Constant, Elementary, Global, Local, LocalId, LocalKind, Location, Place, Program,
    Retention, Root, Routine, RoutineId, Section, Storage, StructureKind, Task, TaskKind, TypeId,
};

use super::{Callable, Generator, Random};

/// Rounds of a loop: few, so that loops in loops end soon.
const ROUNDS: u32 = 12;

pub fn generate(seed: u64) -> Program {
    let mut program = Program::new("random");
    program.loop_budget = ROUNDS;
    program.files.push("random.st".to_owned());
    let mut generator = Generator {
        random: Random::new(seed),
        program,
        readable: Vec::new(),
        writable: Vec::new(),
        functions: Vec::new(),
        instances: Vec::new(),
        locals: Vec::new(),
        open: Vec::new(),
        lines: 0,
        counters: Vec::new(),
        loops: 0,
        size: 0,
    };
    generator.variables();
    let globals = generator.writable.clone();
    for _ in 0..generator.random.below(3) {
        generator.function(&globals);
    }
    generator.function_block(&globals);
    generator.main(&globals);
    generator.program
}

impl Generator {
    fn global(&mut self, ty: TypeId, storage: Option<Storage>) -> Place {
        let location = self.here();
        let name = format!("g{}", self.program.globals.len());
        let initial = if self.program.types.scalar(ty).is_some() && storage.is_none() {
            match self.constant(ty).kind {
                takt_st::hir::ExprKind::Constant(constant) => constant,
                _ => Constant::Default,
            }
        } else {
            Constant::Default
        };
        let id = match storage {
            None => self.program.add_state(&name, ty, initial, location),
            Some(storage) => self.program.add_global(Global {
                name,
                ty,
                storage,
                initial,
                retention: Retention::None,
                constant: false,
                location,
            }),
        };
        let place = Place::global(id, ty);
        self.readable.push(place.clone());
        if storage.is_none_or(|storage| storage.area != Area::Input) {
            self.writable.push(place.clone());
        }
        place
    }

    fn structure(&mut self, name: &str, kind: StructureKind, fields: &[TypeId]) -> TypeId {
        let id = self.program.types.declare(name, kind);
        for (index, field) in fields.iter().enumerate() {
            let name = format!("f{index}");
            let initial = Constant::Default;
            self.program.types.define(
                id,
                &name,
                *field,
                initial,
                Section::Variable,
                Retention::None,
            );
        }
        self.program.types.complete(id);
        id
    }

    fn variables(&mut self) {
        let scalars: Vec<TypeId> =
            Elementary::ALL.into_iter().map(|ty| self.elementary(ty)).collect();
        let [bool, dint, real, lreal, dword, int, byte] = [
            Elementary::Bool,
            Elementary::Dint,
            Elementary::Real,
            Elementary::Lreal,
            Elementary::Dword,
            Elementary::Int,
            Elementary::Byte,
        ]
        .map(|ty| self.elementary(ty));
        let types = &mut self.program.types;
        let (string, wstring) = (types.string(9), types.wstring(5));
        let percent = types.subrange("percent", Elementary::Int, -100, 100);
        let reference = types.reference(dint);
        let numbers = types.array(dint, -3, 4);
        let reals = types.array(real, 1, 7);
        let rows = types.array(lreal, 0, 2);
        let matrix = types.array(rows, 1, 3);
        let texts = types.array(string, 0, 2);
        let line = types.array(dint, 0, 4);
        let table = types.array(line, -1, 2);
        let bytes = types.array(byte, 1, 16);
        let shorts = types.array(int, 0, 7);
        let record = self.structure(
            "record",
            StructureKind::Struct,
            &[bool, dint, string, reals, percent, real],
        );
        let records = self.program.types.array(record, 5, 7);
        for ty in scalars {
            self.global(ty, None);
        }
        let more = [
            bool, dint, dint, real, lreal, dword, int, string, string, wstring, percent, reference,
            numbers, reals, matrix, texts, record, records, table, bytes, shorts,
        ];
        for ty in more {
            self.global(ty, None);
        }
        for (area, first) in [(Area::Input, 0), (Area::Output, 8), (Area::Marker, 3)] {
            self.global(bool, Some(Storage { area, offset: first, bit: Some(5) }));
            self.global(int, Some(Storage { area, offset: first + 2, bit: None }));
            // Lies over the one before.
            self.global(dint, Some(Storage { area, offset: first + 1, bit: None }));
            self.global(real, Some(Storage { area, offset: first + 6, bit: None }));
        }
    }

    fn begin(&mut self, globals: &[Place], statements: u32) {
        self.readable = self.program_places();
        self.writable = globals.to_vec();
        self.locals.clear();
        self.open.clear();
        self.size = statements;
    }

    fn program_places(&self) -> Vec<Place> {
        let globals = self.program.globals.iter().enumerate();
        globals
            .map(|(index, global)| Place::global(takt_st::hir::GlobalId(index as u32), global.ty))
            .collect()
    }

    fn local(&mut self, ty: TypeId, kind: LocalKind, initial: Constant) -> LocalId {
        let id = LocalId(self.locals.len() as u32);
        self.locals.push(Local { name: format!("l{}", id.0), ty, kind, initial });
        let place = Place::local(id, ty);
        if matches!(self.program.types.get(ty), takt_st::hir::Type::OpenArray { .. }) {
            self.open.push(place);
        } else {
            self.readable.push(place.clone());
            self.writable.push(place);
        }
        id
    }

    fn function(&mut self, globals: &[Place]) {
        self.begin(globals, 14);
        let [dint, real, lint, string] =
            [Elementary::Dint, Elementary::Real, Elementary::Lint, Elementary::Bool]
                .map(|ty| self.elementary(ty));
        let text = self.program.types.string(9);
        let numbers = self.program.types.array(dint, -3, 4);
        let open = self.program.types.open_array(dint, 1);
        let record = self.program.types.iter().find_map(|(id, ty)| match ty {
            takt_st::hir::Type::Structure(structure) if structure.name == "record" => Some(id),
            _ => None,
        });
        let record = record.expect("made with the variables");
        let choices = [
            (dint, LocalKind::Input),
            (real, LocalKind::InOut),
            (dint, LocalKind::InOut),
            (text, LocalKind::Input),
            (text, LocalKind::InOut),
            (record, LocalKind::Input),
            (record, LocalKind::InOut),
            (open, LocalKind::InOut),
            (numbers, LocalKind::Input),
            (string, LocalKind::Output),
            (text, LocalKind::Output),
            (lint, LocalKind::Output),
        ];
        for _ in 0..self.random.below(5) {
            let (ty, kind) = *self.random.pick(&choices);
            self.local(ty, kind, Constant::Default);
        }
        let parameters = self.locals.clone();
        let result_type = *self.random.pick(&[dint, real, lint, text]);
        let result = self.local(result_type, LocalKind::Variable, Constant::Default);
        self.local(dint, LocalKind::Variable, Constant::Integer(7));
        self.local(text, LocalKind::Variable, Constant::String(b"abc".to_vec()));
        self.local(record, LocalKind::Variable, Constant::Default);
        let body = self.block(3);
        let location = Location::default();
        let name = format!("function{}", self.functions.len());
        let locals = std::mem::take(&mut self.locals);
        let routine =
            Routine { name, instance: None, locals, result: Some(result), body, location };
        let id = self.program.add_routine(routine);
        self.functions.push(Callable { id, parameters, result: Some(result_type) });
    }

    fn function_block(&mut self, globals: &[Place]) {
        self.begin(globals, 14);
        let [bool, dint, real] =
            [Elementary::Bool, Elementary::Dint, Elementary::Real].map(|ty| self.elementary(ty));
        let string = self.program.types.string(9);
        let reals = self.program.types.array(real, 1, 7);
        let fields = [bool, dint, dint, real, real, string, reals];
        let block = self.structure("block", StructureKind::FunctionBlock, &fields);
        let instance = Place { root: Root::Instance, path: Vec::new(), ty: block };
        for _ in 0..4 {
            self.readable.push(instance.clone());
            self.writable.push(instance.clone());
        }
        let open = self.program.types.open_array(dint, 1);
        for _ in 0..self.random.below(3) {
            self.local(open, LocalKind::InOut, Constant::Default);
        }
        let parameters = self.locals.clone();
        let body = self.block(3);
        let locals = std::mem::take(&mut self.locals);
        let location = Location::default();
        let id = self.program.add_routine(Routine {
            name: "block".to_owned(),
            instance: Some(block),
            locals,
            result: None,
            body,
            location,
        });
        self.begin(globals, 0);
        let one = self.global(block, None);
        let several = self.program.types.array(block, 0, 3);
        let several = self.global(several, None);
        let block = Callable { id, parameters, result: None };
        self.instances = vec![(one, block.clone()), (several, block)];
    }

    fn main(&mut self, globals: &[Place]) {
        self.begin(globals, 40);
        let instances: Vec<Place> = self.instances.iter().map(|(place, _)| place.clone()).collect();
        self.writable.extend(instances);
        let dint = self.elementary(Elementary::Dint);
        let string = self.program.types.string(9);
        self.local(dint, LocalKind::Variable, Constant::Default);
        self.local(string, LocalKind::Variable, Constant::Default);
        let mut body = Vec::new();
        while self.size > 0 {
            body.extend(self.block(4));
        }
        let location = Location::default();
        let locals = std::mem::take(&mut self.locals);
        let entry: RoutineId = self.program.add_routine(Routine {
            name: "main".to_owned(),
            instance: None,
            locals,
            result: None,
            body,
            location,
        });
        self.program.tasks.push(Task {
            name: "main".to_owned(),
            kind: TaskKind::Cyclic { period_ns: 1_000_000, offset_ns: 0 },
            priority: 1,
            budget_ns: 0,
            deadline_ns: 0,
            entry,
            location,
        });
    }
}
