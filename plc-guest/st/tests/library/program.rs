//! Programs that the tests write, and what they leave in `%M`.

use crate::machine;
use crate::oracle::{self, Job, area_address};
use std::path::{Path, PathBuf};
use takt_st::diagnostic::text;
use takt_st::hir::{Area, Program, Retention, Trap, Type, TypeId};
use takt_st::native;
use takt_st::project;
use takt_st::source::Sources;

/// A configuration that runs the program `Main` in a task.
pub const CONFIGURATION: &str = "CONFIGURATION Test RESOURCE Plc ON PLC\n\
    TASK Cycle (INTERVAL := T#1ms, PRIORITY := 1);\n\
    PROGRAM Run WITH Cycle : Main;\nEND_RESOURCE END_CONFIGURATION\n";

/// The typed tree of a program.
pub fn compile(name: &str, source: &str) -> Program {
    let mut sources = Sources::new();
    sources.add(name, source.as_bytes()).expect("a source");
    let checked = project::check("test", &mut sources).expect("a thread");
    checked.program.unwrap_or_else(|| {
        let errors = checked.diagnostics.iter().filter(|one| one.is_error());
        let shown: String = errors.take(20).map(|one| text::to_string(&sources, one)).collect();
        panic!("{name} is refused:\n{shown}")
    })
}

/// A program on the interpreter of the typed tree and as machine code at once.
pub struct Twice<'p> {
    program: &'p Program,
    interpreted: oracle::Machine<'p>,
    compiled: machine::Machine,
}

impl<'p> Twice<'p> {
    /// A cold start.
    pub fn start(program: &'p Program) -> Self {
        let native = native::compile(program).expect("machine code");
        let mut compiled = machine::Machine::load(&native);
        compiled.start();
        Self { program, interpreted: oracle::Machine::new(program), compiled }
    }

    /// A warm start, of a program all of whose instances are retained: their NON_RETAIN variables begin anew.
    pub fn restart(&mut self) {
        self.compiled.start();
        let program = self.program;
        for global in program.globals.iter().filter(|one| one.storage.area == Area::State) {
            let address = area_address(Area::State) + u64::from(global.storage.offset);
            self.begin_anew(address, global.ty, false);
        }
    }

    fn begin_anew(&mut self, address: u64, ty: TypeId, anew: bool) {
        let types = &self.program.types;
        match types.get(ty) {
            Type::Structure(structure) => {
                for field in &structure.fields {
                    let anew = match field.retention {
                        Retention::Never => true,
                        Retention::None => anew,
                        Retention::Retain | Retention::Persistent => false,
                    };
                    self.begin_anew(address + u64::from(field.offset), field.ty, anew);
                }
            }
            Type::Array { element, lower, upper } => {
                for index in 0..=(upper - lower) as u64 {
                    let bytes = u64::from(types.size(*element));
                    self.begin_anew(address + index * bytes, *element, anew);
                }
            }
            // The tests have those whose initial value is zero.
            _ if anew => self.interpreted.memory.write(address, &vec![0; types.size(ty) as usize]),
            _ => {}
        }
    }

    /// Runs the only task once.
    pub fn run(&mut self, job: Job) {
        let [task] = &self.program.tasks[..] else { panic!("one task") };
        if let Err(stop) = self.interpreted.run(task.entry, job) {
            panic!("{}: {stop:?}", self.program.name);
        }
        let Job { now_ns, elapsed_ns, cycle } = job;
        if let Err(trap) = self.compiled.run(task.entry.0 as usize, now_ns, elapsed_ns, cycle) {
            panic!("{}: {trap:?}", self.program.name);
        }
    }

    /// Runs the only task once, which traps.
    pub fn trap(&mut self, job: Job) -> Trap {
        let [task] = &self.program.tasks[..] else { panic!("one task") };
        let Err(oracle::Stop::Trap(trap)) = self.interpreted.run(task.entry, job) else {
            panic!("{}: no trap", self.program.name);
        };
        let Job { now_ns, elapsed_ns, cycle } = job;
        let compiled = self.compiled.run(task.entry.0 as usize, now_ns, elapsed_ns, cycle);
        assert_eq!(compiled, Err(trap), "machine code");
        trap
    }

    /// The DINT at `%MD index`.
    #[track_caller]
    pub fn marker(&mut self, index: usize) -> i32 {
        let address = area_address(Area::Marker) + 4 * index as u64;
        let interpreted = self.interpreted.memory.read(address, 4);
        assert_eq!(interpreted, self.compiled.read(address, 4), "machine code, %MD{index}");
        i32::from_le_bytes(interpreted.try_into().expect("four bytes"))
    }

    /// Sets the DINT at `%MD index`.
    pub fn set_marker(&mut self, index: usize, value: i32) {
        let address = area_address(Area::Marker) + 4 * index as u64;
        self.interpreted.memory.write(address, &value.to_le_bytes());
        self.compiled.write(address, &value.to_le_bytes());
    }
}

/// The tables in a folder of the repository, by name.
pub fn tables(folder: &str) -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let entries = std::fs::read_dir(&folder).expect("a folder of tables");
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    paths.sort();
    let table = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).expect("a table");
        (path.file_stem().expect("a name").to_string_lossy().into_owned(), text)
    };
    paths.into_iter().map(table).collect()
}
