//! A new version beside the one that runs in a PLC, by the program that users have.

use std::path::Path;
use std::thread;

use takt_tests::{BUSY, File, parse, plc_image, save_bytes, target};

use super::super::carried::{client, connect};
use super::super::st;

/// A controller each ms, whose plant is simulated, and a timer each 5 ms. The measured value goes around the setpoint: both
/// versions would else come to the end of their range and be the same there, if it takes long to look.
const RUNNING: &str = "
PROGRAM Control
    VAR
        controller : PID;
        measured AT %ID0 : REAL;
        valve AT %QD0 : REAL;
        setpoint : LREAL := 1.0;
    END_VAR
    controller(SETPOINT := setpoint, MEASURED := measured, PROPORTIONAL := 0.5, INTEGRAL := 2.0, LOW := -9.0, HIGH := 9.0);
    valve := LREAL_TO_REAL(controller.OUTPUT);
END_PROGRAM
PROGRAM Lamp
    VAR
        lamp AT %QX4.0 : BOOL;
        count AT %QW6 : INT;
        pulse : TON;
    END_VAR
    pulse(IN := NOT pulse.Q, PT := T#35ms);
    IF pulse.Q THEN lamp := NOT lamp; END_IF;
    count := count + 1;
END_PROGRAM
CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 1);
    TASK seldom (INTERVAL := T#5ms, PRIORITY := 2);
    PROGRAM control WITH often : Control;
    PROGRAM lamp WITH seldom : Lamp;
END_CONFIGURATION
";

fn image(name: &str, text: &str) -> String {
    save_bytes(name, &st::image("p", "main.st", text)).to_str().unwrap().to_owned()
}

/// What the command tells in JSON.
fn shadow(file: &Path, new: &str, tolerance: &str) -> takt_tests::Value {
    let words = ["shadow", file.to_str().unwrap(), "p", new, "--for", "300ms", "--json"];
    let told = client("takt-plc", &[&words[..], &["--tolerance", tolerance]].concat());
    parse(told.trim())
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn the_outputs_of_a_new_integrator_are_compared_with_those_of_a_plc_beside_a_linux() {
    let running = image("change-shadow.plc", RUNNING);
    let other = RUNNING
        .replace("VAR\n        controller", "VAR\n        jobs : LINT;\n        controller")
        .replace("INTEGRAL := 2.0", "INTEGRAL := 4.0")
        .replace("valve :=", "jobs := jobs + 1;\n    valve :=");
    let new = image("change-shadow-new.plc", &other);
    let program = format!(
        "image = {:?}\nmemory = \"32MiB\"\n[[partition.program]]\nimage = {running:?}\nname = \"p\"\nallow_force = true\n\
         watch = \"4KiB\"\n[[partition.io]]\npoint = \"Control.measured\"\n\
         simulate = {{ shape = \"sine\", low = 0.0, high = 2.0, period = \"200ms\" }}\n",
        plc_image("kernel")
    );
    let text = File::new("1ms")
        .lines("control = \"change-shadow.sock\"")
        .plc_with("plc", &program)
        .linux(BUSY)
        .schedule("normal")
        .window("plc", 0, 300);
    let file = text.save("change-shadow");
    let socket = target("tests").canonicalize().unwrap().join("change-shadow.sock");
    let (outcome, same, told) = thread::scope(|scope| {
        let run = scope.spawn(|| {
            text.run("change-shadow").until("p.control.setpoint is forced no longer").run()
        });
        drop(connect(&socket));
        let same = shadow(&file, &running, "0");
        let told = shadow(&file, &new, "100");
        let file = file.to_str().unwrap();
        let diff = client("takt-plc", &["diff", &new, "--running", file, "--program", "p"]);
        assert!(diff.contains("new          control.jobs"), "{diff}");
        client("takt-plc", &["force", file, "p.control.setpoint", "1.0"]);
        client("takt-plc", &["release", file, "p.control.setpoint"]);
        (run.join().unwrap(), same, told)
    });
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let outputs = |told: &takt_tests::Value| told["outputs"].as_array().unwrap().clone();
    for told in [&same, &told] {
        // The version that runs comes to the same here as in the PLC, in each cycle that was seen.
        assert_eq!(told["strayed"], 0, "{told:#}");
        let [cycles, missing] = ["cycles", "missing"].map(|key| told[key].as_u64().unwrap());
        assert!(cycles > 200 && missing < 30, "{told:#}");
        assert_eq!(outputs(told).len(), 3, "{told:#}");
    }
    assert!(outputs(&same).iter().all(|output| output["largest"].is_null()), "{same:#}");
    for output in outputs(&told) {
        if output["name"] == "p.Control.valve" {
            let largest = output["largest"].as_f64().unwrap();
            assert!(largest > 0.05 && largest < 2.0, "{told:#}");
            assert!(output["at_cycle"].as_u64().is_some(), "{told:#}");
        } else {
            assert!(output["largest"].is_null(), "{told:#}");
        }
    }
    outcome.assert_kept_its_time("plc", 500);
    outcome.assert_punctual("plc");
}
