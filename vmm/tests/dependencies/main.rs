//! What Takt takes from others is what `deny.toml` allows and `docs/dependencies.md` accounts for.
//!
//! cargo-deny would do the first, but it takes minutes to build and wants a network; `cargo metadata` is
//! there, and knows all that is asked. Nothing does the second: a list of crates with the reason for
//! each, which is complete because this test says so.

mod arrows;
mod licence;
mod policy;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;

use policy::{Dependency, Package, Policy};

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap()
}

/// What cargo says, in this folder. It never asks the network: all that is asked for was built just
/// now.
fn cargo(folder: &Path, arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .args(["--locked", "--offline"])
        .current_dir(folder)
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

fn packages(folder: &Path, target: &str) -> Vec<Package> {
    let arguments = ["metadata", "--format-version", "1", "--filter-platform", target];
    let metadata: Metadata = serde_json::from_str(&cargo(folder, &arguments)).unwrap();
    metadata.packages
}

#[test]
fn all_that_is_taken_from_others_is_allowed() {
    let policy = Policy::read(&read("deny.toml")).unwrap();
    let [target] = &policy.graph.targets;
    let mut all = packages(&root(), target);
    assert!(all.len() > 50, "only {} packages?", all.len());
    // What both workspaces have is no duplicate.
    let guest = packages(&root().join("plc-guest"), target);
    let is_new = |p: &Package| !all.iter().any(|q| (&q.name, &q.version) == (&p.name, &p.version));
    let guest: Vec<Package> = guest.into_iter().filter(is_new).collect();
    all.extend(guest);
    let defects = policy.defects(&all);
    assert!(defects.is_empty(), "against deny.toml:\n{}", defects.join("\n"));
}

/// The names of all crates of others that `takt` gets by dependencies of these kinds.
fn crates(kinds: &str) -> BTreeSet<String> {
    let arguments = ["tree", "-p", "takt", "-e", kinds, "--prefix", "none", "--format", "{p}"];
    let tree = cargo(&root(), &arguments);
    let names = tree.lines().filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "takt" && !name.starts_with("takt-")).map(str::to_owned).collect()
}

/// The names in the first column of the table below this heading of the page.
fn listed(page: &str, heading: &str) -> BTreeSet<String> {
    let section = page.split("\n## ").find(|section| section.starts_with(heading)).unwrap();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
    let mut names = BTreeSet::new();
    for row in rows {
        let (name, reason) = row.split_once("` |").unwrap();
        assert!(!reason.trim_matches(['|', ' ']).is_empty(), "{name}: no reason");
        assert!(names.insert(name.to_owned()), "{name} is listed twice");
    }
    names
}

#[test]
fn the_page_accounts_for_every_crate() {
    let page = read("docs/dependencies.md");
    let linked = crates("normal,no-proc-macro");
    let not_linked = &crates("normal,build") - &linked;
    assert!(linked.contains("kvm-ioctls") && not_linked.contains("serde_derive"));
    for (heading, crates) in [("Linked into", linked), ("Run while", not_linked)] {
        let listed = listed(&page, heading);
        let (missing, excess) = (&crates - &listed, &listed - &crates);
        assert!(missing.is_empty(), "docs/dependencies.md, {heading}: missing {missing:?}");
        assert!(excess.is_empty(), "docs/dependencies.md, {heading}: too many: {excess:?}");
    }
}

/// Each rule, with a package that breaks only this one.
#[test]
fn what_is_not_allowed_is_found() {
    let policy = r#"
        [graph]
        targets = ["t"]
        [licenses]
        allow = ["MIT"]
        [bans]
        multiple-versions = "deny"
        skip = [{ name = "old", version = "^1", reason = "r" }]
        wildcards = "deny"
        allow-wildcard-paths = true
        [sources]
        unknown-registry = "deny"
        unknown-git = "deny"
        allow-registry = ["https://registry"]
        allow-git = []
        [advisories]
    "#;
    let package = |name: &str, version: &str| Package {
        name: name.into(),
        version: version.into(),
        license: Some("MIT".into()),
        source: Some("registry+https://registry".into()),
        dependencies: Vec::new(),
    };
    let found = |spoil: &dyn Fn(&mut Vec<Package>)| {
        let mut packages =
            vec![package("old", "1.2.3"), package("old", "2.0.0"), package("a", "1.0.0")];
        spoil(&mut packages);
        Policy::read(policy).unwrap().defects(&packages)
    };
    let none: [&str; 0] = [];
    assert_eq!(found(&|_| {}), none);
    assert_eq!(found(&|p| p[2].license = Some("GPL-3.0".into())), ["a 1.0.0: licence \"GPL-3.0\""]);
    assert_eq!(found(&|p| p[2].license = None), ["a 1.0.0: licence \"\""]);
    assert_eq!(
        found(&|p| p[2].source = Some("git+https://registry".into())),
        ["a 1.0.0: source git+https://registry"]
    );
    assert_eq!(
        found(&|p| p[2].source = Some("registry+https://registry.evil".into())),
        ["a 1.0.0: source registry+https://registry.evil"]
    );
    let any = |source: Option<&str>| Dependency {
        name: "b".into(),
        req: "*".into(),
        source: source.map(str::to_owned),
    };
    assert_eq!(found(&|p| p[2].dependencies = vec![any(None)]), none);
    let wild = ["a 1.0.0: takes any version of b"];
    assert_eq!(found(&|p| p[2].dependencies = vec![any(Some("registry"))]), wild);
    let twice = ["a: several versions: {\"1.0.0\", \"1.0.1\"}"];
    assert_eq!(found(&|p| p.push(package("a", "1.0.1"))), twice);
    assert_eq!(found(&|p| drop(p.remove(1))), ["skip of old ^1: not needed"]);
    assert_eq!(found(&|p| drop(p.remove(0))), ["skip of old ^1: not needed"]);
    let bsd = policy.replace("[\"MIT\"]", "[\"MIT\", \"BSD\"]");
    let packages = [package("old", "1.2.3"), package("old", "2.0.0")];
    assert_eq!(Policy::read(&bsd).unwrap().defects(&packages), ["licence BSD: not needed"]);
    assert!(Policy::read(&policy.replace("wildcards", "wild-cards")).is_err());
    assert!(Policy::read(&policy.replace("= \"deny\"", "= \"warn\"")).is_err());
}
