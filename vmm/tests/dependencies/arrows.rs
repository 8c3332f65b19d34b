//! Which crate of Takt may know which other, and that docs/architecture.md draws it as it is.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

use crate::{cargo, read, root};

/// The crates by layers: a crate may know those above it in this list and no others.
const LAYERS: [&[&str]; 6] = [
    &["takt-abi", "takt-channel", "takt-retain", "takt-sja1000", "takt-scheduler"],
    &["takt-record", "takt-host", "takt-devices", "takt-port", "takt-plan", "takt-carry"],
    &["takt-figures", "takt-port-c"],
    &["takt-protocol"],
    &["takt", "takt-client"],
    &["takt-ctl", "takt-doctor", "takt-jitter", "takt-shell"],
];

/// Programs that ask and show, and the types that they share with `takt`. A fault in a screen or a
/// plot must not be a fault of what can reach a guest, so they link nothing that could.
const WITHOUT_HYPERVISOR: [&str; 15] = [
    "takt-client",
    "takt-ctl",
    "takt-doctor",
    "takt-figures",
    "takt-host",
    "takt-jitter",
    "takt-plan",
    "takt-plc",
    "takt-points",
    "takt-port",
    "takt-port-c",
    "takt-protocol",
    "takt-record",
    "takt-retain",
    "takt-shell",
];

/// What a hypervisor is made of.
const HYPERVISOR: [&str; 9] = [
    "event-manager",
    "kvm-bindings",
    "kvm-ioctls",
    "linux-loader",
    "seccompiler",
    "takt",
    "takt-devices",
    "virtio-queue",
    "vm-memory",
];

#[derive(Deserialize)]
struct Metadata {
    workspace_root: String,
    packages: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    manifest_path: String,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    /// `dev` or `build`; nothing for one that is linked.
    kind: Option<String>,
    /// Where it lies, if it is one of Takt's own.
    path: Option<String>,
}

/// Each crate of the layers, with those that it links.
fn arrows() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = cargo(&root(), &["metadata", "--format-version", "1", "--no-deps"]);
    let metadata: Metadata = serde_json::from_str(&metadata).unwrap();
    // What runs in the guests, and the tests, have their own folders.
    let ours = |package: &Package| {
        let folder = package.manifest_path.strip_prefix(&metadata.workspace_root).unwrap();
        ["/vmm/", "/devices/", "/scheduler/"].iter().any(|ours| folder.starts_with(ours))
    };
    let linked = |package: Package| {
        let own = |d: &Dependency| d.kind.is_none() && d.path.is_some();
        package.dependencies.into_iter().filter(own).map(|d| d.name).collect()
    };
    let packages = metadata.packages.into_iter().filter(ours);
    packages.map(|package| (package.name.clone(), linked(package))).collect()
}

#[test]
fn arrows_between_crates_point_one_way() {
    let arrows = arrows();
    let layer = |name: &str| LAYERS.iter().position(|layer| layer.contains(&name));
    let known: BTreeSet<&str> = LAYERS.concat().into_iter().collect();
    assert_eq!(arrows.keys().map(|name| &**name).collect::<BTreeSet<_>>(), known);
    for (from, to) in &arrows {
        for to in to {
            assert!(layer(to) < layer(from), "{from} must not know {to}");
        }
    }
}

#[test]
fn clients_link_no_hypervisor() {
    for client in WITHOUT_HYPERVISOR {
        let arguments = ["tree", "-p", client, "-e", "normal", "--prefix", "none"];
        let tree = cargo(&root(), &arguments);
        let linked: BTreeSet<&str> =
            tree.lines().filter_map(|line| line.split_whitespace().next()).collect();
        assert!(linked.contains(client));
        let found: Vec<_> = HYPERVISOR.into_iter().filter(|part| linked.contains(part)).collect();
        assert!(found.is_empty(), "{client} links {found:?}");
    }
}

#[test]
fn the_lines_of_code_to_trust_are_counted_in_every_crate_that_takt_links() {
    let counted = read("tests/src/trusted_lines.rs");
    let arguments = ["tree", "-p", "takt", "-e", "normal", "--prefix", "none"];
    let tree = cargo(&root(), &arguments);
    let root = root().canonicalize().unwrap();
    let folders = tree.lines().filter_map(|line| line.split_once('('));
    let folders =
        folders.filter_map(|(_, rest)| rest.split_once(')')?.0.strip_prefix(root.to_str()?));
    let folders: BTreeSet<&str> = folders.collect();
    assert!(folders.contains("/vmm") && folders.contains("/scheduler"), "{folders:?}");
    for folder in folders {
        let source = format!("\"{}/src\"", folder.trim_start_matches('/'));
        assert!(counted.contains(&source), "{source} is not counted in docs/results.md");
    }
}

/// A line of the picture: `NAME --> NAME, NAME`, each without `takt-`.
#[test]
fn the_picture_of_the_crates_is_what_is_built() {
    let page = read("docs/architecture.md");
    let section = page.split("\n## ").find(|s| s.starts_with("Crates and arrows\n")).unwrap();
    let picture = section.split("```").nth(1).unwrap();
    let full = |name: &str| match name.trim() {
        "takt" => "takt".to_owned(),
        name => format!("takt-{name}"),
    };
    let drawn: BTreeMap<String, BTreeSet<String>> = picture
        .lines()
        .filter_map(|line| line.split_once("-->"))
        .map(|(from, to)| (full(from), to.split(',').map(full).collect()))
        .collect();
    let built = arrows().into_iter().filter(|(_, to)| !to.is_empty()).collect();
    assert_eq!(drawn, built, "docs/architecture.md (left) is not what is built (right)");
}
