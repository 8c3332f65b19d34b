//! A file of retained values. It lies on a disk that fails, or comes from another machine.

use std::sync::OnceLock;

use sha2::{Digest, Sha256};
use takt_program::Image;
use takt_retain::{Generation, Layout};
use takt_st::source::Sources;
use takt_st::{build, project, stack};

/// Values of each kind that is told apart when they are taken over.
const PROGRAM: &str = "
TYPE Phase : (Idle, Filling, Full); Share : INT (0..100); END_TYPE
FUNCTION_BLOCK Mixer
    VAR RETAIN count : DINT; END_VAR
    VAR_OUTPUT RETAIN speed : REAL; END_VAR
    count := count + 1;
END_FUNCTION_BLOCK
PROGRAM Main
    VAR PERSISTENT hours : LREAL; name : STRING[12]; row : ARRAY[-2..5] OF INT; END_VAR
    VAR RETAIN phase : Phase; share : Share; mixer : Mixer; on : BOOL; since : TIME; END_VAR
    VAR plain : INT; END_VAR
    mixer();
    plain := plain + 1;
    IF on AND phase = Idle AND share = 0 AND since = T#0s AND name = '' THEN hours := hours + row[0]; END_IF;
END_PROGRAM
CONFIGURATION c
    TASK t (INTERVAL := T#1ms, PRIORITY := 1);
    PROGRAM main WITH t : Main;
END_CONFIGURATION
";

/// The layout of a program that takes them.
///
/// # Panics
/// If the program above is none.
fn layout() -> &'static Layout {
    static LAYOUT: OnceLock<Layout> = OnceLock::new();
    LAYOUT.get_or_init(|| {
        let mut sources = Sources::new();
        sources.add("main.st", PROGRAM.as_bytes()).expect("it is a source");
        let checked = project::check("p", &mut sources).expect("there is room for a thread");
        let program = checked.program.expect("it has no error");
        let built = stack::with_room(|| build::build(&program)).expect("there is room");
        let image = built.expect("it can be built").image;
        Layout::of(&Image::parse(&image).expect("it is an image"))
    })
}

/// The bytes with magic, version, length and checksum set right: the fuzzer would never get past them, and somebody who
/// means harm would do the same.
fn whole(data: &[u8]) -> Vec<u8> {
    let mut file = data.to_vec();
    if file.len() >= 72 {
        file[..8].copy_from_slice(b"TAKTKEEP");
        file[8..12].copy_from_slice(&1_u32.to_le_bytes());
        let length = file.len() as u64 + 32;
        file[16..24].copy_from_slice(&length.to_le_bytes());
        let checksum = Sha256::digest(&file);
        file.extend_from_slice(&checksum);
    }
    file
}

/// Reads a generation, and starts a program with it: as one of its own image, and of another one.
///
/// # Panics
/// If what the program begins with is no block of its layout, or is not read again as it was written.
pub fn run(data: &[u8]) {
    let _ = Generation::decode(data);
    let Ok(mut generation) = Generation::decode(&whole(data)) else { return };
    let layout = layout();
    for same in [false, true] {
        if same {
            generation.image = layout.image();
        }
        let block = layout.restore(&generation).block;
        assert_eq!(block.len(), layout.initial().len());
        let file = Generation::encode(generation.number, generation.cycle, layout, &block);
        let file = file.expect("a block of the layout can be written");
        let again = Generation::decode(&file).expect("what was written is read");
        assert_eq!((again.number, again.cycle), (generation.number, generation.cycle));
        assert_eq!(layout.restore(&again).block, block, "it begins as it ended");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corpus_begins_with_a_whole_generation() {
        let layout = layout();
        assert_eq!(layout.parts().len(), 9, "{:?}", layout.parts());
        let file = Generation::encode(7, 8, layout, layout.initial()).unwrap();
        let content = &file[..file.len() - 32];
        assert_eq!(whole(content), file);
        run(content);
    }
}
