//! The units of the service manager that start Takt.

use std::collections::BTreeMap;
use std::iter;

use crate::finding::Finding;
use crate::host::Host;

/// Where units lie; one in an earlier folder takes the place of one with the same name in a later one (systemd.unit(5)).
const FOLDERS: [&str; 5] = [
    "etc/systemd/system",
    "run/systemd/system",
    "run/systemd/transient",
    "usr/local/lib/systemd/system",
    "usr/lib/systemd/system",
];

/// Whether a unit ends the guardian together with Takt.
pub fn guardian(host: &Host) -> Finding {
    const CHECK: &str = "service";
    let units: Vec<(String, String)> =
        units(host).into_iter().filter(|(_, text)| runs_takt(text)).collect();
    let wrong: Vec<(&str, Vec<String>)> = units
        .iter()
        .map(|(name, text)| (name.as_str(), wrong(text)))
        .filter(|(_, wrong)| !wrong.is_empty())
        .collect();
    let Some((first, _)) = wrong.first() else {
        return match &*units.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ") {
            "" => Finding::good(CHECK, "no unit of systemd was found that runs takt"),
            names => Finding::good(CHECK, format!("the guardian has its time in {names}")),
        };
    };
    let found: Vec<String> =
        wrong.iter().map(|(name, wrong)| format!("{name} has {}", wrong.join(" and "))).collect();
    Finding::warning(
        CHECK,
        found.join("; "),
        "the guardian is ended together with takt, perhaps before it has written the safe values",
        format!("systemctl edit {first} # [Service] KillMode=process, OOMPolicy=continue"),
    )
}

/// Names and texts of all units of services, each with the drop-ins behind it.
fn units(host: &Host) -> Vec<(String, String)> {
    let mut units: Vec<(String, String)> = Vec::new();
    for folder in FOLDERS {
        for name in host.names(folder).into_iter().filter(|name| name.ends_with(".service")) {
            if units.iter().any(|(known, _)| *known == name) {
                continue;
            }
            if let Some(text) = host.text(&format!("{folder}/{name}")) {
                let all: Vec<String> = iter::once(text).chain(drop_ins(host, &name)).collect();
                units.push((name, all.join("\n")));
            }
        }
    }
    units
}

/// The texts of a unit's drop-ins, by the names of their files. Of one name only that in the first folder counts. A template has those
/// of all its instances.
fn drop_ins(host: &Host, unit: &str) -> Vec<String> {
    let template = unit.strip_suffix("@.service");
    let is_own = |name: &str| match (template, name.strip_suffix(".service.d")) {
        (_, None) => false,
        (Some(template), Some(of)) => of.split('@').next() == Some(template),
        (None, Some(of)) => unit.strip_suffix(".service") == Some(of),
    };
    let mut texts = BTreeMap::new();
    for folder in FOLDERS {
        for own in host.names(folder).into_iter().filter(|name| is_own(name)) {
            let own = format!("{folder}/{own}");
            for file in host.names(&own).into_iter().filter(|file| file.ends_with(".conf")) {
                let text = || host.text(&format!("{own}/{file}")).unwrap_or_default();
                texts.entry(file.clone()).or_insert_with(text);
            }
        }
    }
    texts.into_values().collect()
}

/// The values of a setting, in their order, from the last empty one on, which takes back what was before. A line that ends
/// with a backslash goes on in the next one.
fn values(text: &str, setting: &str) -> Vec<String> {
    let text = text.replace("\\\n", " ");
    let lines = text.lines().map(str::trim).filter(|line| !line.starts_with(['#', ';']));
    let named = lines.filter_map(|line| line.split_once('='));
    let own = named.filter(|(name, _)| name.trim() == setting);
    own.fold(Vec::new(), |mut values, (_, value)| {
        match value.trim() {
            "" => values.clear(),
            value => values.push(value.to_owned()),
        }
        values
    })
}

fn runs_takt(text: &str) -> bool {
    values(text, "ExecStart").iter().any(|command| {
        // In front of a path there may be signs that say how it is run, and there may be quotes.
        let signs = ['-', '@', ':', '+', '!', '|', '"', '\''];
        let words: Vec<&str> =
            command.split_whitespace().map(|word| word.trim_matches(signs)).collect();
        let is_takt = |path: &str| path.rsplit('/').next() == Some("takt");
        words.windows(2).any(|pair| matches!(pair, [program, "run"] if is_takt(program)))
    })
}

