//! Programs that the tests write, and what they leave in `%M`.

use crate::oracle::{Job, Machine, area_address};
use std::path::{Path, PathBuf};
use takt_st::diagnostic::text;
use takt_st::hir::{Area, Program};
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

/// Runs the only task once.
pub fn run(machine: &mut Machine<'_>, program: &Program, job: Job) {
    let [task] = &program.tasks[..] else { panic!("one task") };
    if let Err(stop) = machine.run(task.entry, job) {
        panic!("{}: {stop:?}", program.name);
    }
}

/// The DINT at `%MD index`.
pub fn marker(machine: &mut Machine<'_>, index: usize) -> i32 {
    let address = area_address(Area::Marker) + 4 * index as u64;
    let bytes = machine.memory.read(address, 4);
    i32::from_le_bytes(bytes.try_into().expect("four bytes"))
}

/// Sets the DINT at `%MD index`.
pub fn set_marker(machine: &mut Machine<'_>, index: usize, value: i32) {
    machine.memory.write(area_address(Area::Marker) + 4 * index as u64, &value.to_le_bytes());
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
