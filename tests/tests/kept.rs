//! What `scripts/run` keeps of a run in an emulated machine, with functions in place of that machine and of takt.

use std::process::Command;

/// Draws what a run has left that ended with `status`, of which only these files can be read. Gives the status that
/// the script ends with, and what it says.
fn draw(status: u8, readable: &[&str]) -> (String, String) {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../scripts/common/kept.sh");
    let script = format!(
        "set -euo pipefail; source {source}; work=$(mktemp -d); trap 'rm -rf \"$work\"' EXIT
         result() {{ [[ \" {} \" == *\" $1 \"* ]] && echo '{{}}'; }}
         drawn() {{ echo \"$@\" >&2; return 5; }}
         takt=drawn; jitter_options=(--max-lost 0); command_line=run; status={status}
         draw; echo $status",
        readable.join(" ")
    );
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    let [said, ended] =
        [output.stderr, output.stdout].map(|bytes| String::from_utf8(bytes).unwrap());
    (ended.trim().to_owned(), said)
}

#[test]
fn a_good_run_whose_figures_cannot_be_read_is_not_good() {
    for (readable, missing) in
        [(&["samples.json"][..], "report.json"), (&["report.json"], "samples.json")]
    {
        let (status, said) = draw(0, readable);
        assert_eq!(status, "3", "{said}");
        assert!(said.contains(&format!("its {missing} cannot be read")), "{said}");
        assert!(!said.contains("jitter render"), "{said}");
    }
    assert_eq!(draw(0, &[]).0, "3");
}

#[test]
fn a_run_that_failed_keeps_its_status_with_and_without_figures() {
    assert_eq!(draw(2, &[]), ("2".to_owned(), String::new()));
    let both = ["report.json", "samples.json"];
    for (status, expected) in [(0, "5"), (4, "4")] {
        let (status, said) = draw(status, &both);
        assert_eq!(status, expected, "{said}");
        assert!(said.contains("jitter render") && said.contains("--max-lost 0"), "{said}");
    }
}
