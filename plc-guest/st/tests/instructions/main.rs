//! How many instructions programs take: against gcc, and against the bound that is worked out from their code.

#[path = "../generate/mod.rs"]
mod generate;
#[path = "../machine/mod.rs"]
mod machine;
#[path = "../oracle/mod.rs"]
mod oracle;

mod count;
mod speed;
mod worst;

use takt_st::hir::Program;
use takt_st::{project, source::Sources};

fn program(source: &str) -> Program {
    let mut sources = Sources::new();
    sources.add("main.st", source.as_bytes()).unwrap();
    project::check("kernel", &mut sources).unwrap().program.unwrap()
}

/// The source of a kernel, or another file of the folder.
fn of_speed(name: &str) -> String {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("speed");
    std::fs::read_to_string(folder.join(name)).unwrap()
}
