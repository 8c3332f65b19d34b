//! `deny.toml`, and what is held against it.
//!
//! Every key of the file is here, so that none is written down and then not looked at.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

use crate::licence;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Policy {
    pub graph: Graph,
    licenses: Licences,
    bans: Bans,
    sources: Sources,
    /// For those who have a network.
    #[serde(rename = "advisories")]
    _advisories: toml::Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Graph {
    pub targets: [String; 1],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Licences {
    allow: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Bans {
    #[serde(rename = "multiple-versions")]
    _multiple_versions: Deny,
    skip: Vec<Skip>,
    #[serde(rename = "wildcards")]
    _wildcards: Deny,
    allow_wildcard_paths: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Skip {
    name: String,
    version: String,
    #[serde(rename = "reason")]
    _reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Sources {
    #[serde(rename = "unknown-registry")]
    _unknown_registry: Deny,
    #[serde(rename = "unknown-git")]
    _unknown_git: Deny,
    allow_registry: Vec<String>,
    allow_git: Vec<String>,
}

/// The only level that there is.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Deny {
    Deny,
}

/// A package, as `cargo metadata` tells of it.
#[derive(Clone, Deserialize)]
pub struct Package {
    pub name: String,
    pub version: String,
    pub license: Option<String>,
    pub source: Option<String>,
    pub dependencies: Vec<Dependency>,
}

#[derive(Clone, Deserialize)]
pub struct Dependency {
    pub name: String,
    pub req: String,
    pub source: Option<String>,
}

impl Policy {
    pub fn read(text: &str) -> Result<Policy, toml::de::Error> {
        toml::from_str(text)
    }

    /// What of the packages is against the policy, and what of the policy against no package.
    pub fn defects(&self, packages: &[Package]) -> Vec<String> {
        let each = packages.iter().flat_map(|package| {
            let name = format!("{} {}", package.name, package.version);
            let defects = self.of_package(package).into_iter();
            defects.map(move |defect| format!("{name}: {defect}"))
        });
        each.chain(self.duplicates(packages)).chain(self.unused(packages)).collect()
    }

    fn of_package(&self, package: &Package) -> Vec<String> {
        let mut defects = Vec::new();
        let licence = package.license.as_deref().unwrap_or("");
        if licence::is_met(licence, &self.licenses.allow) != Some(true) {
            defects.push(format!("licence {licence:?}"));
        }
        if let Some(source) = &package.source {
            let is = |kind: &str, allowed: &[String]| {
                source.strip_prefix(kind).is_some_and(|from| allowed.iter().any(|a| from == a))
            };
            if !is("registry+", &self.sources.allow_registry)
                && !is("git+", &self.sources.allow_git)
            {
                defects.push(format!("source {source}"));
            }
        }
        let is_path = |d: &Dependency| d.source.is_none() && self.bans.allow_wildcard_paths;
        let wild = package.dependencies.iter().filter(|d| d.req == "*" && !is_path(d));
        defects.extend(wild.map(|d| format!("takes any version of {}", d.name)));
        defects
    }

    fn skips(&self, name: &str, version: &str) -> bool {
        self.bans.skip.iter().any(|skip| {
            // `^1` is every 1.x, and `^0.16` every 0.16.x.
            let same = skip.version.strip_prefix('^').map(|same| format!("{same}."));
            skip.name == name && same.is_some_and(|same| version.starts_with(&same))
        })
    }

    fn duplicates(&self, packages: &[Package]) -> Vec<String> {
        let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for package in packages.iter().filter(|p| !self.skips(&p.name, &p.version)) {
            versions.entry(&package.name).or_default().insert(&package.version);
        }
        let several = versions.into_iter().filter(|(_, versions)| versions.len() > 1);
        several.map(|(name, versions)| format!("{name}: several versions: {versions:?}")).collect()
    }

    /// An exception that is left over would let in what was not decided upon.
    fn unused(&self, packages: &[Package]) -> Vec<String> {
        let count = |name: &str| packages.iter().filter(|p| p.name == name).count();
        let skips = self.bans.skip.iter().filter(|skip| {
            let there =
                packages.iter().any(|p| p.name == skip.name && self.skips(&p.name, &p.version));
            !there || count(&skip.name) < 2
        });
        let skips = skips.map(|skip| format!("skip of {} {}: not needed", skip.name, skip.version));
        let licences = self.licenses.allow.iter().filter(|licence| {
            let others: Vec<String> =
                self.licenses.allow.iter().filter(|other| other != licence).cloned().collect();
            let is_met = |p: &Package| {
                licence::is_met(p.license.as_deref().unwrap_or(""), &others) == Some(true)
            };
            packages.iter().all(is_met)
        });
        skips.chain(licences.map(|licence| format!("licence {licence}: not needed"))).collect()
    }
}
