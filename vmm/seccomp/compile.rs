//! Compiles the lists of system calls in this folder to programs for the kernel's filter.
//!
//! Each list is an array of seccompiler's rules. The comparisons come in the order of the file, so
//! what a thread calls most stands first; seccompiler by itself sorts them by number. So each call
//! is compiled alone, and its comparisons, which reach to nothing outside of them, are put
//! together here between the one head and the one end that all programs have.
//!
//! When a filter is installed the kernel tries it for each of its calls (`seccomp_cache_prepare`,
//! kernel/seccomp.c), one comparison after the other. Nearly half of them have numbers above all that are
//! listed, so one comparison in front spares those all others.

use std::fs;
use std::path::Path;

use seccompiler::{BpfProgram, TargetArch, compile_from_json, sock_filter};
use serde_json::{Value, json};

/// The kinds of threads; `sandbox/filter.rs` embeds these programs.
const KINDS: [&str; 12] = [
    "plc",
    "linux",
    "kicker",
    "loader",
    "plc-loader",
    "disk",
    "writer",
    "saver",
    "reader",
    "closer",
    "main",
    "guardian",
];
/// What every thread may do to wait and to end.
const COMMON: &str = "common";

/// `BPF_JMP | BPF_JGT | BPF_K`: goes on `jt` instructions further if the number is above `k`, else `jf`.
const JUMP_IF_GREATER: u16 = 0x25;

/// Compiles the lists of `folder` to files in `out`, as the kernel takes them.
pub fn compile(folder: &Path, out: &Path) {
    let common = read(folder, COMMON);
    for kind in KINDS {
        let rules = read(folder, kind).into_iter().chain(common.iter().cloned());
        let bytes: Vec<u8> = program(kind, rules)
            .into_iter()
            .flat_map(|i| {
                let [c0, c1] = i.code.to_ne_bytes();
                let [k0, k1, k2, k3] = i.k.to_ne_bytes();
                [c0, c1, i.jt, i.jf, k0, k1, k2, k3]
            })
            .collect();
        if let Err(error) = fs::write(out.join(format!("{kind}.bpf")), bytes) {
            panic!("cannot write the filter {kind}: {error}");
        }
    }
}

fn read(folder: &Path, name: &str) -> Vec<Value> {
    let path = folder.join(format!("{name}.json"));
    println!("cargo::rerun-if-changed={}", path.display());
    let text = fs::read_to_string(&path);
    let rules = text
        .map_err(|e| e.to_string())
        .and_then(|text| serde_json::from_str(&text).map_err(|e| e.to_string()));
    rules.unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn program(kind: &str, rules: impl Iterator<Item = Value>) -> BpfProgram {
    let mut calls: Vec<(String, Vec<Value>)> = Vec::new();
    for rule in rules {
        let call = rule["syscall"].as_str().unwrap_or_default().to_owned();
        match calls.iter_mut().find(|(known, _)| *known == call) {
            Some((_, rules)) => rules.push(rule),
            None => calls.push((call, vec![rule])),
        }
    }
    // Without rules there is a check of the processor's architecture, and the end.
    let mut program = part(kind, &[]);
    let Some(end) = program.pop() else { panic!("{kind}: seccompiler has compiled nothing") };
    let check = program.len();
    let parts: Vec<BpfProgram> = calls.iter().map(|(_, rules)| part(kind, rules)).collect();
    // After the check each loads the call's number, and compares it with its own.
    let highest = parts.iter().map(|part| part[check + 1].k).max();
    program.push(parts[0][check].clone());
    program.push(sock_filter { code: JUMP_IF_GREATER, jt: 0, jf: 1, k: highest.unwrap_or(0) });
    program.push(end.clone());
    for part in parts {
        program.extend_from_slice(&part[check + 1..part.len() - 1]);
    }
    program.push(end);
    program
}

fn part(kind: &str, rules: &[Value]) -> BpfProgram {
    let filter = json!({ kind: {
        "mismatch_action": "trap", "match_action": "allow", "filter": rules,
    }});
    let compiled = compile_from_json(filter.to_string().as_bytes(), TargetArch::x86_64);
    match compiled.map(|mut all| all.remove(kind)) {
        Ok(Some(program)) => program,
        Ok(None) => panic!("{kind}: seccompiler has compiled nothing"),
        Err(error) => panic!("{kind}: {error}"),
    }
}
