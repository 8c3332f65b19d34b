//! The machine code of six kernels against that of gcc, in instructions: they are the same on every machine.
//!
//! The third job of each kernel is stepped through, one trap for each instruction. What gcc takes is in
//! `speed/gcc.toml`, where `speed/run` counts it anew.

mod machine;
mod oracle;

use std::arch::asm;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use takt_program::address;
use takt_st::{native, project, source::Sources};

/// The geometric mean of the ratios is at most this, and no kernel is worse than the second.
const MEAN: f64 = 1.2;
const WORST: f64 = 2.1;

/// Bit 8 of the flags: a trap behind each instruction.
const TRAP_FLAG: i64 = 1 << 8;

static COUNTED: AtomicU64 = AtomicU64::new(0);

/// A breakpoint begins and ends the stepping; what lies between, if it is the program's, is counted.
extern "C" fn on_step(
    _: libc::c_int,
    information: *mut libc::siginfo_t,
    context: *mut libc::c_void,
) {
    // SAFETY: the kernel gives the handler both, and they are its own.
    let (code, registers) = unsafe {
        let context = &mut *context.cast::<libc::ucontext_t>();
        ((*information).si_code, &mut context.uc_mcontext.gregs)
    };
    if code != libc::TRAP_TRACE {
        registers[libc::REG_EFL as usize] ^= TRAP_FLAG;
        return;
    }
    let at = registers[libc::REG_RIP as usize] as u64;
    if (address::CODE..address::STATE).contains(&at) {
        COUNTED.fetch_add(1, Ordering::Relaxed);
    }
}

/// Instructions of the third job of the only task, whose state is then what the interpreter has, but for strings: their
/// bytes behind the end are left over.
fn instructions(source: &str, strings: bool) -> u64 {
    let mut sources = Sources::new();
    sources.add("kernel.st", source.as_bytes()).unwrap();
    let program = project::check("kernel", &mut sources).unwrap().program.unwrap();
    if std::env::var_os("TAKT_ST_ASM").is_some() {
        println!("{}", native::assembly(&program));
    }
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
    COUNTED.store(0, Ordering::Relaxed);
    // SAFETY: the handler of `set_up` is there, and goes on behind the breakpoint.
    unsafe { asm!("int3") };
    let ended = machine.run(entry, 2_000_000, 1_000_000, 2);
    // SAFETY: as above.
    unsafe { asm!("int3") };
    ended.unwrap();
    let bytes = program.state_size() as usize;
    let same =
        machine.read(address::STATE, bytes) == interpreter.memory.read(address::STATE, bytes);
    assert!(same || strings, "the code does what the interpreter does");
    COUNTED.load(Ordering::Relaxed)
}

#[test]
fn six_kernels_take_few_more_instructions_than_gcc_makes_of_them() {
    // SAFETY: the structure is plain data; the handler is async-signal-safe.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = on_step as *const () as usize;
        action.sa_flags = libc::SA_SIGINFO;
        assert_eq!(libc::sigaction(libc::SIGTRAP, &action, std::ptr::null_mut()), 0);
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("speed");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let gcc: BTreeMap<String, u64> = toml::from_str(&read("gcc.toml")).unwrap();
    assert_eq!(gcc.len(), 6);
    let mut logarithms = 0.0;
    for (kernel, theirs) in &gcc {
        let ours = instructions(&read(&format!("{kernel}.st")), kernel == "text");
        let ratio = ours as f64 / *theirs as f64;
        println!("{kernel}: {ours}, gcc {theirs}: {ratio:.3}");
        assert!(ours > 1000 && ratio < WORST, "{kernel}: {ours} instructions, gcc {theirs}");
        logarithms += ratio.ln();
    }
    let mean = (logarithms / gcc.len() as f64).exp();
    println!("geometric mean: {mean:.3}");
    assert!(mean <= MEAN, "{mean:.3} times the instructions of gcc");
}
