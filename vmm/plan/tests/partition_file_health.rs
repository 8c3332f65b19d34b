//! What a partition file says of errors is what its partitions' tables say.

use std::path::Path;

use takt_plan::health::{Action, FAULTS, Fault, Limit, Table};
use takt_plan::{self as config, check};
use takt_scheduler::time::Nanos;

fn tables(name: &str) -> Vec<(String, Table)> {
    let path = Path::new("tests/partition_files").join(name);
    let file = config::load(&path, None).unwrap_or_else(|error| panic!("{error}"));
    file.partitions().iter().map(|p| (p.name().to_owned(), p.health())).collect()
}

#[test]
fn a_partition_of_which_nothing_is_said_has_its_kinds_table() {
    for (name, table) in tables("good/channels.toml") {
        let expected = if name == "linux" { Table::LINUX } else { Table::PLC };
        assert_eq!(table, expected, "{name}");
    }
}

#[test]
fn rows_and_limits_change_the_table_of_their_partition_only() {
    let [(_, plc), (_, linux)] = tables("good/health.toml").try_into().unwrap();
    let plc_rows = [
        (Fault::DeadlineMissed, Action::Ignore),
        (Fault::ApplicationError, Action::WarmStart),
        (Fault::NumericError, Action::ColdStart),
        (Fault::HardwareFault, Action::ShutDown),
        (Fault::ProcessorShutdown, Action::Idle),
    ];
    let linux_rows = [
        (Fault::PartitionEnded, Action::ColdStart),
        (Fault::PartitionReset, Action::Idle),
        (Fault::IllegalRequest, Action::Log),
        (Fault::PartitionSilent, Action::Idle),
    ];
    for (table, default, rows) in
        [(plc, Table::PLC, &plc_rows[..]), (linux, Table::LINUX, &linux_rows[..])]
    {
        for fault in FAULTS {
            let row = rows.iter().find(|(changed, _)| *changed == fault);
            let expected = row.map_or(default.action(fault), |(_, action)| *action);
            assert_eq!(table.action(fault), expected, "{fault}");
        }
    }
    assert_eq!(plc.limit(), Limit { at_most: 5, within: Nanos::from_millis(1_000) });
    assert_eq!(linux.limit(), Limit { at_most: 0, within: Nanos::from_millis(86_400_000) });
}

#[test]
fn the_report_shows_what_is_not_the_default_and_nothing_else() {
    let report = |name: &str| {
        let path = Path::new("tests/partition_files").join(name);
        check::report(&config::load(&path, None).unwrap_or_else(|error| panic!("{error}")))
    };
    let expected = "
health monitor, where it is not the default
  plc
    deadline-missed -> ignore
    application-error -> warm-start
    numeric-error -> cold-start
    hardware-fault -> shut-down
    at most 5 starts within 1s
  linux
    illegal-request -> log
    partition-reset -> idle
    partition-ended -> cold-start
    watchdog: no heartbeat for 5s -> idle
    at most 0 starts within 86400s

the host's watchdog restarts this machine 10s after Takt's last heartbeat
";
    let report_of_changes = report("good/health.toml");
    assert!(report_of_changes.ends_with(expected), "{report_of_changes}");
    assert!(!report("good/channels.toml").contains("health monitor"));
}
