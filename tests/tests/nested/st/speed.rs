//! Six kernels in Structured Text and the same in C by gcc, in two PLCs of one machine of the lab, where time is a count of
//! instructions.

use std::fs;
use std::path::Path;
use std::process::Command;

use takt_tests::{File, root, save_bytes};

use super::super::carried::client;
use super::super::tasks::Row;
use super::{image, programs_of};

/// By the names of their sources.
const KERNELS: [&str; 6] = ["pid", "filter", "matrix", "state-machine", "text", "crc"];

/// The geometric mean is at most this many times the instructions of gcc.
const MEAN: f64 = 1.2;

/// The image of the kernels in C, as the documentation says how one is made.
fn in_c(sources: &Path) -> String {
    let folder = root().join("target/tests/st-speed-c");
    fs::create_dir_all(&folder).expect("the folder can be made");
    let sdk = root().join("plc-guest/sdk/c/takt.mk");
    let mut make = Command::new("make");
    make.args(["--silent", "-f"]).arg(sdk).args(["build/program.o", "build/takt.o"]);
    make.arg(format!("VPATH={}", sources.display())).current_dir(&folder);
    assert!(make.status().expect("make starts").success());
    let [program, memory, image] = ["build/program.o", "build/takt.o", "c.plc"]
        .map(|name| folder.join(name).display().to_string());
    client("takt-plc", &["build", &program, &memory, "-o", &image]);
    image
}

#[test]
fn six_kernels_take_at_most_1_2_times_the_instructions_of_gcc_in_the_lab() {
    let sources = root().join("plc-guest/st/speed");
    let in_st = KERNELS.map(|kernel| {
        let file = format!("{kernel}.st");
        let text = fs::read_to_string(sources.join(&file)).expect("there is such a kernel");
        let image = image(kernel, &file, &text);
        (kernel, save_bytes(&format!("st-speed-{kernel}.plc"), &image))
    });
    let in_st = in_st.iter().map(|(name, image)| (*name, image.as_path()));
    let in_c = in_c(&sources);
    let outcome = File::new("10ms")
        .plc_with("st", &programs_of(in_st))
        .plc_with("c", &programs_of([("c", Path::new(&in_c))].into_iter()))
        .schedule("normal")
        .window("st", 0, 3_000)
        .window("c", 5_000, 3_000)
        .run("st-speed")
        .lasting("1500ms")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let mut logarithms = 0.0;
    for kernel in KERNELS {
        let ours = Row::of(&outcome, &format!("{kernel}.t"));
        let theirs = Row::of(&outcome, &format!("c.run_{}", kernel.replace('-', "_")));
        for row in [&ours, &theirs] {
            row.assert_in_time(90);
        }
        let [ours, theirs] = [ours, theirs].map(|row| row.number("exec-max"));
        let ratio = ours as f64 / theirs as f64;
        println!("{kernel}: {ours} ns, gcc {theirs} ns: {ratio:.3}");
        logarithms += ratio.ln();
    }
    let mean = (logarithms / KERNELS.len() as f64).exp();
    println!("geometric mean: {mean:.3}");
    assert!(mean <= MEAN, "{mean:.3} times the instructions of gcc\n{}", outcome.output);
}
