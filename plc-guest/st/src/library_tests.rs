//! The library compiles, block by block.

use super::FILES;
use crate::diagnostic::text;
use crate::project;
use crate::source::Sources;
use std::fmt::Write;

#[test]
fn every_block_of_the_library_can_be_declared_and_called_without_a_message() {
    let lines = FILES.iter().flat_map(|(_, text)| text.lines());
    let blocks: Vec<&str> = lines.filter_map(|line| line.strip_prefix("FUNCTION_BLOCK ")).collect();
    assert!(blocks.len() > 30, "{blocks:?}");
    let mut source = String::from("PROGRAM Main\nVAR\n");
    for block in &blocks {
        writeln!(source, "own_{block} : {block};").expect("it takes everything");
    }
    source.push_str("END_VAR\n");
    for block in &blocks {
        writeln!(source, "own_{block}();").expect("it takes everything");
    }
    source.push_str(
        "END_PROGRAM\nCONFIGURATION C RESOURCE R ON PLC\n\
         TASK T (INTERVAL := T#1ms, PRIORITY := 1);\n\
         PROGRAM P WITH T : Main;\nEND_RESOURCE END_CONFIGURATION\n",
    );
    let mut sources = Sources::new();
    sources.add("main.st", source.as_bytes()).expect("it is a source");
    let checked = project::check("test", &mut sources).expect("there is a thread");
    let told = checked.diagnostics.iter().map(|one| text::to_string(&sources, one));
    assert_eq!(told.collect::<String>(), "");
    assert!(checked.program.is_some());
}
