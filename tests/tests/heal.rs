//! The library that heals QEMU (`scripts/qemu/heal.c`), preloaded into a program that has the functions it looks into: it
//! changes the code that it knows, and leaves alone what differs by an instruction.

use std::path::PathBuf;
use std::process::Command;

fn compile(arguments: &[&str], source: &str, name: &str) -> PathBuf {
    let built = std::env::temp_dir().join(format!("takt-heal-{}-{name}", std::process::id()));
    let status = Command::new("cc")
        .args(["-O2", "-Wall", "-Wextra", "-Werror"])
        .args(arguments)
        .arg("-o")
        .arg(&built)
        .arg(format!("{}/{source}", env!("CARGO_MANIFEST_DIR")))
        .status();
    assert!(status.expect("there is a compiler").success(), "{source} does not compile");
    built
}

/// What the library says of a program that differs by this from Debian's QEMU, and what the program then does.
fn healed(odd: u32) -> (String, String) {
    let name = odd.to_string();
    let library = compile(&["-shared", "-fPIC"], "../scripts/qemu/heal.c", &format!("{name}.so"));
    let program = compile(&["-rdynamic", &format!("-DODD={odd}")], "tests/heal/emulator.c", &name);
    let run = |tell: bool| {
        let mut run = Command::new(&program);
        run.env("LD_PRELOAD", &library);
        if tell {
            run.env("TAKT_HEAL_TELL", "1");
        }
        let output = run.output().expect("it was just built");
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).expect("it prints text")
    };
    let both = (run(true), run(false));
    for built in [library, program] {
        std::fs::remove_file(built).expect("it was just built");
    }
    both
}

#[test]
fn what_is_known_is_healed() {
    let (told, done) = healed(0);
    assert_eq!(told, "once kept\n");
    let expected = "delivered 32 by 1 (0, 0, 0)\nleft over -1\nrequests 102, 1 locks, unlocked\n\
                    flags ffffff7f\npause -1\n";
    assert_eq!(done, expected);
}

/// Without what the first of the healings finds, none is tried.
#[test]
fn what_differs_by_an_instruction_is_left_alone_and_told() {
    let untouched = "delivered 32 by 1 (0, 0, 0)\nleft over 32\nrequests 102, 0 locks, unlocked\n\
                     flags ffffff7f\npause 65536\n";
    for odd in [1, 2] {
        assert_eq!(healed(odd), ("twice lost\n".to_owned(), untouched.to_owned()), "{odd}");
    }
    let others = [(3, 0, "ffffff7f"), (4, 1, "fffffeff"), (5, 0, "ffffff7f"), (6, 1, "ffffff7f")];
    for (odd, locks, flags) in others {
        let expected = format!(
            "delivered 32 by 1 (0, 0, 0)\nleft over -1\nrequests 102, {locks} locks, unlocked\n\
             flags {flags}\npause -1\n"
        );
        assert_eq!(healed(odd), ("once lost\n".to_owned(), expected), "{odd}");
    }
}
