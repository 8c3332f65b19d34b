//! The code generator against the interpreter: random programs, three jobs each, every variable compared after each.
//!
//! A failure names its seed. `TAKT_ST_SEED=n` runs that one and prints the program. With TAKT_TEST_LONG the optimised test
//! runs 100,000, as `scripts/test --long` does.

mod generate;
mod machine;
mod oracle;

use takt_st::hir::{Area, Class, Program, TrapKind, Type, TypeId};
use takt_st::native;

const INPUT_BYTES: usize = 16;

/// How a comparison ended.
#[derive(Default)]
struct Tally {
    ended: u32,
    trapped: u32,
    given_up: u32,
    /// Of those that trapped, by an index.
    by_index: u32,
    /// Indices that the interpreter has looked up.
    indices: u64,
}

/// Whether two values in memory are the same: NaNs are alike, and strings end at their first zero.
fn same(program: &Program, ty: TypeId, a: &[u8], b: &[u8]) -> bool {
    let types = &program.types;
    match types.get(ty) {
        Type::Array { element, .. } => {
            let size = types.size(*element) as usize;
            a.chunks_exact(size)
                .zip(b.chunks_exact(size))
                .all(|(a, b)| same(program, *element, a, b))
        }
        Type::Structure(structure) => structure.fields.iter().all(|field| {
            let range = field.offset as usize..(field.offset + types.size(field.ty)) as usize;
            same(program, field.ty, &a[range.clone()], &b[range])
        }),
        Type::String { .. } => {
            a.split(|byte| *byte == 0).next() == b.split(|byte| *byte == 0).next()
        }
        _ => match (types.scalar(ty).map(|scalar| (scalar.class(), scalar.size())), a) {
            (Some((Class::Float, 4)), _) => {
                let value = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
                a == b || value(a).is_nan() && value(b).is_nan()
            }
            (Some((Class::Float, _)), _) => {
                let value = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap());
                a == b || value(a).is_nan() && value(b).is_nan()
            }
            _ => a == b,
        },
    }
}

fn compare(seed: u64, tally: &mut Tally) -> Result<(), String> {
    let program = generate::generate(seed);
    let compiled = native::compile(&program).map_err(|error| error.to_string())?;
    let mut machine = machine::Machine::load(&compiled);
    machine.start();
    let mut oracle = oracle::Machine::new(&program);
    oracle.fuel = 200_000;
    let mut random = generate::Random::new(!seed);
    let entry = program.tasks[0].entry;
    for cycle in 0..3 {
        let inputs: Vec<u8> = (0..INPUT_BYTES).map(|_| random.next() as u8).collect();
        let inputs = &inputs[..program.area_size(Area::Input) as usize];
        oracle.memory.write(oracle::area_address(Area::Input), inputs);
        machine.write(oracle::area_address(Area::Input), inputs);
        let job =
            oracle::Job { now_ns: cycle * 1_000_000 + 17, elapsed_ns: cycle * 1_000_000, cycle };
        let expected = oracle.run(entry, job);
        tally.indices += std::mem::take(&mut oracle.indices);
        if expected == Err(oracle::Stop::OutOfFuel) {
            tally.given_up += 1;
            return Ok(());
        }
        let found = machine.run(entry.0 as usize, job.now_ns, job.elapsed_ns, job.cycle);
        match (expected, found) {
            (Ok(()), Ok(())) => {}
            (Err(oracle::Stop::Trap(expected)), Err(found)) if expected == found => {
                tally.trapped += 1;
                tally.by_index += u32::from(expected.kind == TrapKind::Bounds);
                return Ok(());
            }
            (expected, found) => {
                return Err(format!(
                    "cycle {cycle}: the interpreter ends with {expected:?}, the code with {found:?}"
                ));
            }
        }
        for global in &program.globals {
            let at = u64::from(global.storage.offset);
            let size = program.types.size(global.ty) as usize;
            let address = oracle::area_address(global.storage.area) + at;
            let expected = oracle.memory.read(address, size);
            let found = machine.read(address, size);
            if !same(&program, global.ty, &expected, &found) {
                let ty = program.types.name(global.ty);
                let name = &global.name;
                return Err(format!(
                    "cycle {cycle}: {name}: {ty} is {found:?}, the interpreter has {expected:?}"
                ));
            }
        }
    }
    tally.ended += 1;
    Ok(())
}

#[test]
fn compiled_programs_do_what_the_interpreter_does() {
    if let Some(seed) = std::env::var("TAKT_ST_SEED").ok().and_then(|seed| seed.parse().ok()) {
        println!("{}", takt_st::hir::print(&generate::generate(seed)));
        compare(seed, &mut Tally::default()).unwrap();
        return;
    }
    // Without optimisation the code generator takes some 50 ms for a program.
    let seeds = match (std::env::var_os("TAKT_TEST_LONG").is_some(), cfg!(debug_assertions)) {
        (false, true) => 300,
        (_, true) | (false, _) => 2_000,
        (true, false) => 100_000,
    };
    let mut tally = Tally::default();
    for seed in 0..seeds {
        if let Err(message) = compare(seed, &mut tally) {
            panic!("seed {seed}: {message}");
        }
    }
    let Tally { ended, trapped, given_up, by_index, indices } = tally;
    println!(
        "seeds 0 to {}: {ended} ended, {trapped} trapped, {by_index} of them by an index out of bounds, {given_up} took \
         too long for the interpreter; {indices} indices that are no constants",
        seeds - 1
    );
    assert!(
        ended > seeds as u32 / 4 && trapped > seeds as u32 / 50,
        "{ended} ended, {trapped} trapped"
    );
    // Else indices are not tried enough.
    assert!(
        by_index > seeds as u32 / 10 && indices > 8 * seeds,
        "{by_index} by an index, {indices} indices"
    );
}
