//! The page of `devices/port/python/examples` in a browser, over the network of the Debian that serves it: the level is
//! the PLC's, and the PLC holds what the page sets.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::{Outcome, root, target};

use super::{ADDRESS, assert_lived_well, debian_with, live_of};

fn run(command: &mut Command) {
    let status = command.status().expect("it starts");
    assert!(status.success(), "{command:?}: {status}");
}

/// A browser, unpacked.
fn browser() -> PathBuf {
    let mut script = Command::new(root().join("scripts/guest-image"));
    run(script.arg("--browser").env_remove("TAKT_SUITE"));
    let folder = root().join("target/browser").canonicalize();
    folder.expect("it is made")
}

/// What a user copies to `/srv/level`: the example, and the package with its library.
fn program() -> PathBuf {
    let mut cargo = Command::new("cargo");
    run(cargo.args(["build", "--release", "--quiet", "-p", "takt-port-c"]).current_dir(root()));
    let folder = target("tests/level");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(folder.join("takt_port")).unwrap();
    let python = root().join("devices/port/python");
    let copy = |from: &str, to: &str| fs::copy(python.join(from), folder.join(to)).unwrap();
    for name in ["level_page.py", "level_page.html", "level-page.service"] {
        copy(&format!("examples/{name}"), name);
    }
    copy("takt_port/__init__.py", "takt_port/__init__.py");
    let library = root().join("target/x86_64-unknown-linux-gnu/release/libtakt_port_c.a");
    let mut link = Command::new("cc");
    link.args(["-shared", "-Wl,--whole-archive"]).arg(library).arg("-Wl,--no-whole-archive");
    let shared = folder.join("takt_port/libtakt_port.so");
    run(link.args(["-lpthread", "-ldl", "-lm", "-lgcc_s", "-o"]).arg(shared));
    folder.canonicalize().unwrap()
}

/// The values of the expressions that are numbers, in their order.
fn numbers(outcome: &Outcome) -> Vec<f64> {
    let answers = outcome.output.split(r#""type":"number","value":"#).skip(1);
    let number = |rest: &str| rest.split([',', '}']).next()?.parse().ok();
    answers.filter_map(number).collect()
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_browser_shows_the_level_of_the_plc_and_sets_what_it_holds_and_no_release_is_late() {
    // A Debian and a browser are some 250 MB of packages.
    let folder = debian_with("debian-page", "python3", "600M");
    let (browser, program) = (browser(), program());
    let path = |path: &Path| path.to_string_lossy().into_owned();
    let browse = path(&root().join("tests/host/browse").canonicalize().unwrap());
    let (browser, program) = (path(&browser), path(&program));
    let in_page = |expressions: &[&str]| {
        let expressions: String =
            expressions.iter().map(|expression| format!(" \"{expression}\"")).collect();
        format!("1@{browse} {browser} http://{ADDRESS}:8080/{expressions}")
    };
    let part = |id: &str| format!("document.getElementById('{id}')");
    let (state, shown, field) = (part("state"), part("level"), part("metres"));
    let helpers = format!(
        "level = () => {state}.textContent.startsWith('valid') ? parseFloat({shown}.textContent) : NaN; \
         until = test => new Promise(done => {{ const look = setInterval(() => {{ \
         if (test(level())) {{ clearInterval(look); done(level()); }} }}, 100); }}); 0"
    );
    let set = format!("{field}.value = '1.5'; {}.click(); true", part("hold"));
    // Its own setpoints are 1.2 and 0.8.
    let near = "until(metres => metres > 1.45)";
    let release = format!("{}.click(); true", part("release"));
    let text = "document.body.innerText";
    let refused = "fetch('hold', { method: 'POST', body: '9' }).then(answer => answer.status)";
    let commands = [
        format!("1@tar -c -C {program} . | on_debian 'mkdir /srv/level && tar -x -C /srv/level'"),
        "1:systemctl enable --quiet --now /srv/level/level-page.service && \
         until ss -lnt | grep -q :8080; do sleep 0.2; done"
            .to_owned(),
        // What it shows, what it sets, what it refuses, and what it gives up.
        in_page(&[
            &helpers,
            "until(metres => metres > 0)",
            text,
            &set,
            near,
            text,
            refused,
            &release,
            "until(metres => metres < 1.4)",
            text,
        ]),
        // A browser that holds the level and is gone.
        in_page(&[&helpers, "until(metres => metres > 0)", &set, near, text]),
        "1@told=$(grep -c '(set ' /out/console); \
         until grep '(set ' /out/console | tail -n +$((told + 1)) | grep -v 'set 1.500'; do usleep 100000; done"
            .to_owned(),
        "1:systemctl show level-page --property NRestarts,User,MemoryCurrent,CPUUsageNSec; \
         journalctl --no-pager -q -u level-page"
            .to_owned(),
    ];
    let commands: Vec<&str> = commands.iter().map(String::as_str).collect();
    let options =
        [["--file", &*browser], ["--file", &*program], ["--file", &*browse], ["--memory", "1400"]];
    let lives = live_of("hmi", 1, &commands, &folder, &options);
    assert_lived_well(&lives);
    let outcome = &lives[0];
    let numbers = numbers(outcome);
    let [_, started, held, status, fell, _, again, held_again] = numbers[..] else {
        panic!("{numbers:?}\n{}", outcome.output);
    };
    assert!(0.0 < started && started < 1.4 && 0.0 < again && again < 1.6, "{numbers:?}");
    assert!((held - 1.5).abs() < 0.05 && (held_again - 1.5).abs() < 0.05, "{numbers:?}");
    assert!(fell < 1.4 && (status - 400.0).abs() < 0.1, "{numbers:?}");
    outcome.assert_shows("The PLC is told to hold 1.5 m.");
    outcome.assert_shows("The PLC has its own setpoint.");
    // The PLC's own lines: what it was told, and what it went back to.
    outcome.assert_shows("(set 1.500)");
    let back = outcome.output.lines().find(|line| line.starts_with("[debian] [plc] cycle "));
    assert!(back.is_some_and(|line| !line.contains("set 1.500")), "{back:?}");
    outcome.assert_shows("[debian] User=www-data");
    outcome.assert_shows("[debian] NRestarts=0");
}