/// Settings of a unit that end the guardian (systemd.kill(5); systemd.service(5): an OOMPolicy of `stop` has only Takt end).
fn wrong(text: &str) -> Vec<String> {
    let last = |setting: &str| values(text, setting).pop();
    let mode = last("KillMode").unwrap_or_else(|| "control-group".to_owned());
    let mode = Some(mode).filter(|mode| !["process", "none"].contains(&mode.as_str()));
    let policy = last("OOMPolicy").filter(|policy| policy == "kill");
    let named = |name: &'static str| move |value: String| format!("{name}={value}");
    mode.map(named("KillMode")).into_iter().chain(policy.map(named("OOMPolicy"))).collect()
}

#[cfg(test)]
mod tests {
    use crate::checks::tests::finding;
    use crate::finding::Severity;
    use crate::recorded::Recorded;

    const UNIT: &str = "etc/systemd/system/takt.service";
    const NONE: &str = "no unit of systemd was found that runs takt";
    const GOOD: &str = "the guardian has its time in takt.service";

    fn of(units: &[(&str, &str)]) -> (bool, String) {
        let host = Recorded::named("workstation");
        let host = units.iter().fold(host, |host, (path, text)| host.with(path, text));
        let found = finding(&host, "service");
        assert!(matches!(found.severity, Severity::Good | Severity::Warning));
        (found.severity == Severity::Good, found.found)
    }

    #[test]
    fn the_unit_of_the_manual_leaves_the_guardian_its_time() {
        let manual = include_str!("../../../../docs/service.md");
        let (_, rest) = manual.split_once("```ini\n").unwrap();
        let (unit, _) = rest.split_once("```").unwrap();
        assert!(unit.contains("KillMode=process"));
        assert_eq!(of(&[(UNIT, unit)]), (true, GOOD.into()));
        for (line, other, said) in [
            ("KillMode=process\n", "", "takt.service has KillMode=control-group"),
            ("OOMPolicy=continue", "OOMPolicy=kill", "takt.service has OOMPolicy=kill"),
        ] {
            assert_eq!(of(&[(UNIT, &unit.replace(line, other))]), (false, said.into()));
        }
    }

    #[test]
    fn what_counts_is_the_last_word_of_a_unit_and_its_drop_ins() {
        let run = "[Service]\nExecStart=+/opt/takt \\\n  run /etc/plant.toml\nKillMode=mixed\nOOMPolicy=continue";
        assert_eq!(of(&[(UNIT, run)]), (false, "takt.service has KillMode=mixed".into()));
        let mend = ("run/systemd/system/takt.service.d/b.conf", "[Service]\n KillMode = process\n");
        assert!(of(&[(UNIT, run), mend]).0);
        let spoil = ("etc/systemd/system/takt.service.d/c.conf", "#KillMode=none\nKillMode=");
        assert!(!of(&[(UNIT, run), mend, spoil]).0);
        let hidden = ("usr/lib/systemd/system/takt.service", "ExecStart=takt run x");
        assert_eq!(of(&[(UNIT, run), mend, hidden]).1, GOOD);
        // Of one name the first folder's counts.
        let vendor = ("usr/lib/systemd/system/takt.service.d/b.conf", "KillMode=mixed");
        assert!(of(&[(UNIT, run), mend, vendor]).0);
        let another =
            ("etc/systemd/system/takt.service.d/d.conf", "ExecStart=\nExecStart=/bin/true");
        assert_eq!(of(&[(UNIT, run), another]).1, NONE);
        let template = "etc/systemd/system/takt@.service";
        let instance = ("etc/systemd/system/takt@plant.service.d/a.conf", "KillMode=process");
        assert!(!of(&[(template, run)]).0 && of(&[(template, run), instance]).0);
        let quoted = "ExecStart=/bin/sh -c '\"/opt/takt\" run x'";
        assert!(!of(&[("run/systemd/transient/x.service", quoted)]).0);
    }

    #[test]
    fn units_that_do_not_run_it_are_not_looked_at() {
        let others = [
            "ExecStart=/usr/bin/takt check x",
            "ExecStart=/bin/runner takt",
            "#ExecStart=takt run x",
            "",
        ];
        for other in others {
            assert_eq!(of(&[(UNIT, other)]), (true, NONE.into()), "{other}");
        }
    }
}
