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
         takt=drawn; jitter_options=(--max-lost 0); command_line=run; duration=60s; status={status}
         draw; echo $status",
        readable.join(" ")
    );
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    let [said, ended] =
        [output.stderr, output.stdout].map(|bytes| String::from_utf8(bytes).unwrap());
    (ended.trim().to_owned(), said)
}

/// Keeps the records of a channel `level`, of which this can be read. Gives the status, what is said, and what is kept.
fn keep_records(status: u8, records: Option<&str>) -> (String, String, String) {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../scripts/common/kept.sh");
    let result = records.map_or("false".to_owned(), |records| format!("printf '%s' '{records}'"));
    let script = format!(
        "set -euo pipefail; source {source}; work=$(mktemp -d); trap 'rm -rf \"$work\"' EXIT
         result() {{ [[ $1 == level.records ]] && {result}; }}
         records=(\"level $work/to\"); status={status}
         echo before >$work/to; keep_records; echo $status; cat $work/to"
    );
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    let [said, shown] =
        [output.stderr, output.stdout].map(|bytes| String::from_utf8(bytes).unwrap());
    let (status, kept) = shown.split_once('\n').unwrap();
    (status.to_owned(), said, kept.to_owned())
}

#[test]
fn records_are_appended_and_a_good_run_that_has_lost_them_is_not_good() {
    for (records, kept) in [("new", "before\nnew"), ("", "before\n")] {
        assert_eq!(keep_records(0, Some(records)), ("0".into(), String::new(), kept.into()));
    }
    let (status, said, kept) = keep_records(0, None);
    assert_eq!((&*status, &*kept), ("3", "before\n"), "{said}");
    assert!(said.contains("the records of level cannot be read"), "{said}");
    assert_eq!(keep_records(4, None), ("4".into(), String::new(), "before\n".into()));
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
        // A run that was cut short keeps no limit, and what draws has to know.
        assert!(said.contains("--for 60s"), "{said}");
    }
}
