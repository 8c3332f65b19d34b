//! The machine code of six kernels against that of gcc. The numbers are the same on every machine.
//!
//! The third job of each kernel is counted. What gcc takes is in `speed/gcc.toml`, where `speed/run` counts it anew.

use std::collections::BTreeMap;

use takt_program::address;
use takt_st::native;

use crate::{count, machine, of_speed, oracle, program};

/// The geometric mean of the ratios is at most this, and no kernel is worse than the second.
const MEAN: f64 = 1.2;
const WORST: f64 = 2.1;

/// Instructions of the third job of the only task, whose state is then what the interpreter has, but for strings: their
/// bytes behind the end are left over.
fn instructions(source: &str, strings: bool) -> u64 {
    let program = program(source);
    let compiled = native::compile(&program).unwrap();
    let mut machine = machine::Machine::load(&compiled);
    machine.start();
    let entry = program.tasks[0].entry;
    let mut interpreter = oracle::Machine::new(&program);
    for cycle in 0..3 {
        let job = oracle::Job { now_ns: cycle * 1_000_000, elapsed_ns: 1_000_000, cycle };
        interpreter.run(entry, job).unwrap();
    }
    let entry = entry.0 as usize;
    for cycle in 0..2 {
        machine.run(entry, cycle * 1_000_000, 1_000_000, cycle).unwrap();
    }
    let counted = count::job(&mut machine, &compiled, entry, 2);
    counted.ended.unwrap();
    let bytes = program.state_size() as usize;
    let same =
        machine.read(address::STATE, bytes) == interpreter.memory.read(address::STATE, bytes);
    assert!(same || strings, "the code does what the interpreter does");
    counted.all
}

#[test]
fn six_kernels_take_few_more_instructions_than_gcc_makes_of_them() {
    let gcc: BTreeMap<String, u64> = toml::from_str(&of_speed("gcc.toml")).unwrap();
    assert_eq!(gcc.len(), 6);
    let mut logarithms = 0.0;
    for (kernel, theirs) in &gcc {
        let ours = instructions(&of_speed(&format!("{kernel}.st")), kernel == "text");
        let ratio = ours as f64 / *theirs as f64;
        println!("{kernel}: {ours}, gcc {theirs}: {ratio:.3}");
        assert!(ours > 1000 && ratio < WORST, "{kernel}: {ours} instructions, gcc {theirs}");
        logarithms += ratio.ln();
    }
    let mean = (logarithms / gcc.len() as f64).exp();
    println!("geometric mean: {mean:.3}");
    assert!(mean <= MEAN, "{mean:.3} times the instructions of gcc");
}
